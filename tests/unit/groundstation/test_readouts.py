"""Digital read-outs, the alarm banner, the ports of a station without a configuration, and panes that stay away when empty."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import sideslip
from daq.contract.channels import COLUMN_BY_NAME
from groundstation.flight import Flight
from groundstation.live.config import LISTENER, configured, usual_ports
from groundstation.live.readouts import FRESH_S, READOUTS, FreshValues, banner, readout_line
from groundstation.live.watches import Alarms, Limit
from groundstation.viewer.blueprint import blueprint, fitted
from groundstation.viewer.entities import LinkSample
from groundstation.viewer.recorded import filled_entities


def test_numbers_are_in_the_units_a_person_reads() -> None:
    """A turn of 60 degrees of bank: two g, by hand."""
    values = {"V": 17.25, "altitude": 57.6, "alpha": math.pi / 36, "beta": -math.pi / 180, "az": -2 * 9.80665}
    said = readout_line(values, "link 12 Hz")
    assert said == "## V 17.2 m/s · h 58 m · α +5.0 ° · β -1.0 ° · n +2.00 g · battery – V · link 12 Hz"


def test_every_readout_is_a_column_of_the_table() -> None:
    units = {r.column: COLUMN_BY_NAME[r.column].unit for r in READOUTS}
    assert units == {"V": "m/s", "altitude": "m", "alpha": "rad", "beta": "rad", "az": "m/s2", "supply_voltage": "V"}


def test_a_number_that_no_longer_comes_is_a_dash() -> None:
    fresh = FreshValues()
    fresh.update(10.0, {"V": 17.0, "altitude": math.nan})
    fresh.update(10.0 + FRESH_S, {"V": math.nan})
    assert fresh.at(10.0 + FRESH_S) == {"V": 17.0}
    assert fresh.at(10.1 + FRESH_S) == {}


def test_the_banner_shows_the_highest_level_and_what_is_over() -> None:
    alarms = Alarms(
        [Limit(channel="V", low=11.0, level="ERROR", text="airspeed"), Limit(channel="n", high=3.0, level="WARN")]
    )
    assert banner(alarms.in_force()) == ("", "no alarm")
    alarms.update(0.0, {"V": 10.0, "n": 4.0})
    assert banner(alarms.in_force()) == ("ERROR", "## ERROR: airspeed below 11 m/s, n above 3")
    alarms.update(1.0, {"V": 12.0})
    assert banner(alarms.in_force()) == ("WARN", "## WARN: n above 3; over: airspeed below 11 m/s")


def test_a_banner_too_long_for_its_pane_is_set_small() -> None:
    in_force = [("gap monitor: Cl_da (aileron effectiveness)", "active", "WARN"), ("airspeed", "active", "ERROR")]
    words = "ERROR: gap monitor: Cl_da (aileron effectiveness), airspeed"
    assert banner(in_force) == ("ERROR", f"**{words}**")


@dataclass
class Device:
    device: str
    vid: int | None
    pid: int | None


def test_radios_on_usb_are_listened_to_and_other_serial_devices_left_alone() -> None:
    devices = [
        Device("/dev/ttyUSB1", 0x10C4, 0xEA60),
        Device("/dev/ttyUSB0", 0x0403, 0x6015),
        Device("/dev/ttyACM0", 0x2341, 0x0043),
        Device("/dev/ttyS0", None, None),
    ]
    assert usual_ports(devices) == (LISTENER, "serial:/dev/ttyUSB0:57600", "serial:/dev/ttyUSB1:57600")
    assert usual_ports([]) == (LISTENER,)


def test_without_a_configuration_the_station_has_defaults_and_takes_a_layout(tmp_path: Path) -> None:
    assert configured(None).link.ports[0] == "udpin:14550"
    file = tmp_path / "g.toml"
    file.write_text("[view]\nport = 9900\n")
    view = configured(file, "light").view
    assert (view.layout, view.port) == ("light", 9900)


def test_a_replay_needs_no_configuration(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = root / "recordings" / "cdfp_ld1_raw.mcap"
    with pytest.raises(SystemExit) as ended:
        sideslip.main(["ground", "--replay", str(recording), "--speed", "max", "--out", str(tmp_path / "s")])
    assert ended.value.code == 0
    assert (tmp_path / "s" / "flight.mcap").is_file()


def test_panes_without_anything_to_show_stay_away() -> None:
    time = np.arange(100) * 0.05
    rates = {n: 0.1 * np.sin(time) for n in ("p", "q", "r")}
    bare = Flight.build("f", time, {**rates, "V": np.full(100, np.nan)})
    assert filled_entities(bare, {}, [], [], "") == {"/rates"}
    whole = Flight.build(
        "f", time, {**rates, "V": np.full(100, 17.0), "latitude": np.full(100, 48.0), "longitude": np.full(100, 11.0)}
    )
    link = [(0.0, LinkSample(loss_percent=3.0))]
    found = filled_entities(whole, {"imu": [(0.0, "ok")]}, [(1.0, "mark", "INFO")], link, "all well")
    assert found >= {"/readouts", "/airdata/speed", "/world/track", "/health", "/events", "/status", "/link/loss"}
    assert "/link/rate" not in found


def views(pane: object) -> list[str]:
    """Names of the views of a container, in order."""
    contents = getattr(pane, "contents", ())
    if isinstance(contents, str) or not hasattr(pane, "kind"):
        return [str(getattr(pane, "name", ""))]
    return [name for part in contents for name in views(part)]


def test_the_layout_keeps_only_panes_that_show_something() -> None:
    bare = fitted(blueprint("full", live=False), live=False, filled={"/rates", "/readouts", "/world/track"})
    assert views(bare.root_container) == ["Read-outs", "Rates", "Track"]
    nothing = fitted(blueprint("light", live=False), live=False, filled={"/rates"})
    assert views(nothing.root_container) == ["Rates"]
    whole = views(fitted(blueprint("full"), live=True).root_container)
    assert whole[:4] == ["Read-outs", "Alarms", "Alarm", "Alpha, beta"]
    assert {"Map", "Status", "Sensor health", "Link quality"} <= set(whole)


def test_a_phone_has_one_column_with_read_outs_and_alarms_first() -> None:
    page = fitted(blueprint("phone"), live=True, layout="phone").root_container
    assert views(page) == ["Read-outs", "Alarms", "Events and alarms", "Live identification", "Alpha, beta", "Rates"]

    def side_by_side(pane: object) -> bool:
        parts = [p for p in getattr(pane, "contents", ()) if hasattr(p, "kind")]
        return type(pane).__name__ == "Horizontal" or any(side_by_side(p) for p in parts)

    assert not side_by_side(page)
    assert side_by_side(fitted(blueprint("full"), live=True).root_container)
