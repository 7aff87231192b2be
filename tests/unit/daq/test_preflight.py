"""The go/no-go table on made-up sensors, cards, clocks and radios, and on the simulated aircraft."""

import errno
import os
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from daq.acquisition.health import GroupHealth, HealthSummary
from daq.acquisition.sampler import EventMark, UnfinishedScan
from daq.acquisition.supervisor import GroupOutcome
from daq.actuation.actuation import Devices
from daq.clock import NS, SimulatedClock
from daq.config import LoggerConfig, PreflightConfig
from daq.contract.scan import GroupStatus, Scan, SensorState
from daq.recorder.config import RecorderConfig
from daq.recorder.storage import RealStorage, in_memory
from daq.sensors.capture import CaptureConfig
from daq.sensors.config import SensorsConfig
from daq.sensors.icm20948 import ImuConfig
from daq.service.checks import PreflightVerdict, RadioReport, listen_to_radio, sender_checks
from daq.service.preflight import Preflight, run_preflight
from daq.service.run import PreflightRefusal, _opening, without_sequencer
from daq.transport.mavlink_codec import FrameDecoder, frames_of
from daq.transport.ports import memory_pair
from firmware_sim.hardware.autopilot_cockpit import AutopilotCockpit
from firmware_sim.hardware.cockpit import Cockpit
from firmware_sim.hardware.serial import SimulatedSerial
from firmware_sim.runs.flight import prepare_flight
from firmware_sim.world.scenario import load_scenario
from tests.unit.daq.synthetic import START_UTC_NS, FaultyStorage

GOOD_RADIO = RadioReport(-60, -100, -65, -100, 95)


@pytest.fixture(autouse=True)
def _lasting(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wherever this machine keeps its temporary files."""
    monkeypatch.setattr("daq.service.preflight.in_memory", lambda directory: False)


class Sensors:
    """Sensors with given states; UTC known to `accuracy_ns`, 0 for not at all."""

    def __init__(self, clock: SimulatedClock, states: dict[str, tuple[SensorState, bool]], accuracy_ns: int) -> None:
        self.on_event: Callable[[EventMark], None] = lambda _: None
        self._clock, self._states, self._accuracy = clock, states, accuracy_ns

    def start(self) -> HealthSummary:
        return self.health()

    def take(self, number: int, deadline_ns: int) -> UnfinishedScan:
        now = self._clock.monotonic_ns()
        utc = START_UTC_NS + now if self._accuracy else 0
        outcomes = {g: GroupOutcome(s) for g, (s, _) in self._states.items()}
        return UnfinishedScan(number, now, utc, self._accuracy, 0, outcomes)

    def finish(self, taken: UnfinishedScan) -> Scan:
        return Scan(*taken[:5], {g: GroupStatus(o.state) for g, o in taken.outcomes.items()}, {})

    def health(self) -> HealthSummary:
        groups = tuple(
            GroupHealth(g, state, "" if state is SensorState.OK else "why", required=required)
            for g, (state, required) in self._states.items()
        )
        return HealthSummary(self._clock.monotonic_ns(), groups)

    def metadata(self) -> dict[str, str]:
        return {}

    def refusals(self) -> dict[str, str]:
        return {}


def table(
    tmp_path: Path,
    *,
    states: dict[str, tuple[SensorState, bool]] | None = None,
    accuracy_ns: int = 1000,
    storage: RealStorage | None = None,
    clock: SimulatedClock | None = None,
    radio: RadioReport | None = GOOD_RADIO,
    **limits: object,
) -> Preflight:
    clock = clock or SimulatedClock(START_UTC_NS)
    config = LoggerConfig(
        recorder=RecorderConfig(directories=(tmp_path,)),
        sensors=SensorsConfig(imu=ImuConfig()),
        preflight=PreflightConfig(**limits),  # type: ignore[arg-type]
        calibration=tmp_path,
    )
    sensors = Sensors(clock, states or {"imu": (SensorState.OK, True)}, accuracy_ns)
    return run_preflight(config, clock, sensors, storage or RealStorage(), lambda: radio)


def verdict(result: Preflight, name: str) -> PreflightVerdict:
    return next(c.verdict for c in result.checks if c.name == name)


def test_all_well_is_go(tmp_path: Path) -> None:
    result = table(tmp_path)
    assert result.go
    assert {c.verdict for c in result.checks} == {PreflightVerdict.GO}
    assert {c.name for c in result.checks} == {"imu", "timing", "clock", "card", "calibration", "radio"}
    assert list(tmp_path.iterdir()) == [], "the probe leaves nothing behind"
    assert result.text().endswith("GO")


@pytest.mark.parametrize(
    "state",
    [SensorState.ABSENT, SensorState.STUCK, SensorState.OUT_OF_RANGE, SensorState.FAULT, SensorState.RECOVERING],
)
def test_a_required_sensor_that_is_not_well_forbids(tmp_path: Path, state: SensorState) -> None:
    result = table(tmp_path, states={"imu": (SensorState.OK, True), "pitot": (state, True), "thrust": (state, False)})
    assert not result.go
    assert [c.name for c in result.failed] == ["pitot"]
    assert state.words in result.failed[0].text
    assert "why" in result.failed[0].text
    assert verdict(result, "thrust") is PreflightVerdict.CAUTION


def test_time_must_be_known_well_enough(tmp_path: Path) -> None:
    assert verdict(table(tmp_path, accuracy_ns=0), "clock") is PreflightVerdict.NO_GO
    assert verdict(table(tmp_path, accuracy_ns=0, require_time=False), "clock") is PreflightVerdict.CAUTION
    assert verdict(table(tmp_path, accuracy_ns=40_000_000), "clock") is PreflightVerdict.NO_GO
    assert verdict(table(tmp_path, accuracy_ns=40_000_000, time_accuracy_ms=50.0), "clock") is PreflightVerdict.GO
    wrong = SimulatedClock(START_UTC_NS - 86400 * NS)
    result = table(tmp_path, clock=wrong)
    assert verdict(result, "clock") is PreflightVerdict.CAUTION
    assert "-86400 s" in result.text()


def test_card_space_speed_and_faults(tmp_path: Path) -> None:
    class Full(RealStorage):
        def free_bytes(self, directory: Path) -> int:
            return 1_000_000

    assert verdict(table(tmp_path, storage=Full()), "card") is PreflightVerdict.NO_GO
    clock = SimulatedClock(START_UTC_NS)
    slow = FaultyStorage(lambda operation, size: clock.advance(NS) if operation == "sync" else None)
    result = table(tmp_path, storage=slow, clock=clock)
    assert verdict(result, "card") is PreflightVerdict.CAUTION
    assert "1000 ms" in result.text()

    def broken(operation: str, size: int) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    result = table(tmp_path, storage=FaultyStorage(broken))
    assert verdict(result, "card") is PreflightVerdict.NO_GO
    assert "Read-only file system" in result.text()


def test_recordings_that_would_go_with_the_power(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("daq.service.preflight.in_memory", lambda directory: True)
    result = table(tmp_path)
    assert verdict(result, "card") is PreflightVerdict.NO_GO
    assert "goes with the power: is the card mounted?" in result.text()


@pytest.mark.parametrize(
    ("kind", "upper", "expected"),
    [
        ("tmpfs tmpfs rw", "", True),
        ("ext4 /dev/sda1 rw", "", False),
        ("overlay overlayroot rw,lowerdir=/ro,upperdir={0}", "tmpfs tmpfs rw", True),  # overlayroot
        ("overlay overlay rw,lowerdir=/ro,upperdir={0}", "ext4 /dev/sda1 rw", False),  # a container on a disk
        ("overlay overlay rw,lowerdir=/ro,upperdir=/not/seen/from/here", "", False),
    ],
)
def test_memory_is_told_from_a_card_by_the_mounts(kind: str, upper: str, expected: bool, tmp_path: Path) -> None:
    mounts, here, other = tmp_path / "mountinfo", tmp_path.stat().st_dev, Path("/proc").stat().st_dev
    lines = [f"36 35 {os.major(here)}:{os.minor(here)} / {tmp_path} rw,noatime shared:1 - {kind.format('/proc')}"]
    if upper:
        lines.append(f"37 35 {os.major(other)}:{os.minor(other)} / /proc rw - {upper}")
    mounts.write_text("\n".join(lines))
    assert in_memory(tmp_path / "not made yet", mounts) is expected
    assert not in_memory(tmp_path, tmp_path / "no such file")


def test_radio_silence_and_margin(tmp_path: Path) -> None:
    assert verdict(table(tmp_path, radio=None), "radio") is PreflightVerdict.CAUTION
    assert verdict(table(tmp_path, radio=None, require_radio=True), "radio") is PreflightVerdict.NO_GO
    weak = RadioReport(-60, -100, -95, -100, 95)
    assert verdict(table(tmp_path, radio=weak, require_radio=True), "radio") is PreflightVerdict.NO_GO


def test_refused_unless_overridden_and_the_reason_is_kept(tmp_path: Path) -> None:
    result = table(tmp_path, states={"pitot": (SensorState.ABSENT, True)})
    with pytest.raises(PreflightRefusal, match=r"no-go: pitot: .*--override"):
        _opening(result, None)
    line = _opening(result, "pitot cover still on")[0]
    assert "pitot cover still on" in line.text
    assert "pitot:" in line.text
    assert _opening(None, None)[0].text == "skipped by the operator"
    assert _opening(table(tmp_path), None)[0].text == "go"


def test_radio_is_listened_to_after_a_heartbeat() -> None:
    """A SiK radio reports only after a heartbeat has passed; its MAVLink 1 frame is understood."""
    clock = SimulatedClock()
    air, radio = memory_pair()
    decoder = FrameDecoder()
    sent: list[str] = []

    def sik(now_ns: int) -> None:
        sent.extend(f.name for f in frames_of(decoder.feed(radio.read())))
        if "HEARTBEAT" in sent and now_ns > NS:
            radio.write(SIK_REPORT)

    clock.on_advance(sik)
    report = listen_to_radio(air, clock)
    assert report is not None
    assert report.rssi_dbm == pytest.approx(190 / 1.9 - 127)
    assert report.noise_dbm == pytest.approx(57 / 1.9 - 127)
    assert report.free_percent == 96
    assert listen_to_radio(memory_pair()[0], SimulatedClock()) is None


def _sik_report() -> bytes:
    """RADIO_STATUS by the common dialect of pymavlink, an implementation independent of ours."""
    from pymavlink.dialects.v10 import common

    link = common.MAVLink(None, srcSystem=51, srcComponent=68)
    message = common.MAVLink_radio_status_message(190, 171, 96, 57, 57, 0, 0)
    return bytes(message.pack(link))


SIK_REPORT = _sik_report()


# ---------------------------------------------------------------------------------------------------- the sequencer


def sequencer_table(tmp_path: Path, scenario: str = "sequencer", **changes: object) -> Preflight:
    """The go/no-go table of the simulated aircraft with a sequencer; `changes` are tables of its scenario."""
    chosen = load_scenario(scenario).altered(**changes)
    with prepare_flight(chosen, tmp_path / "flight") as flight:
        assert isinstance(flight.cockpit, Cockpit)
        devices = Devices(flight.aircraft.bus, flight.cockpit.monostable, flight.clock)
        quick = flight.config.model_copy(update={"preflight": PreflightConfig(scans=10)})
        return run_preflight(quick, flight.clock, flight.assembly.sampler, RealStorage(), None, devices)


def sequencer_scenario_config(tmp_path: Path) -> LoggerConfig:
    with prepare_flight(load_scenario("sequencer"), tmp_path / "config") as flight:
        return flight.config


def lines(result: Preflight) -> dict[str, tuple[PreflightVerdict, str]]:
    return {c.name: (c.verdict, c.text) for c in result.checks}


OFF_ALL_THE_TIME = {"switch": [[0.0, "off"]]}


def test_the_sequencer_is_tried_out(tmp_path: Path) -> None:
    found = lines(sequencer_table(tmp_path, sequencer=OFF_ALL_THE_TIME))
    for name in ("manoeuvre", "servo driver", "pilot's signals", "output frequency", "multiplexer", "heartbeat"):
        assert found[name][0] is PreflightVerdict.GO, found[name]
    assert "without it the servo driver is dead" in found["heartbeat"][1]


def test_an_autopilot_that_the_sequencer_goes_through_is_tried_out(tmp_path: Path) -> None:
    chosen = load_scenario("sequencer_ardupilot").altered(
        sequencer={"switch": [[0.0, "off"]], "parameters": {"RC_OVERRIDE_TIME": 3.0}}
    )
    with prepare_flight(chosen, tmp_path / "flight") as flight:
        assert isinstance(flight.cockpit, AutopilotCockpit)
        port = SimulatedSerial(flight.cockpit.plane, flight.clock.monotonic_ns)
        quick = flight.config.model_copy(update={"preflight": PreflightConfig(scans=10)})
        devices = Devices(flight.aircraft.bus, None, flight.clock, port)
        made = run_preflight(quick, flight.clock, flight.assembly.sampler, RealStorage(), None, devices)
        assert "RC_OVERRIDE_TIME is 3 s; set it to 0.1" in lines(made)["autopilot"][1]
        assert "RC_OVERRIDE_TIME is 3 s" in str(without_sequencer(flight.config, made))


@pytest.mark.parametrize(
    ("changes", "name", "words"),
    [
        ({"sequencer": {"switch": [[0.0, "arm"]]}}, "pilot's signals", "switch is at arm; put it to off"),
        ({"sequencer": {**OFF_ALL_THE_TIME, "receiver_lost_s": 0.0}}, "pilot's signals", "is the transmitter on?"),
        (
            {"sequencer": {**OFF_ALL_THE_TIME, "oscillator_error": 0.05}},
            "output frequency",
            "set sequencer.chip.oscillator_hz",
        ),
        (
            {"sequencer": {**OFF_ALL_THE_TIME, "heartbeat_lost_s": 0.0}},
            "output frequency",
            "check its wire, OE and heartbeat",
        ),
        ({"sequencer": {"switch": [[0.0, "go"]]}}, "multiplexer", "no pulses|us off the pilot's"),
    ],
)
def test_what_is_wrong_with_the_sequencer_is_a_no_go(
    tmp_path: Path, changes: dict[str, object], name: str, words: str
) -> None:
    found = lines(sequencer_table(tmp_path, **changes))
    assert found[name][0] is PreflightVerdict.NO_GO, found
    assert re.search(words, found[name][1]), found[name]


def test_a_no_go_of_the_sequencer_cannot_be_overridden(tmp_path: Path) -> None:
    """The service starts with an override for the sensors' sake; what moves the controls stays off then."""
    config = sequencer_scenario_config(tmp_path)
    good = sequencer_table(tmp_path / "a", sequencer=OFF_ALL_THE_TIME)
    bad = sequencer_table(tmp_path / "b", sequencer={**OFF_ALL_THE_TIME, "oscillator_error": 0.05})
    assert without_sequencer(config, good) is None
    assert without_sequencer(config, bad) is not None
    assert "output frequency" in str(without_sequencer(config, bad))
    assert without_sequencer(config, None) == "the preflight check was skipped"
    assert without_sequencer(config.model_copy(update={"sequencer": None}), None) is None


def test_a_driver_that_does_not_answer_is_a_no_go(tmp_path: Path) -> None:
    gone = [{"kind": "absent", "device": "servo_driver", "start_s": 0.0}]
    found = lines(sequencer_table(tmp_path, sequencer=OFF_ALL_THE_TIME, faults=gone))
    assert found["servo driver"][0] is PreflightVerdict.NO_GO
    assert "check wiring, strap and supply" in found["servo driver"][1]


def test_an_oe_that_is_not_wired_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from firmware_sim.hardware.registers.pca9685 import Pca9685Chip

    plain = Pca9685Chip.__init__
    monkeypatch.setattr(Pca9685Chip, "__init__", lambda self, error=0.0, enabled=None: plain(self, error))
    found = lines(sequencer_table(tmp_path, sequencer=OFF_ALL_THE_TIME))
    assert found["heartbeat"] == (
        PreflightVerdict.NO_GO,
        "servo driver goes on without it: OE is not wired to the monostable",
    )


@pytest.mark.parametrize(
    ("stream_hz", "late_ms", "verdict", "words"),
    [
        (25.0, 30.0, PreflightVerdict.GO, "samples a second (at least 18)"),
        (10.0, 30.0, PreflightVerdict.NO_GO, "10.1 samples a second (at least 18)"),
        (4.0, 30.0, PreflightVerdict.NO_GO, "SCHED_LOOP_RATE of at least 38 grants it"),
        (25.0, 190.0, PreflightVerdict.NO_GO, "(limit 150)"),
    ],
)
def test_samples_of_a_sender_too_slow_or_too_old(
    stream_hz: float, late_ms: float, verdict: PreflightVerdict, words: str
) -> None:
    config = LoggerConfig(sensors=SensorsConfig(capture=CaptureConfig(driver="mavlink_servo")))
    scans = []
    for k in range(80):
        now_ms = 1000 + 50 * k
        newest_ms = ((now_ms - late_ms) * 1e-3 * stream_hz) // 1 / stream_hz * 1e3
        offset_us = round((newest_ms - now_ms) * 1e3)
        scans.append(Scan(k, now_ms * 1_000_000, groups={"capture": GroupStatus(SensorState.OK, offset_us)}))
    (check,) = sender_checks(config, scans, {"capture": "SCHED_LOOP_RATE of at least 38 grants it"})
    assert check.verdict is verdict
    assert words in check.text
