"""Health of the sensors as data: for each group a state, a sentence, the time of the last change and counters.

`GroupWatch` judges the values of one group over time (stuck, implausible, spikes); the supervisor adds faults of transfers.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from daq.contract.channels import CHANNEL_BY_NAME, GROUPS
from daq.contract.recordings.messages import Health, HealthEntry
from daq.contract.scan import RawValue, SensorState
from daq.sensors.config import HealthConfig

_TITLES = {g.name: g.title for g in GROUPS}


@dataclass(slots=True)
class GroupHealth:
    """Health of one sensor group; its supervisor updates it, and others get copies.

    detail: what is wrong, in words; empty without a fault. since_ns: monotonic time of the last change of state [ns]. retries:
    repeated transfers. setups: how often the chip was set up (1 after a clean start). upsets: how often its settings had changed
    when read back. required: no flight without it.
    """

    group: str
    state: SensorState
    detail: str = ""
    since_ns: int = 0
    retries: int = 0
    setups: int = 0
    upsets: int = 0
    required: bool = True

    def note(self, state: SensorState, detail: str, time_ns: int) -> None:
        """Set the state at `time_ns` and from then on."""
        if state is not self.state:
            self.state, self.since_ns = state, time_ns
        self.detail = detail

    @property
    def title(self) -> str:
        """The group's title."""
        return _TITLES.get(self.group, self.group)

    @property
    def words(self) -> str:
        """One line: title, state and detail."""
        return f"{self.title}: {self.state.words}" + (f" ({self.detail})" if self.detail else "")


@dataclass(frozen=True, slots=True)
class HealthSummary:
    """All groups, in table order, at one moment."""

    time_ns: int
    groups: tuple[GroupHealth, ...]
    bus_fault: str = ""

    @property
    def failing(self) -> tuple[GroupHealth, ...]:
        """Fitted groups that are not usable now."""
        return tuple(g for g in self.groups if g.state not in (SensorState.OK, SensorState.OFF))

    @property
    def ready(self) -> bool:
        """Whether every required sensor and the bus work."""
        return not self.bus_fault and not any(g.required for g in self.failing)

    def group(self, name: str) -> GroupHealth:
        """The health of one group. Raises KeyError for an unknown one."""
        for g in self.groups:
            if g.group == name:
                return g
        raise KeyError(name)

    @property
    def words(self) -> str:
        """One sentence: all faults, or that there is none."""
        faults = [self.bus_fault] if self.bus_fault else []
        faults += [g.words for g in self.failing]
        return "; ".join(faults) if faults else "all fitted sensors are well"


@dataclass(frozen=True, slots=True)
class SampleVerdict:
    """The judgement of `GroupWatch` on one sample."""

    state: SensorState = SensorState.OK
    detail: str = ""


WELL = SampleVerdict()


class GroupWatch:
    """Judges the samples of one group: limits, spikes, values that never change.

    chip_steps: the driver's largest steps [counts] by channel, in force unless the configuration sets `max_step`.
    """

    def __init__(
        self, channels: tuple[str, ...], config: HealthConfig, chip_steps: Mapping[str, float] = MappingProxyType({})
    ) -> None:
        self._limits = {
            c: config.plausible.get(c, CHANNEL_BY_NAME[c].limits()) for c in channels if c in config.plausible
        }
        steps = config.max_step if "max_step" in config.model_fields_set else {**config.max_step, **chip_steps}
        self._max_step = {c: steps[c] for c in channels if c in steps}
        self._stuck_ns = {c: round(config.stuck_s[c] * 1e9) for c in channels if c in config.stuck_s}
        self.restart()

    def restart(self) -> None:
        """Discard all history, after a gap in the samples."""
        self._unchanged: dict[
            str, tuple[RawValue, int]
        ] = {}  # last value of each channel, and since when it has it [ns]
        self._level: dict[str, RawValue] = {}  # last value that was no spike
        self._doubtful: dict[str, RawValue] = {}  # a spike, unless the next sample confirms it

    def judge(self, values: Mapping[str, RawValue], time_ns: int) -> SampleVerdict:
        """The verdict on one sample, taken at monotonic `time_ns` [ns]."""
        verdict = self._range(values) if self._limits else None
        if verdict is None and self._max_step:
            verdict = self._spike(values)
        if verdict is None and self._stuck_ns:
            verdict = self._stuck(values, time_ns)
        return verdict or WELL

    def _range(self, values: Mapping[str, RawValue]) -> SampleVerdict | None:
        for name, (low, high) in self._limits.items():
            value = values.get(name)
            if value is not None and not low <= value <= high:
                return SampleVerdict(SensorState.OUT_OF_RANGE, f"{name} {value} outside {low:g} to {high:g}")
        return None

    def _spike(self, values: Mapping[str, RawValue]) -> SampleVerdict | None:
        verdict = None
        for name, step in self._max_step.items():
            value = values.get(name)
            if value is None:
                continue
            level = self._level.get(name, value)
            if not self._doubtful and abs(value - level) <= step:
                self._level[name] = value
                continue
            doubtful = self._doubtful.pop(name, None)
            confirmed = doubtful is not None and abs(value - doubtful) <= step
            if abs(value - level) <= step or confirmed:
                self._level[name] = value
            else:
                self._doubtful[name] = value
                verdict = SampleVerdict(SensorState.OUT_OF_RANGE, f"{name} jumped from {level} to {value}")
        return verdict

    def _stuck(self, values: Mapping[str, RawValue], time_ns: int) -> SampleVerdict | None:
        verdict = None
        for name, limit_ns in self._stuck_ns.items():
            value = values.get(name)
            if value is None:
                continue
            last_change = self._unchanged.get(name)
            if last_change is None or value != last_change[0]:
                self._unchanged[name] = value, time_ns
            elif time_ns - last_change[1] > limit_ns:
                verdict = SampleVerdict(
                    SensorState.STUCK, f"{name} at {value} for {(time_ns - last_change[1]) * 1e-9:.1f} s"
                )
        return verdict


def repetitions(summary: HealthSummary) -> str:
    """Repeated transfers and restored settings by sensor, in words: a failing connector shows here first."""
    retries = [f"{g.title} {g.retries}" for g in summary.groups if g.retries]
    upsets = [f"{g.title} {g.upsets}" for g in summary.groups if g.upsets]
    repeated = f"; transfers repeated: {', '.join(retries)}" if retries else ""
    return repeated + (f"; settings put right: {', '.join(upsets)}" if upsets else "")


def as_message(summary: HealthSummary, utc_ns: int, number: int) -> Health:
    """The summary as the message of a recording. utc_ns: present time [ns]; number: of the scan."""
    entries = tuple(
        HealthEntry(g.group, int(g.state), g.words, max(0, g.since_ns), max(0, g.setups - 1) + g.retries)
        for g in summary.groups
    )
    return Health(summary.time_ns, max(0, utc_ns), number, entries)
