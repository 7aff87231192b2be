"""The sampler: `take` reads all sensors once, whatever state they are in; `finish` makes a scan of what was read.

`take` keeps to the scan's schedule. `finish`, which computes the attitude, may wait, so that several scans are finished together.

Sensors share the bus cooperatively. A sample has stages; while one waits (a converter converting), others use the bus.
Converters are started first, and the IMU is read while their first inputs, the vanes, are being converted, so that samples which
are compared in flight are simultaneous. Nothing waits longer than the scan's budget, and a sensor's fault never raises out of
`take`: it becomes a state in the scan and a sentence in `health`.

A group that is not due in a scan (`every` > 1) is missing from that scan's `groups`. Values are recorded for the states ok,
recovering, out of range and stuck; in all other states the channels are unset. Offsets may be negative: a conversion begun in one
scan can end in the next, and a GPS fix is older than its message.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

from daq.acquisition.attitude_source import AttitudeSource
from daq.acquisition.health import GroupHealth, HealthSummary
from daq.acquisition.supervisor import GroupOutcome, Supervisor
from daq.clock import Clock
from daq.contract.channels import GROUP_NAMES
from daq.contract.scan import GroupStatus, RawValue, Scan, SensorState
from daq.sensors.base import Driver, DriverContext
from daq.sensors.bus import I2cBus, SerialPortCalls
from daq.sensors.config import SensorsConfig, build_drivers
from daq.sensors.timebase import TimeBase

BUDGET = 0.8
"""Share of the scan interval that the sensors may use."""

AUDIT_INTERVAL_NS = 50_000_000  # between two audits, each of one chip: a dozen chips take 0.6 s
BUS_HELD_AFTER = 2  # time-outs in a scan after which the bus itself counts as held
BUS_RETRY_NS = 100_000_000  # first pause before a held bus is tried again; it doubles up to the limit below
BUS_RETRY_LIMIT_NS = 1_000_000_000
START_LIMIT_NS = 6_000_000_000  # longest set-up of all sensors at start
SHARED_RATE_HZ = 50.0
FULL_SCAN_HZ = 80.0
"""At scan rates above this, all groups but the IMU are read at `SHARED_RATE_HZ` only, unless the configuration says `every`: a
full scan takes 9.9 ms on a bus of 400 kHz, and sensors may use 80 % of the scan interval."""


@dataclass(frozen=True, slots=True)
class EventMark:
    """An event marked on board. source: `switch` for the pilot's event switch."""

    time_monotonic_ns: int
    scan_number: int
    source: str


class UnfinishedScan(NamedTuple):
    """What was read in one scan: the fields of `Scan`, and an outcome for each group that was due; no attitude yet."""

    number: int
    time_monotonic_ns: int
    time_utc_ns: int
    utc_accuracy_ns: int
    lateness_us: int
    outcomes: dict[str, GroupOutcome]


def _ignore(_: object) -> None:
    return


class Sampler:
    """Reads all fitted sensors once per `take`; pass each result to `finish` once, in order.

    bus, serial: the I2C bus and the GPS receiver's port, real or simulated; None where no fitted sensor needs them. autopilot:
    serial port to one that supplies groups. rate_hz: of the scans. pulse: returns the monotonic time of the newest
    pulse-per-second edge [ns], or None. on_event: called for every edge of the event switch. on_taken: called with every scan as
    soon as it is read, in the sampler's thread. Raises DriverConfigError for a driver or port that is not available.
    """

    def __init__(
        self,
        config: SensorsConfig,
        bus: I2cBus | None,
        serial: SerialPortCalls | None,
        clock: Clock,
        *,
        rate_hz: float = 20.0,
        autopilot: SerialPortCalls | None = None,
        pulse: Callable[[], int | None] | None = None,
        on_event: Callable[[EventMark], None] = _ignore,
        on_taken: Callable[[UnfinishedScan], None] = _ignore,
    ) -> None:
        self.on_event = on_event
        self.on_taken = on_taken
        self._config = config
        self._clock = clock
        self._pulse = pulse
        self._period_ns = round(1e9 / rate_hz)
        self._budget_ns = round(BUDGET * self._period_ns)
        latency = config.gnss.arrival_s if config.gnss else 0.0
        self.timebase = TimeBase(round(latency * 1e9), self._period_ns)
        context = DriverContext(bus, serial, autopilot, clock.monotonic_ns, self.timebase, config.section, rate_hz)
        now_ns = clock.monotonic_ns()
        self._supervisors = {
            group: Supervisor(driver, config.section(group), config.health, self._every(group, driver, rate_hz), now_ns)
            for group, driver in build_drivers(config, context).items()
        }
        ranked = sorted(self._supervisors.values(), key=lambda s: s.driver.precedence)
        self._on_bus = [s for s in ranked if s.driver.uses_i2c]
        self._on_serial = [s for s in ranked if not s.driver.uses_i2c]
        self._all = (*self._on_serial, *self._on_bus)
        self._off = {g: GroupStatus(SensorState.OFF) for g in GROUP_NAMES if g not in config.fitted}
        self._attitude = (
            AttitudeSource(config, rate_hz / self._imu_every(), now_ns) if "attitude" in config.derived else None
        )
        self._bus_held = ""  # why the bus is not used, in words; empty while it works
        self._bus_retry_ns = 0
        self._bus_pause_ns = BUS_RETRY_NS
        self._audit_turn = 0
        self._last_audit_ns = now_ns

    def _every(self, group: str, driver: Driver, rate_hz: float) -> int:
        configured: int | None = self._config.section(group).every
        if configured is not None:
            return configured
        highest = driver.max_rate_hz
        if group != "imu" and driver.uses_i2c and rate_hz > FULL_SCAN_HZ:
            highest = min(highest, SHARED_RATE_HZ)
        return max(1, math.ceil(rate_hz / highest - 1e-9))

    def _imu_every(self) -> int:
        return self._supervisors["imu"].every if "imu" in self._supervisors else 1

    # -- start ------------------------------------------------------------------------------------------------

    def start(self) -> HealthSummary:
        """Set all sensors up, which takes a few seconds; those that fail are set up again between scans."""
        limit = self._clock.monotonic_ns() + START_LIMIT_NS
        pending = [s for s in self._supervisors.values() if not s.up]
        while pending and self._clock.monotonic_ns() < limit:
            supervisor = min((s for s in pending if not self._waits_for(s, pending)), key=lambda s: s.next_try_ns)
            self._clock.sleep_until(supervisor.next_try_ns)
            supervisor.setup_step(self._clock.monotonic_ns(), trusted=True)
            if supervisor.up or not supervisor.setting_up:
                pending.remove(supervisor)
        self._rehearse()
        return self.health()

    def _rehearse(self) -> None:
        """Read all sensors twice and discard the samples, so that their timing in `metadata` is that of a scan."""
        running = [s for s in self._on_bus if s.up]
        for _ in range(2):
            now_ns = self._clock.monotonic_ns()
            self._run(running, now_ns, {})
            for supervisor in self._on_serial:
                self._read_serial(supervisor, 0, {})
            self._clock.sleep_until(now_ns + self._period_ns)
        for supervisor in self._supervisors.values():
            supervisor.end_rehearsal()

    def _waits_for(self, supervisor: Supervisor, others: list[Supervisor]) -> bool:
        """Whether a sensor can be set up only after one of the others."""
        return any(other.group == supervisor.driver.needs for other in others)

    # -- scan -------------------------------------------------------------------------------------------------

    def take(self, number: int, deadline_ns: int) -> UnfinishedScan:
        """Read all sensors now. deadline_ns: scheduled monotonic time of the scan [ns]."""
        start = self._clock.monotonic_ns()
        if self._pulse is not None and (edge := self._pulse()) is not None:
            self.timebase.observe_pulse(edge)
        outcomes: dict[str, GroupOutcome] = {}
        self._read_bus(number, start, outcomes)
        for supervisor in self._on_serial:
            self._read_serial(supervisor, number, outcomes)
        self._maintain(start)
        for outcome in outcomes.values():
            for time_ns in outcome.events:
                self.on_event(EventMark(time_ns, number, "switch"))
        utc, accuracy = self.timebase.utc(start)
        lateness_us = min(max(0, start - deadline_ns) // 1000, 2**32 - 1)
        unfinished = UnfinishedScan(number, start, utc, accuracy, lateness_us, outcomes)
        self.on_taken(unfinished)
        return unfinished

    def finish(self, taken: UnfinishedScan) -> Scan:
        """The scan, with the attitude at its time."""
        number, start, utc, accuracy, lateness_us, outcomes = taken
        groups = dict(self._off)
        values: dict[str, RawValue] = {}
        for group, outcome in outcomes.items():
            groups[group] = GroupStatus(outcome.state, (outcome.time_ns - start) // 1000)
            values.update(outcome.values)
        if self._attitude is not None and "imu" in outcomes:
            attitude = self._attitude.update(outcomes, start)
            groups["attitude"] = GroupStatus(attitude.state, (attitude.time_ns - start) // 1000)
            values.update(attitude.values)
        return Scan(number, start, utc, accuracy, lateness_us, groups, values)

    def _due(self, supervisor: Supervisor, number: int) -> bool:
        return supervisor.starved or (number + self._phase(supervisor)) % supervisor.every == 0

    def _phase(self, supervisor: Supervisor) -> int:
        """Offset [scans] that spreads sensors with `every` > 1 over different scans."""
        return self._on_bus.index(supervisor) if supervisor in self._on_bus else 0

    def _read_bus(self, number: int, start: int, outcomes: dict[str, GroupOutcome]) -> None:
        due = []
        for supervisor in self._on_bus:
            if supervisor.ready_ns is not None:
                due.append(supervisor)
            elif supervisor.every == 1 or self._due(supervisor, number):
                if supervisor.up:
                    due.append(supervisor)
                else:
                    outcomes[supervisor.group] = supervisor.lost(start)
        if self._bus_held and start < self._bus_retry_ns:
            self._skip(due, start, outcomes)
            return
        self._run(due, start, outcomes)

    def _run(self, due: list[Supervisor], start: int, outcomes: dict[str, GroupOutcome]) -> None:
        """Take the due samples within the budget; one that is begun but not finished continues in the next scan."""
        clock, limit = self._clock, start + self._budget_ns
        pending = list(due)
        timeouts = 0
        now_ns = start
        while pending and now_ns <= limit:
            supervisor = self._next(pending, now_ns)
            ready = supervisor.ready_ns
            if ready is None:
                supervisor.starved = False
                supervisor.begin(now_ns)
            elif ready > now_ns:
                if ready > limit:
                    return
                clock.sleep_until(ready)
                now_ns = clock.monotonic_ns()
            outcome = supervisor.advance(now_ns, may_retry=now_ns < limit)
            now_ns = clock.monotonic_ns()
            if outcome is not None:
                outcomes[supervisor.group] = outcome
                pending.remove(supervisor)
            if supervisor.timed_out:
                timeouts += 1
                supervisor.excuse_failure()
                if timeouts >= BUS_HELD_AFTER or self._bus_held:
                    self._hold_bus(now_ns)
                    self._skip(pending, now_ns, outcomes)
                    return
            elif self._bus_held:
                self._bus_held, self._bus_pause_ns = "", BUS_RETRY_NS
        for supervisor in pending:
            if supervisor.ready_ns is None:
                supervisor.starved = True
                outcomes[supervisor.group] = supervisor.skipped("scan ran out of time", SensorState.STALE, now_ns)

    @staticmethod
    def _next(pending: list[Supervisor], now: int) -> Supervisor:
        """Which sensor uses the bus next: one that starts first or was starved, then one that is ready, else the soonest."""
        first_ready: Supervisor | None = None
        soonest, soonest_ns = pending[0], math.inf
        for supervisor in pending:
            ready = supervisor.ready_ns
            if ready is None:
                if supervisor.starved or supervisor.driver.starts_first:
                    return supervisor
                first_ready = first_ready or supervisor
            elif ready <= now:
                first_ready = first_ready or supervisor
            elif ready < soonest_ns:
                soonest, soonest_ns = supervisor, ready
        return first_ready or soonest

    def _hold_bus(self, now: int) -> None:
        self._bus_held = "I2C bus is held low: transfers time out"
        self._bus_retry_ns = now + self._bus_pause_ns
        self._bus_pause_ns = min(2 * self._bus_pause_ns, BUS_RETRY_LIMIT_NS)

    def _skip(self, pending: list[Supervisor], now: int, outcomes: dict[str, GroupOutcome]) -> None:
        for supervisor in pending:
            outcomes[supervisor.group] = supervisor.skipped(self._bus_held, SensorState.ABSENT, now)

    def _read_serial(self, supervisor: Supervisor, number: int, outcomes: dict[str, GroupOutcome]) -> None:
        if supervisor.every != 1 and not self._due(supervisor, number):
            return
        now_ns = self._clock.monotonic_ns()
        if not supervisor.up:
            outcomes[supervisor.group] = supervisor.lost(now_ns)
            return
        supervisor.begin(now_ns)
        outcome = supervisor.advance(now_ns, may_retry=False)
        if outcome is not None:
            outcomes[supervisor.group] = outcome

    def _maintain(self, start: int) -> None:
        """Use the rest of the budget for one set-up step of a lost sensor and, every AUDIT_INTERVAL_NS, one audit."""
        now_ns = self._clock.monotonic_ns()
        failed = [s for s in self._all if not s.up]
        if failed and now_ns < start + self._budget_ns:
            self._set_up(failed, now_ns)
        if self._on_bus and not self._bus_held and start - self._last_audit_ns >= AUDIT_INTERVAL_NS:
            self._last_audit_ns = start
            self._audit_turn = (self._audit_turn + 1) % len(self._on_bus)
            if self._clock.monotonic_ns() < start + self._budget_ns:
                self._on_bus[self._audit_turn].audit(now_ns)

    def _set_up(self, down: list[Supervisor], now: int) -> None:
        """Run one set-up step of the sensor that is overdue by most, of those that can be reached."""
        ready = [
            s
            for s in down
            if s.next_try_ns <= now and not self._waits_for(s, down) and not (self._bus_held and s.driver.uses_i2c)
        ]
        if ready:
            min(ready, key=lambda s: s.next_try_ns).setup_step(now)

    # -- reports ----------------------------------------------------------------------------------------------

    def health(self) -> HealthSummary:
        """State of every group in table order."""
        records = {g: s.record for g, s in self._supervisors.items()}
        if self._attitude is not None:
            records["attitude"] = self._attitude.record
        now_ns = self._clock.monotonic_ns()
        not_fitted = {g: GroupHealth(g, SensorState.OFF, since_ns=now_ns, required=False) for g in self._off}
        groups = tuple(replace(records.get(g) or not_fitted[g]) for g in GROUP_NAMES)
        return HealthSummary(now_ns, groups, self._bus_held)

    def refusals(self) -> dict[str, str]:
        """Group -> which request its device refused, in words."""
        return {g: s.driver.refusal for g, s in self._supervisors.items() if s.driver.refusal}

    def metadata(self) -> dict[str, str]:
        """What is needed to interpret the counts, `group.key` -> text; goes into every recording."""
        flat = {"sensors.rate_hz": repr(round(1e9 / self._period_ns, 6))}
        for group, supervisor in self._supervisors.items():
            flat[f"{group}.every"] = str(supervisor.every)
            flat.update({f"{group}.{key}": text for key, text in supervisor.driver.metadata().items()})
        return flat
