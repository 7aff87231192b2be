"""The configuration: the example is complete and true, and every mistake is one sentence that names the key."""

import math
import tomllib
from pathlib import Path

import pytest
from pydantic import BaseModel

from daq.config import ConfigError, LoggerConfig, ScanConfig, load_config, parse_config, read_calibration
from daq.service.preflight import id_checks
from daq.telemetry.config import LinkLimits
from firmware_sim.hardware.registers.ublox import ReceiverFix, nav_pvt
from firmware_sim.hardware.sensing.sensor_models import GnssModel
from firmware_sim.physics.atmosphere import Site
from tests.support.paths import ROOT
from tests.unit.daq.cdfp_fit import cdfp_sensors

FIX = ReceiverFix(1_790_000_000 * 10**9, 3, 9, 26.5, 80.2, 60.0, (15.0, 0.0, 0.0), 3e-8, 1.0, 1.0, 0.1)
GNSS_LINE = "[sensors.gnss]                      # GLOBAL_POSITION_INT, GPS_RAW_INT, and UTC by SYSTEM_TIME"
EXAMPLE = ROOT / "daq/configs/cdfp.toml"


def test_example_is_valid_and_fits_the_aircraft() -> None:
    config, text = load_config(EXAMPLE)
    assert text == EXAMPLE.read_text()
    assert config.aircraft.name == "cdfp"
    assert config.sensors.fitted == cdfp_sensors().fitted
    assert config.scan.period_ns == 50_000_000


def test_example_shows_the_defaults() -> None:
    """A value in the example differs from the default only where the comment says CDFP, or the default is None."""
    table = tomllib.loads(EXAMPLE.read_text())
    defaults = LoggerConfig(sensors=cdfp_sensors())
    marked = [line.split("=")[0].strip() for line in EXAMPLE.read_text().splitlines() if line.rstrip().endswith("CDFP")]
    for section in ("aircraft", "scan", "recorder", "preflight"):
        model: BaseModel = getattr(defaults, section)
        plain = model.model_dump(mode="json")
        assert table[section].keys() == plain.keys(), f"[{section}] of the example leaves keys out"
        different = [k for k, v in table[section].items() if v != plain[k] and k not in marked]
        assert not different, f"[{section}] {different}: neither default nor marked CDFP"
    assert table["downlink"]["limits"] == LinkLimits().model_dump(mode="json")


@pytest.mark.parametrize(
    ("rate_hz", "hand_over_s", "together"),
    [(20, 0.1, 2), (20, 0, 1), (20, 0.5, 5), (20, 1, 5), (5, 0.1, 1), (50, 0.1, 2), (200, 0.1, 1), (1000, 1, 1)],
)
def test_scans_are_handed_over_together_as_far_as_a_scan_has_room(
    rate_hz: float, hand_over_s: float, together: int
) -> None:
    assert ScanConfig(rate_hz=rate_hz, hand_over_s=hand_over_s).together == together


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[scan]\nrate_hz = 0", ["scan.rate_hz is 0", "greater than 0"]),
        ("[scan]\nrate = 20", ["scan.rate is not known"]),
        ("[scan]\nrate_hz = 'fast'", ["scan.rate_hz is 'fast'", "number"]),
        ("[recorder]\nqueue_s = 0.1\nflush_s = 5", ["recorder.queue_s"]),
        ("[recorder]\ndirectories = []", ["recorder.directories"]),
        ("[downlink.limits]\nmarks_per_s = 0", ["downlink.limits.marks_per_s is 0", "greater than 0"]),
        ("[downlink.limits]\nmarks = 3", ["downlink.limits.marks is not known"]),
        ("[wings]\nspan = 3", ["wings is not known"]),
        ("[sensors.imu]\naddress = 300", ["sensors.imu.address is 300"]),
        ("[downlink]\nrate_hz = 50", ["downlink", "50"]),
    ],
)
def test_a_mistake_names_its_key(text: str, words: list[str]) -> None:
    full = text if "[sensors" in text else text + "\n[sensors.imu]\n"
    with pytest.raises(ConfigError) as caught:
        parse_config(full, Path("logger.toml"))
    sentence = str(caught.value)
    assert sentence.startswith("logger.toml: ")
    assert "\n" not in sentence
    assert all(word in sentence for word in words), sentence


def test_missing_sensors_and_files(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="key sensors is missing"):
        parse_config("", Path("x.toml"))
    with pytest.raises(ConfigError, match="no such configuration file"):
        load_config(tmp_path / "absent.toml")
    broken = tmp_path / "broken.toml"
    broken.write_text("[scan\nrate_hz = 20")
    with pytest.raises(ConfigError, match=r"broken.toml: not valid TOML.*line 1"):
        load_config(broken)
    broken.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="cannot be read as a text file"):
        load_config(broken)


def test_relative_paths_are_taken_from_the_file(tmp_path: Path) -> None:
    path = tmp_path / "logger.toml"
    path.write_text('calibration = "cal"\n[recorder]\ndirectories = ["a", "/b"]\n[sensors.imu]\n')
    config, _ = load_config(path)
    assert config.recorder.directories == (tmp_path / "a", Path("/b"))
    assert config.calibration == tmp_path / "cal"


def test_calibration_files_are_read_or_missed_by_name(tmp_path: Path) -> None:
    assert read_calibration(None) == {}
    with pytest.raises(ConfigError, match="calibration directory not found"):
        read_calibration(tmp_path / "cal")
    (tmp_path / "cal").mkdir()
    with pytest.raises(ConfigError, match="no calibration files"):
        read_calibration(tmp_path / "cal")
    (tmp_path / "cal/pitot.toml").write_bytes(b"a = 1\n")
    assert read_calibration(tmp_path / "cal") == {"pitot.toml": b"a = 1\n"}


def test_the_example_and_the_simulated_aircraft_mean_the_same_field_and_receiver() -> None:
    """Declination of the simulated field, latency of the simulated receiver: what a flight's heading and times rest on."""
    sensors = load_config(EXAMPLE)[0].sensors
    assert sensors.attitude is not None
    assert sensors.gnss is not None
    north, east, _ = Site().magnetic_ned_t
    assert sensors.attitude.declination_deg == pytest.approx(math.degrees(math.atan2(east, north)), abs=0.01)
    assert sensors.gnss.latency_s == pytest.approx(GnssModel().latency_ms * 1e-3)
    assert sensors.gnss.arrival_s == pytest.approx(sensors.gnss.latency_s + len(nav_pvt(FIX)) * 10 / sensors.gnss.baud)


@pytest.mark.parametrize(
    ("changed", "users"),
    [
        (('port = "serial:/dev/ttyUSB0:57600"', 'port = "serial:/dev/tty1:57600"'), "sensors.autopilot and downlink"),
        (
            (f'{GNSS_LINE}\ndriver = "autopilot"', '[sensors.gnss]\ndevice = "/dev/tty1"'),
            "sensors.gnss and sensors.autopilot",
        ),
    ],
)
def test_one_serial_port_for_two_is_a_mistake(changed: tuple[str, str], users: str) -> None:
    text = (ROOT / "daq/configs/autopilot.toml").read_text()
    text = text.replace("/dev/serial/by-id/usb-ArduPilot-if00", "/dev/tty1")
    parse_config(text, Path("logger.toml"))
    assert changed[0] in text
    with pytest.raises(ConfigError, match=f"{users} share the serial port /dev/tty1"):
        parse_config(text.replace(*changed), Path("logger.toml"))


@pytest.mark.parametrize("config", ["autopilot.toml", "cdfp.toml"])
def test_speaking_as_the_autopilot_beside_it_is_a_caution(config: str) -> None:
    text = (ROOT / "daq/configs" / config).read_text()
    as_shipped = parse_config(text, Path("logger.toml"))
    assert as_shipped.downlink is not None
    as_aircraft = as_shipped.downlink.model_copy(update={"component_id": 1})
    cautions = [list(id_checks(c)) for c in (as_shipped, as_shipped.model_copy(update={"downlink": as_aircraft}))]
    assert cautions[0] == []
    assert [c.verdict.name for c in cautions[1]] == (["CAUTION"] if config == "autopilot.toml" else [])
