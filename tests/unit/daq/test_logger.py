"""The scan loop: deadlines, skipped slots, health, events, the link, and an orderly end whatever happens."""

import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from daq.acquisition.health import GroupHealth, HealthSummary
from daq.acquisition.sampler import EventMark, UnfinishedScan
from daq.acquisition.supervisor import GroupOutcome
from daq.clock import NS, RealClock, SimulatedClock
from daq.contract.recordings.accounting import verify
from daq.contract.recordings.messages import EventMessage, LogLevel, Statistics
from daq.contract.recordings.reading import read_recording
from daq.contract.scan import GroupStatus, Scan, SensorState
from daq.logger import Logger, Opening
from daq.recorder.config import RecorderConfig
from daq.recorder.counts import LoopTiming
from daq.recorder.recorder import Recorder
from daq.telemetry.control import Control
from tests.unit.daq.synthetic import START_UTC_NS, make_info


class FakeSampler:
    """Takes `duration_ns(number)` of simulated time for each scan."""

    def __init__(
        self, clock: SimulatedClock | RealClock, duration_ns: Callable[[int], int] = lambda _: 2_000_000
    ) -> None:
        self.on_event: Callable[[EventMark], None] = lambda _: None
        self.state = SensorState.OK
        self.starts: list[int] = []
        self.numbers: list[int] = []
        self.retries = 0
        self._clock = clock
        self._duration = duration_ns

    def start(self) -> HealthSummary:
        return self.health()

    def take(self, number: int, deadline_ns: int) -> UnfinishedScan:
        now = self._clock.monotonic_ns()
        self.starts.append(now)
        self.numbers.append(number)
        self._clock.sleep_until(now + self._duration(number))
        outcomes = {"imu": GroupOutcome(self.state, values={"accel_x": number % 100})}
        return UnfinishedScan(number, now, START_UTC_NS + now, 30, (now - deadline_ns) // 1000, outcomes)

    def finish(self, taken: UnfinishedScan) -> Scan:
        imu = taken.outcomes["imu"]
        return Scan(*taken[:5], {"imu": GroupStatus(imu.state)}, imu.values)

    def health(self) -> HealthSummary:
        detail = "" if self.state is SensorState.OK else "does not answer"
        return HealthSummary(
            self._clock.monotonic_ns(), (GroupHealth("imu", self.state, detail, retries=self.retries),)
        )

    def metadata(self) -> dict[str, str]:
        return {"imu.accel_range_g": "8"}


class FakeLink:
    """Remembers what it was given; fails between two scan numbers."""

    def __init__(self, broken: range = range(0)) -> None:
        self.scans: list[int] = []
        self.events: list[EventMessage] = []
        self.texts: list[tuple[int, str]] = []
        self.served: list[int] = []  # how many scans had been offered at each service
        self._broken = broken

    def offer(self, scan: Scan) -> None:
        self.scans.append(scan.number)

    def service(self, now_ns: int) -> None:
        self.served.append(len(self.scans))
        if self.scans and self.scans[-1] in self._broken:
            raise OSError(5, "Input/output error")

    def event(self, event: EventMessage) -> None:
        self.events.append(event)

    def text(self, severity: int, words: str, /) -> None:
        self.texts.append((severity, words))


class Rig:
    """A logger on a simulated clock with fake sensors."""

    def __init__(
        self, path: Path, *, link: FakeLink | None = None, rate_hz: float = 20.0, together: int = 1, **options: object
    ) -> None:
        self.clock = SimulatedClock(START_UTC_NS)
        self.sampler = FakeSampler(self.clock, **options)  # type: ignore[arg-type]
        self.link = link
        self.path = path
        timing = LoopTiming()
        self.recorder = self._recorder("s1", rate_hz, timing)
        self.logger = Logger(
            rate_hz,
            self.clock,
            self.sampler,
            self.recorder,
            link,
            together=together,
            timing=timing,
            new_recorder=lambda: self._recorder("s2", rate_hz, timing),
            opening=[Opening(LogLevel.WARNING, "preflight", "no-go overridden (test)")],
        )

    def _recorder(self, session: str, rate_hz: float, timing: LoopTiming) -> Recorder:
        config = RecorderConfig(directories=(self.path,))
        info = make_info(session, scan_rate_hz=rate_hz)
        recorder = Recorder(config, info, self.clock, folder=session, timing=timing)
        self.clock.follow(recorder.busy)
        return recorder

    def until(self, seconds: float) -> Callable[[], bool]:
        return lambda: self.clock.monotonic_ns() >= seconds * NS


def test_deadlines_are_multiples_of_the_period_and_never_drift(tmp_path: Path) -> None:
    rig = Rig(tmp_path, duration_ns=lambda n: 1_000_000 * (n * 7 % 48))
    books = rig.logger.run(rig.until(60))
    starts = rig.sampler.starts
    assert [b - a for a, b in zip(starts, starts[1:], strict=False)] == [50_000_000] * (len(starts) - 1)
    assert (books.written, books.missed, books.late_scans) == (len(starts), 0, 0)
    assert verify(tmp_path / "s1").ok


@pytest.mark.parametrize("rate_hz", [200.0, 1000.0])
def test_other_rates_are_a_configuration_value(tmp_path: Path, rate_hz: float) -> None:
    rig = Rig(tmp_path, rate_hz=rate_hz, duration_ns=lambda _: 300_000)
    books = rig.logger.run(rig.until(3))
    assert books.missed == 0
    assert books.written == len(rig.sampler.starts) == pytest.approx(3 * rate_hz, abs=2)
    assert verify(tmp_path / "s1").ok


def test_a_late_scan_costs_only_the_slots_it_overran(tmp_path: Path) -> None:
    rig = Rig(tmp_path, duration_ns=lambda n: 180_000_000 if n == 10 else 2_000_000)
    books = rig.logger.run(rig.until(2))
    # Scan 10 ends 180 ms after its start: slots 11 and 12 are over, 13 is under way and begins 30 ms late.
    assert rig.sampler.numbers[9:14] == [9, 10, 13, 14, 15]
    assert books.absent == ((11, 12),)
    assert books.late_scans == 1
    result = verify(tmp_path / "s1")
    assert result.ok, result.text
    assert result.missed == 2


def test_a_change_of_health_reaches_file_ground_and_log(tmp_path: Path) -> None:
    link = FakeLink()
    rig = Rig(tmp_path, link=link)

    def stop() -> bool:
        seconds = rig.clock.monotonic_ns() / NS
        rig.sampler.state = SensorState.ABSENT if 2 <= seconds < 4 else SensorState.OK
        return seconds >= 6

    rig.logger.run(stop)
    recording = read_recording(tmp_path / "s1")
    states = [h.entries[0].state for h in recording.health]
    assert states == [SensorState.OK, SensorState.ABSENT, SensorState.OK, SensorState.OK], "changes, and the end"
    assert "does not answer" in recording.health[1].entries[0].text
    assert any(severity == 4 and "does not answer" in words for severity, words in link.texts)
    assert recording.info.details["imu.accel_range_g"] == "8"


def test_repeated_transfers_are_in_the_last_report_and_the_last_line(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.sampler.retries = 7
    rig.logger.run(rig.until(2))
    recording = read_recording(tmp_path / "s1")
    assert recording.health[-1].entries[0].failures == 7
    assert recording.log[-1].message == "recording ends; transfers repeated: accelerometer and gyro 7"


def test_a_failing_radio_does_not_touch_the_recording(tmp_path: Path) -> None:
    rig = Rig(tmp_path, link=FakeLink(broken=range(20, 60)))
    books = rig.logger.run(rig.until(5))
    assert books.missed == books.dropped == 0
    lines = [line.message for line in read_recording(tmp_path / "s1").log]
    assert sum("radio port fails" in line for line in lines) == 1
    assert sum("radio port works again" in line for line in lines) == 1
    assert any("overridden" in line for line in lines)


def test_events_from_switch_and_ground(tmp_path: Path) -> None:
    link = FakeLink()
    rig = Rig(tmp_path, link=link)
    done: list[int] = []

    def stop() -> bool:
        if len(rig.sampler.numbers) == 40 and not done:
            done.append(1)
            rig.logger.mark_event("mark 3", "ground")
            rig.sampler.on_event(EventMark(rig.clock.monotonic_ns() - 1000, 39, "switch"))
        return rig.clock.monotonic_ns() >= 4 * NS

    rig.logger.run(stop)
    events = read_recording(tmp_path / "s1").events
    assert {(e.origin, e.text, e.number) for e in events} == {("ground", "mark 3", 40), ("switch", "event switch", 39)}
    assert all(e.time_utc_ns == START_UTC_NS + e.time_monotonic_ns for e in events)
    assert len(link.events) == 2


@pytest.mark.parametrize("together", [1, 2, 3, 7])
def test_scans_finished_together_are_all_recorded_and_offered_in_order(tmp_path: Path, together: int) -> None:
    link = FakeLink()
    rig = Rig(tmp_path, link=link, together=together)
    rig.logger.run(lambda: len(rig.sampler.numbers) == 100)
    assert link.scans == list(range(100))
    assert link.served == [*range(together, 100, together), 100], "the rest is handed over at the end"
    assert [b - a for a, b in zip(rig.sampler.starts, rig.sampler.starts[1:], strict=False)] == [50_000_000] * 99
    recording = read_recording(tmp_path / "s1")
    assert [(s.number, s.values["accel_x"]) for s in recording.scans()] == [(n, n) for n in range(100)]
    assert verify(tmp_path / "s1").ok


class Questions:
    """An uplink that takes the questions of the ground."""

    def __init__(self) -> None:
        self.asked = self.taken = 0

    def service(self, now_ns: int, control: Control) -> None:
        self.taken, self.asked = self.asked, 0


class AnsweringLink(FakeLink):
    """Notes when a question that was taken is answered."""

    def __init__(self, uplink: Questions) -> None:
        super().__init__()
        self.answered: list[int] = []
        self._uplink = uplink

    def service(self, now_ns: int) -> None:
        self.answered += [now_ns] * self._uplink.taken


def test_an_answer_leaves_in_the_same_turn_of_the_link(tmp_path: Path) -> None:
    uplink = Questions()
    link = AnsweringLink(uplink)
    rig = Rig(tmp_path, link=link, together=2)
    rig.logger.connect(link, uplink)

    def stop() -> bool:
        if len(rig.sampler.numbers) == 40:
            uplink.asked = 1
        return len(rig.sampler.numbers) == 44

    rig.logger.run(stop)
    assert link.answered == [rig.sampler.starts[41] + 2_000_000]


@pytest.mark.parametrize("together", [1, 3])
def test_recording_ends_and_begins_by_command_without_reusing_numbers(tmp_path: Path, together: int) -> None:
    rig = Rig(tmp_path, together=together)

    def stop() -> bool:
        n = len(rig.sampler.numbers)
        if n == 40:
            rig.logger.stop_recording()
        if n == 60:
            rig.logger.start_recording()
        assert rig.logger.recording is not (40 <= n < 60)
        return n >= 100

    rig.logger.run(stop)
    assert read_recording(tmp_path / "s1").numbers == list(range(40))
    assert read_recording(tmp_path / "s2").numbers == list(range(60, 100))
    assert verify(tmp_path / "s1").ok
    assert verify(tmp_path / "s2").ok


@pytest.mark.parametrize("together", [1, 3])
def test_a_programming_fault_still_ends_the_recording_in_order(tmp_path: Path, together: int) -> None:
    def fails(number: int) -> int:
        if number == 50:
            raise ZeroDivisionError
        return 0

    rig = Rig(tmp_path, duration_ns=fails, together=together)
    with pytest.raises(ZeroDivisionError):
        rig.logger.run(rig.until(10))
    assert read_recording(tmp_path / "s1").numbers == list(range(50))
    assert verify(tmp_path / "s1").ok


def test_clock_runs_in_real_time_too(tmp_path: Path) -> None:
    clock = RealClock()
    sampler = FakeSampler(clock, lambda _: 0)
    recorder = Recorder(RecorderConfig(directories=(tmp_path,)), make_info(scan_rate_hz=100.0), clock)
    stop = threading.Event()
    timer = threading.Timer(0.5, stop.set)
    timer.start()
    books = Logger(100.0, clock, sampler, recorder).run(stop.is_set)
    timer.join()
    assert books.closes
    assert books.written == len(sampler.numbers)
    assert verify(tmp_path).ok


class Stalling:
    """An uplink whose turn takes long, and which can do something in it; it should not, but if it does it is counted."""

    def __init__(self, rig: Rig, at: int, stall_ns: int, then: Callable[[Control], object] = lambda _: None) -> None:
        self.turns: list[int] = []
        self._rig, self._at, self._stall_ns, self._then = rig, at, stall_ns, then

    def service(self, now_ns: int, control: Control) -> None:
        self.turns.append(now_ns)
        if len(self._rig.sampler.numbers) == self._at:
            self._rig.clock.advance(self._stall_ns)
            self._then(control)
            self._at = -1


def stalled(path: Path, at: int, stall_ns: int, **options: Callable[[Control], object]) -> Rig:
    rig = Rig(path, link=FakeLink())
    rig.logger.connect(FakeLink(), Stalling(rig, at, stall_ns, **options))
    return rig


def test_slots_that_pass_while_the_end_is_awaited_are_missed_too(tmp_path: Path) -> None:
    rig = stalled(tmp_path, 34, 6_800_000_000)
    books = rig.logger.run(rig.until(8.0))  # it is asked to end during the stall: no scan follows
    # The last scan begins at 34 * 50 ms; its turn of the link lasts 2 ms + 6.8 s: slot 170 is under way then.
    assert rig.sampler.numbers[-1] == 33
    assert (books.slots, books.written, books.missed) == (170 - 1, 34, 135)
    assert books.absent == ((34, 168),)
    assert books.closes
    result = verify(tmp_path / "s1")
    assert result.ok, result.text
    assert result.missed == 135


def test_slots_that_pass_before_a_recording_is_ended_by_command_are_missed_in_it(tmp_path: Path) -> None:
    rig = stalled(tmp_path, 40, 1_000_000_000, then=lambda control: control.stop_recording())
    books = rig.logger.run(rig.until(6.0))
    assert books.session == "s1"
    assert (books.slots, books.written, books.missed) == (59, 40, 19), "slot 59 is under way and belongs to nobody"
    assert verify(tmp_path / "s1").missed == 19
    assert verify(tmp_path / "s1").ok


def test_slots_that_pass_after_a_recording_is_begun_by_command_are_missed_in_it(tmp_path: Path) -> None:
    rig = Rig(tmp_path, link=FakeLink())

    def begin(control: Control) -> None:
        control.stop_recording()
        control.start_recording()
        rig.clock.advance(1_000_000_000)

    rig.logger.connect(FakeLink(), Stalling(rig, 40, 0, then=begin))
    books = rig.logger.run(rig.until(6.0))
    assert books.session == "s2"
    assert (books.missed, books.absent) == (20 - 1, ((40, 58),))
    assert books.closes
    assert verify(tmp_path / "s2").ok
    assert sorted([*read_recording(tmp_path / "s1").numbers, *read_recording(tmp_path / "s2").numbers]) == [
        *range(40),
        *range(59, books.next_number),
    ]


def test_a_slot_whose_scan_fails_is_missed(tmp_path: Path) -> None:
    def fails(number: int) -> int:
        if number == 50:
            raise ZeroDivisionError
        return 0

    rig = Rig(tmp_path, duration_ns=fails)
    with pytest.raises(ZeroDivisionError):
        rig.logger.run(rig.until(5))
    books = rig.logger.statistics()
    assert books is not None
    assert (books.slots, books.written, books.missed) == (51, 50, 1)


@pytest.mark.parametrize("seed", range(5))
def test_whatever_stalls_slots_close_with_the_clock(tmp_path: Path, seed: int) -> None:
    """Each slot since the first is written or missed: counted from the clock, not from the logger's own numbers."""
    rng = np.random.default_rng(seed)
    rig = Rig(tmp_path, link=FakeLink(), duration_ns=lambda _: int(rng.choice([2e6, 2e6, 2e6, 60e6, 400e6])))

    class Slow(Questions):
        def service(self, now_ns: int, control: Control) -> None:
            rig.clock.advance(int(rng.choice([0, 0, 0, 30e6, 700e6])))

    rig.logger.connect(FakeLink(), Slow())
    asked: list[int] = []

    def stop() -> bool:
        asked.append(rig.clock.monotonic_ns())
        return asked[-1] >= 20 * NS

    books = rig.logger.run(stop)
    since_first = (asked[-1] - asked[0]) // 50_000_000
    assert abs(books.slots - since_first) <= 1
    assert books.slots == books.written + books.missed
    assert books.written == len(rig.sampler.numbers)
    assert books.missed > 50
    assert verify(tmp_path / "s1").ok


def test_the_uplink_waits_while_a_scan_is_due_but_not_for_ever(tmp_path: Path) -> None:
    rig = Rig(tmp_path, link=FakeLink(), duration_ns=lambda _: 60_000_000)  # each scan takes longer than a period
    uplink = Stalling(rig, -1, 0)
    rig.logger.connect(FakeLink(), uplink)
    rig.logger.run(rig.until(20.0))
    pauses = [b - a for a, b in zip(uplink.turns, uplink.turns[1:], strict=False)]
    assert 15 <= len(uplink.turns) <= 21
    assert min(pauses) >= NS
    assert max(pauses) <= NS + 150_000_000


def test_books_at_the_end_are_those_of_the_last_recording_however_long_an_earlier_one_takes_to_close(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = Rig(tmp_path)
    later_closed = threading.Event()
    close = Recorder.close

    def slow(recorder: Recorder, timeout_s: float = 60.0) -> Statistics:
        if recorder.session == "s1":
            assert later_closed.wait(20.0)
        books = close(recorder, timeout_s)
        if recorder.session == "s2":
            later_closed.set()
        return books

    monkeypatch.setattr(Recorder, "close", slow)

    def stop() -> bool:
        n = len(rig.sampler.numbers)
        if n == 20:
            rig.logger.stop_recording()
            rig.logger.start_recording()
        return n >= 40

    assert rig.logger.run(stop).session == "s2"
