"""Supervision of one sensor: reads and judges it, sets it up again after a failure, and never delays the scan.

A sample that fails is repeated up to three times in the same scan. A sensor that fails in two scans in a row is down: it is set
up again at growing intervals, at most one short step in a scan. Its first samples after that are marked recovering. Every
exception of a driver that means a hardware fault becomes a state.
"""

from collections.abc import Generator, Mapping
from typing import NamedTuple

from daq.acquisition.health import WELL, GroupHealth, GroupWatch
from daq.contract.channels import channels_of
from daq.contract.scan import RawValue, SensorState
from daq.sensors.base import NO_VALUES, SECOND, Driver, Reading, SensorError, SensorSection, Wait
from daq.sensors.bus import TIMEOUT_ERRNOS
from daq.sensors.config import HealthConfig

REPETITIONS = 3
"""Repetitions of a failed sample within a scan, while the scan's budget lasts."""

GIVE_UP_AFTER = 2
"""Failed scans in a row after which a sensor counts as down and is set up again."""

EXCUSES = 20
"""Time-outs in a row that are attributed to the bus before a sensor counts as down for holding it."""

_OK = SensorState.OK

# In these states the value is the chip's and is recorded; in the others there is none, or an old one.
VALUES_RECORDED = frozenset({SensorState.OK, SensorState.OUT_OF_RANGE, SensorState.STUCK, SensorState.RECOVERING})


class GroupOutcome(NamedTuple):
    """What a group contributes to a scan. time_ns: of the sample; events: edges of the event switch; monotonic [ns]."""

    state: SensorState
    detail: str = ""
    time_ns: int = 0
    values: Mapping[str, RawValue] = NO_VALUES
    events: tuple[int, ...] = ()


class Supervisor:
    """A driver with its health. every: read in every n-th scan. No call blocks, and none raises for a hardware fault."""

    def __init__(self, driver: Driver, section: SensorSection, config: HealthConfig, every: int, now_ns: int) -> None:
        self.driver = driver
        self.group = driver.group
        self.every = every
        self.record = GroupHealth(
            self.group, SensorState.ABSENT, "not set up yet", since_ns=now_ns, required=section.required
        )
        self.starved = False  # the last scan ran out of time before this sensor: the next begins with it
        self.ready_ns: int | None = None  # when the current sample can continue [ns]; None without one
        self.timed_out = False  # the last transfer timed out: the bus itself may be held
        self.up = False  # set up and being read
        self._config = config
        self._watch = GroupWatch(tuple(c.name for c in channels_of(self.group)), config, driver.max_step)
        self._staged = type(driver).stages is not Driver.stages
        self._setup: Generator[Wait, None, None] | None = None
        self._sample: Generator[Wait, None, Reading] | None = None
        self._repetitions = 0  # still allowed for the current sample
        self._failures = 0  # failed scans in a row
        self._excused = 0  # time-outs in a row attributed to the bus
        self._next_try_ns = now_ns
        self._pause_ns = round(config.retry_s * SECOND)
        self._untrusted = 0  # samples to come that are marked recovering
        self._stale_since_ns: int | None = None
        self._lost_state = SensorState.ABSENT
        self._lost_detail = "not set up yet"

    # -- set-up -----------------------------------------------------------------------------------------------

    @property
    def setting_up(self) -> bool:
        """Whether a set-up has begun and not ended."""
        return self._setup is not None

    @property
    def next_try_ns(self) -> int:
        """When the next set-up step of a sensor that is down is due [ns]."""
        return self._next_try_ns

    def setup_step(self, now_ns: int, trusted: bool = False) -> None:
        """Run one step of the set-up. trusted: mark no samples recovering (first start)."""
        if self._setup is None:
            self._setup = self.driver.initialise()
        try:
            self._next_try_ns = now_ns + next(self._setup)
        except StopIteration:
            self._setup = None
            self._come_up(trusted, now_ns)
        except SensorError as error:
            self._setup_failed(SensorState.FAULT, str(error), now_ns)
        except OSError as error:
            self.timed_out = error.errno in TIMEOUT_ERRNOS
            self._setup_failed(SensorState.ABSENT, f"does not answer: {error.strerror or error}", now_ns)

    def _come_up(self, trusted: bool, now_ns: int) -> None:
        self.up = True
        self._failures = 0
        self._pause_ns = round(self._config.retry_s * SECOND)
        self._untrusted = 0 if trusted else self._config.trust_after
        self._stale_since_ns = None
        self._watch.restart()
        self.record.setups += 1
        self.record.note(SensorState.OK if trusted else SensorState.RECOVERING, "", now_ns)

    def _setup_failed(self, state: SensorState, detail: str, now_ns: int) -> None:
        self._setup = None
        self._lost_state, self._lost_detail = state, detail
        self.record.note(state, detail, now_ns)
        self._next_try_ns = now_ns + self._pause_ns
        self._pause_ns = min(2 * self._pause_ns, round(self._config.retry_limit_s * SECOND))

    def _go_down(self, state: SensorState, detail: str, now_ns: int) -> None:
        self.up = False
        self._setup = None
        self._lost_state, self._lost_detail = state, detail
        self._next_try_ns = now_ns

    def end_rehearsal(self) -> None:
        """End the rehearsal: the driver stores its timing, and the judgement of samples starts over."""
        self.driver.store_timing()
        self._watch.restart()
        self.starved = False

    # -- reading ----------------------------------------------------------------------------------------------

    def begin(self, now_ns: int) -> None:
        """Begin a sample; `advance` runs its stages."""
        if self._staged:
            self._sample = self.driver.stages()
        self.ready_ns = now_ns
        self._repetitions = REPETITIONS

    def advance(self, now_ns: int, may_retry: bool) -> GroupOutcome | None:
        """Run one stage of the sample; returns the outcome when it is finished, else None."""
        self.timed_out = False
        try:
            if self._sample is not None:
                self.ready_ns = now_ns + next(self._sample)
                return None
            reading = self.driver.read()
            self.ready_ns = None
            return self._finished(reading, now_ns)
        except StopIteration as finished:
            self._end_sample()
            return self._finished(finished.value, now_ns)
        except SensorError as error:
            self._end_sample()
            self._go_down(SensorState.FAULT, str(error), now_ns)
            return self._outcome(SensorState.FAULT, str(error), now_ns)
        except OSError as error:
            return self._failed(error, now_ns, may_retry)

    def _end_sample(self) -> None:
        self._sample = self.ready_ns = None

    def _failed(self, error: OSError, now_ns: int, may_retry: bool) -> GroupOutcome | None:
        self._end_sample()
        self.timed_out = error.errno in TIMEOUT_ERRNOS
        if may_retry and self._repetitions and not self.timed_out:
            remaining = self._repetitions - 1
            self.begin(now_ns)
            self._repetitions = remaining
            self.record.retries += 1
            return None
        detail = f"does not answer: {error.strerror or error}"
        self._failures += 1
        if self._failures >= GIVE_UP_AFTER or (self.timed_out and self._excused >= EXCUSES):
            self._go_down(SensorState.ABSENT, detail, now_ns)
        return self._outcome(SensorState.ABSENT, detail, now_ns)

    def _finished(self, reading: Reading, started_ns: int) -> GroupOutcome:
        self._failures = self._excused = 0
        if self.driver.repeated:
            self.record.retries += self.driver.repeated
            self.driver.repeated = 0
        values, state, detail, time_ns, events = reading
        if time_ns is None:
            time_ns = started_ns
        if state is not _OK:
            self._note_chip_state(state, detail, started_ns)
            return self._outcome(state, detail, time_ns, reading)
        # the chip reports no fault: now the values over time, then whether the sensor is still recovering
        self._stale_since_ns = None
        verdict = self._watch.judge(values, time_ns)
        if verdict is not WELL:
            return self._outcome(verdict.state, verdict.detail, time_ns, reading)
        if self._untrusted > 0:
            self._untrusted -= 1
            return self._outcome(SensorState.RECOVERING, "answers again", time_ns, reading)
        self.record.note(_OK, "", time_ns)
        return GroupOutcome(_OK, "", time_ns, values, events)

    def _note_chip_state(self, state: SensorState, detail: str, now_ns: int) -> None:
        if state is SensorState.FAULT:
            self._go_down(state, detail, now_ns)
        elif state in (SensorState.STALE, SensorState.ABSENT):
            self._check_staleness(state, detail, now_ns)
        else:
            self._stale_since_ns = None

    def _check_staleness(self, state: SensorState, detail: str, now_ns: int) -> None:
        """Set up again a chip that answers without new samples for too long: it has lost its settings, or hangs."""
        if self._stale_since_ns is None:
            self._stale_since_ns = now_ns
        stale_ns = now_ns - self._stale_since_ns
        if stale_ns >= 4 * self._config.stale_s * SECOND or (
            stale_ns >= self._config.stale_s * SECOND and not self._intact()
        ):
            self._stale_since_ns = None
            if state is SensorState.ABSENT:
                self._go_down(state, detail, now_ns)
            else:
                self._go_down(SensorState.FAULT, "no new samples; being set up again", now_ns)

    def _intact(self) -> bool:
        """Whether the chip still has its settings; True where it does not answer, which the next reading will show."""
        try:
            return self.driver.intact()
        except OSError:
            return True

    def excuse_failure(self) -> None:
        """Do not count the last failure, which may be the bus's; at most EXCUSES times in a row."""
        if self._excused < EXCUSES:
            self._excused += 1
            self._failures = 0

    def audit(self, now_ns: int) -> None:
        """Set the chip up again if it has lost its settings; after a brown-out it may answer without them."""
        if self.up and self.ready_ns is None and not self._intact():
            self.record.upsets += 1
            self._go_down(
                SensorState.FAULT, "lost its settings (supply dip, or a bit flipped); being set up again", now_ns
            )

    def skipped(self, reason: str, state: SensorState, now_ns: int) -> GroupOutcome:
        """The outcome of a scan in which the sensor was not read, for a reason other than its own fault."""
        if self._sample is not None:
            self._sample.close()
        self._end_sample()
        return self._outcome(state, reason, now_ns)

    def lost(self, now_ns: int) -> GroupOutcome:
        """The outcome of a scan while the sensor is down."""
        return self._outcome(self._lost_state, self._lost_detail, now_ns)

    def _outcome(self, state: SensorState, detail: str, time_ns: int, reading: Reading | None = None) -> GroupOutcome:
        self.record.note(state, detail, time_ns)
        if reading is None or state not in VALUES_RECORDED:
            return GroupOutcome(state, detail, time_ns, events=reading.events if reading else ())
        return GroupOutcome(state, detail, time_ns, reading.values, reading.events)
