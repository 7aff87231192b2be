"""Health of the sensors as data: a state with a sentence for each group, since when, and how often.

`Watch` judges the values of one group over time (stuck, implausible, spikes); the sampler adds what it learns on the bus.
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
    """How one sensor group is; kept up by its supervisor, handed out as copies.

    detail: what is wrong, in words; empty when nothing is. since_ns: monotonic time of the last change of state.
    retries: transfers that had to be repeated. setups: how often the chip was set up (1 after a clean start).
    upsets: how often its settings were found changed when they were read back, and put right.
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
        """The state from now on."""
        if state is not self.state:
            self.state, self.since_ns = state, time_ns
        self.detail = detail

    @property
    def title(self) -> str:
        """What it is, for a person."""
        return _TITLES.get(self.group, self.group)

    @property
    def words(self) -> str:
        """One line for a person: what it is, how it is, and why."""
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
        """Whether every required sensor is well."""
        return not self.bus_fault and not any(g.required for g in self.failing)

    def group(self, name: str) -> GroupHealth:
        """The health of one group. Raises KeyError for an unknown one."""
        for g in self.groups:
            if g.group == name:
                return g
        raise KeyError(name)

    @property
    def words(self) -> str:
        """One sentence: all well, or what is not."""
        faults = [self.bus_fault] if self.bus_fault else []
        faults += [g.words for g in self.failing]
        return "; ".join(faults) if faults else "all fitted sensors are well"


@dataclass(frozen=True, slots=True)
class SampleVerdict:
    """What `GroupWatch` thinks of one sample."""

    state: SensorState = SensorState.OK
    detail: str = ""


WELL = SampleVerdict()


class GroupWatch:
    """Judges the samples of one group: limits, spikes, values that never change. of_chip: its largest steps."""

    def __init__(
        self, channels: tuple[str, ...], config: HealthConfig, of_chip: Mapping[str, float] = MappingProxyType({})
    ) -> None:
        self._limits = {
            c: config.plausible.get(c, CHANNEL_BY_NAME[c].limits()) for c in channels if c in config.plausible
        }
        steps = config.max_step if "max_step" in config.model_fields_set else {**config.max_step, **of_chip}
        self._max_step = {c: steps[c] for c in channels if c in steps}
        self._stuck_ns = {c: round(config.stuck_s[c] * 1e9) for c in channels if c in config.stuck_s}
        self.forget()

    def forget(self) -> None:
        """Start afresh, after the sensor was away."""
        self._held: dict[str, tuple[RawValue, int]] = {}  # last value of each channel, and when it took it
        self._level: dict[str, RawValue] = {}
        self._doubtful: dict[str, RawValue] = {}

    def judge(self, values: Mapping[str, RawValue], time_ns: int) -> SampleVerdict:
        """The verdict on one sample taken at `time_ns`."""
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
            last_change = self._held.get(name)
            if last_change is None or value != last_change[0]:
                self._held[name] = value, time_ns
            elif time_ns - last_change[1] > limit_ns:
                verdict = SampleVerdict(
                    SensorState.STUCK, f"{name} at {value} for {(time_ns - last_change[1]) * 1e-9:.1f} s"
                )
        return verdict


def repetitions(summary: HealthSummary) -> str:
    """Which sensors had to be asked again or set right, in words: a connector on its way out shows here first."""
    retries = [f"{g.title} {g.retries}" for g in summary.groups if g.retries]
    upsets = [f"{g.title} {g.upsets}" for g in summary.groups if g.upsets]
    repeated = f"; transfers repeated: {', '.join(retries)}" if retries else ""
    return repeated + (f"; settings put right: {', '.join(upsets)}" if upsets else "")


def as_message(summary: HealthSummary, utc_ns: int, number: int) -> Health:
    """The report as recordings have it. utc_ns: UTC of now [ns]; number: of the scan."""
    entries = tuple(
        HealthEntry(g.group, int(g.state), g.words, max(0, g.since_ns), max(0, g.setups - 1) + g.retries)
        for g in summary.groups
    )
    return Health(summary.time_ns, max(0, utc_ns), number, entries)
