"""The go/no-go table on made-up sensors, cards, clocks and radios, and on the simulated aircraft."""

import errno
from collections.abc import Callable
from pathlib import Path

import pytest

from daq.acquisition.health import GroupHealth, HealthSummary
from daq.acquisition.sampler import EventMark, UnfinishedScan
from daq.acquisition.supervisor import Outcome
from daq.clock import NS, SimulatedClock
from daq.config import LoggerConfig, PreflightConfig
from daq.contract.scan import GroupStatus, Scan, SensorState
from daq.recorder.config import RecorderConfig
from daq.recorder.storage import RealStorage
from daq.sensors.config import ImuConfig, SensorsConfig
from daq.service.preflight import Preflight, RadioReport, Verdict, run_preflight
from daq.service.radio_probe import listen
from daq.service.run import PreflightRefusal, _opening
from daq.transport.mavlink_codec import FrameDecoder, frames_of
from daq.transport.ports import memory_pair
from tests.daq.synthetic import START_UTC_NS, FaultyStorage

GOOD_RADIO = RadioReport(-60, -100, -65, -100, 95)


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
        outcomes = {g: Outcome(s) for g, (s, _) in self._states.items()}
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


def verdict(result: Preflight, name: str) -> Verdict:
    return next(c.verdict for c in result.checks if c.name == name)


def test_all_well_is_go(tmp_path: Path) -> None:
    result = table(tmp_path)
    assert result.go
    assert {c.verdict for c in result.checks} == {Verdict.GO}
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
    assert verdict(result, "thrust") is Verdict.CAUTION


def test_time_must_be_known_well_enough(tmp_path: Path) -> None:
    assert verdict(table(tmp_path, accuracy_ns=0), "clock") is Verdict.NO_GO
    assert verdict(table(tmp_path, accuracy_ns=0, require_time=False), "clock") is Verdict.CAUTION
    assert verdict(table(tmp_path, accuracy_ns=20_000_000), "clock") is Verdict.NO_GO
    assert verdict(table(tmp_path, accuracy_ns=20_000_000, time_accuracy_ms=50.0), "clock") is Verdict.GO
    wrong = SimulatedClock(START_UTC_NS - 86400 * NS)
    result = table(tmp_path, clock=wrong)
    assert verdict(result, "clock") is Verdict.CAUTION
    assert "-86400 s" in result.text()


def test_card_space_speed_and_faults(tmp_path: Path) -> None:
    class Full(RealStorage):
        def free_bytes(self, directory: Path) -> int:
            return 1_000_000

    assert verdict(table(tmp_path, storage=Full()), "card") is Verdict.NO_GO
    clock = SimulatedClock(START_UTC_NS)
    slow = FaultyStorage(lambda operation, size: clock.advance(NS) if operation == "sync" else None)
    result = table(tmp_path, storage=slow, clock=clock)
    assert verdict(result, "card") is Verdict.CAUTION
    assert "1000 ms" in result.text()

    def broken(operation: str, size: int) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    result = table(tmp_path, storage=FaultyStorage(broken))
    assert verdict(result, "card") is Verdict.NO_GO
    assert "Read-only file system" in result.text()


def test_radio_silence_and_margin(tmp_path: Path) -> None:
    assert verdict(table(tmp_path, radio=None), "radio") is Verdict.CAUTION
    assert verdict(table(tmp_path, radio=None, require_radio=True), "radio") is Verdict.NO_GO
    weak = RadioReport(-60, -100, -95, -100, 95)
    assert verdict(table(tmp_path, radio=weak, require_radio=True), "radio") is Verdict.NO_GO


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
    report = listen(air, clock)
    assert report is not None
    assert report.rssi_dbm == pytest.approx(190 / 1.9 - 127)
    assert report.noise_dbm == pytest.approx(57 / 1.9 - 127)
    assert report.free_percent == 96
    assert listen(memory_pair()[0], SimulatedClock()) is None


def _sik_report() -> bytes:
    """RADIO_STATUS by the common dialect of pymavlink, an implementation independent of ours."""
    from pymavlink.dialects.v10 import common

    link = common.MAVLink(None, srcSystem=51, srcComponent=68)
    message = common.MAVLink_radio_status_message(190, 171, 96, 57, 57, 0, 0)
    return bytes(message.pack(link))


SIK_REPORT = _sik_report()
