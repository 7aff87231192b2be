"""The gap monitor of one flight: samples in, alarms out."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq.identification.airframe import Airframe, Sample
from daq.identification.live import GAP
from daq.identification.monitor.bank import LATERAL_PLANE, MonitoredEffect, MonitoredPlane
from daq.identification.monitor.evidence import MonitorEvidence
from daq.identification.monitor.motions import inputs_of
from daq.identification.monitor.predictors import FlightsScan, Innovation, PredictorBank
from daq.identification.monitor.threshold import BEGIN_S, Calibration, strongest, whitened

LEADING = 0.8  # least share of the largest score of an effect that is named besides the first
MOST_NAMED = 4  # effects of an alarm
QUIET_S = 10.0  # s of flight below the threshold after which an alarm ends
SURER = 1.25  # ratio of scores from which an alarm's effects are replaced by those of a later one
NAMED_WITHIN_S = 15.0  # s after the alarm in which that may happen; later evidence may be of another change


@dataclass(frozen=True)
class Name:
    """A possible effect: its present size in its unit, and its score, the size in standard deviations beyond the model's prior
    error; half the square of the score is the gain in log likelihood."""

    effect: str
    title: str
    size: float
    unit: str
    score: float


@dataclass(frozen=True)
class Alarm:
    """The model no longer describes the aircraft. time: of the alarm [s]; since: estimated onset [s].

    equation: the one concerned (CY, Cl, Cn, kinematics, actuator, sensor); channels: those with the evidence; leading: possible
    effects, most likely first, empty where only the energy of the errors has risen, which often happens before the effect can be
    named; named: when they were named [s], None while there are none. score, threshold: in the same units.
    """

    time: float
    since: float
    equation: str
    channels: tuple[str, ...]
    score: float
    threshold: float
    leading: tuple[Name, ...]
    named: float | None = None

    @property
    def text(self) -> str:
        """The alarm in words, without its time."""
        place = f"the model no longer holds in {self.equation} (shown by {', '.join(self.channels)})"
        strength = f"since about {self.since:.1f} s; score {self.score:.1f}, threshold {self.threshold:.1f}"
        if not self.leading:
            return f"{place}, {strength}; errors have grown, and no effect of the list explains them so far"
        names = "; ".join(f"{n.effect} ({n.title}) {n.size:.2g} {n.unit}".removesuffix(" 1") for n in self.leading)
        named_at = f" (by {self.named:.1f} s)" if self.named is not None and self.named > self.time else ""
        return f"{place}, {strength}; leading{named_at}: {names}"


@dataclass(frozen=True)
class MonitorState:
    """State of the monitor. time [s]; watched: manoeuvring flight so far [s]; score: the larger of both statistics, in units of
    its threshold."""

    time: float
    watched: float
    score: float
    alarm: Alarm | None


class GapMonitor:
    """Monitors samples of manoeuvring flight in order of time (`stretches` selects them). alarms: all so far, in order; the
    effects of the last one are updated while they become clearer, its time is not."""

    def __init__(
        self,
        airframe: Airframe,
        values: Mapping[str, float],
        effects: Sequence[MonitoredEffect],
        calibration: Calibration,
        plane: MonitoredPlane = LATERAL_PLANE,
    ) -> None:
        self._effects = tuple(effects)
        self._calibration = calibration
        self._plane = plane
        self._airframe = airframe
        self._bank = PredictorBank(airframe, values, effects, plane)
        self._evidence = MonitorEvidence(effects)
        self._past: list[Innovation] = []
        self._last = -math.inf
        self._in_stretch = 0.0
        self._quiet = math.inf
        self._active: Alarm | None = None
        self.watched = 0.0
        self.alarms: list[Alarm] = []

    def add(self, sample: Sample) -> MonitorState | None:
        """Add a sample. Returns the state every half second, None in between."""
        if not self._plane.regression.credible(sample) or sample.time <= self._last:
            return None
        gap = sample.time - self._last
        if gap > GAP:
            self._bank.restart()
            self._past.clear()
        else:
            self.watched += gap
        self._last = sample.time
        innovation = self._bank.innovation(_scan_of(sample, self._plane, self._airframe))
        if innovation is None:
            return None
        self._past = [*self._past, innovation][-3:]
        if len(self._past) < 3:
            return None
        if not self._evidence.add(innovation.time, *whitened(self._calibration.whitening, self._past)):
            return None
        return self._judge(sample.time)

    def _judge(self, time: float) -> MonitorState:
        if self.watched < BEGIN_S:
            return MonitorState(time, self.watched, 0.0, None)
        score, c = self._evidence.score(), self._calibration
        by_window = c.effects.of(score.z)[0]
        with np.errstate(invalid="ignore"):
            energy = np.nan_to_num(c.channels.of(np.log(score.unnamed))[0], nan=-math.inf)
        level = max(float(np.abs(by_window).max()) / c.named, float(energy.max()) / c.unnamed)
        if level < 1.0:
            self._quiet += 0.5
            if self._quiet >= QUIET_S:
                self._active = None
            return MonitorState(time, self.watched, level, self._active)
        self._quiet = 0.0
        alarm = self._alarm(time, by_window, score.z[0, -1], energy)
        if self._active is None:
            self.alarms.append(alarm)
        elif _clearer(alarm, self.alarms[-1]):
            self.alarms[-1] = _updated(self.alarms[-1], alarm)
        self._active = alarm
        return MonitorState(time, self.watched, level, alarm)

    def _alarm(self, time: float, by_window: np.ndarray, gains: np.ndarray, energy: np.ndarray) -> Alarm:
        """by_window: (windows, effects) standardised scores; gains: (effects,) scores of the longest window, not standardised;
        energy: (channels,).

        Any window can raise the alarm. Effects are named by the longest, for over two seconds a slipped vane looks like one that
        lags. They are ordered by likelihood, that is by the scores that are not standardised: standardised ones would prefer
        effects whose scores are usually small.
        """
        c = self._calibration
        level = float(np.abs(by_window).max())
        nameable = bool(np.abs(by_window[-1]).max() >= c.named)
        effect_scores = gains if nameable else strongest(by_window)
        order = np.argsort(-np.abs(effect_scores))
        strongest_effect = int(order[0])
        if level < c.named:
            channel = self._plane.channels[int(np.argmax(energy))]
            return Alarm(time, time, self._plane.equations[channel], (channel,), float(energy.max()), c.unnamed, ())
        leading = tuple(
            self._name(int(k), float(effect_scores[k]))
            for k in order[:MOST_NAMED]
            if nameable and abs(effect_scores[k]) >= LEADING * abs(effect_scores[strongest_effect])
        )
        return Alarm(
            time,
            self._evidence.onset(0, strongest_effect)[0],
            self._effects[strongest_effect].equation,
            tuple(self._plane.channels[i] for i in self._evidence.channels(0, strongest_effect)),
            level,
            c.named,
            leading,
            time if nameable else None,
        )

    def _name(self, k: int, score: float) -> Name:
        effect = self._effects[k]
        _, size = self._evidence.onset(0, k)
        return Name(effect.name, effect.title, size * effect.step, effect.unit, abs(score))


def _clearer(now: Alarm, reported: Alarm) -> bool:
    """Whether the present alarm names the effects of the reported one better."""
    if not now.leading or now.time > reported.time + NAMED_WITHIN_S:
        return False
    return not reported.leading or now.score > SURER * reported.score


def _updated(reported: Alarm, now: Alarm) -> Alarm:
    same_effect = bool(reported.leading) and reported.leading[0].effect == now.leading[0].effect
    onset = min(now.since, reported.time)  # the onset cannot be after the alarm
    return replace(now, time=reported.time, since=onset, named=reported.named if same_effect else now.named)


def _scan_of(s: Sample, plane: MonitoredPlane, airframe: Airframe) -> FlightsScan:
    measured = np.array([[getattr(s, channel)] for channel in plane.channels])
    kind = inputs_of(plane)
    driving = kind(*(np.array([getattr(s, name)]) for name in kind._fields[:-2]))
    mass_ratio, cg_ahead = np.array([airframe.mass_ratio(s.mass)]), np.array([airframe.cg_ahead(s.cg_x)])
    return FlightsScan(s.time, measured, driving._replace(mass_ratio=mass_ratio, cg_ahead=cg_ahead))


class GapMonitors:
    """The monitors of several planes of one aircraft as one: alarms in order of time, and the largest score."""

    def __init__(self, monitors: Sequence[GapMonitor]) -> None:
        self._monitors = tuple(monitors)
        self._levels = [0.0] * len(self._monitors)

    def add(self, sample: Sample) -> MonitorState | None:
        """Add a sample, as `GapMonitor.add`."""
        latest = None
        for k, monitor in enumerate(self._monitors):
            state = monitor.add(sample)
            if state is not None:
                self._levels[k] = state.score
                latest = state if latest is None or latest.alarm is None else latest
        return None if latest is None else replace(latest, watched=self.watched, score=max(self._levels))

    @property
    def watched(self) -> float:
        """Longest manoeuvring flight of any of them so far [s]."""
        return max(monitor.watched for monitor in self._monitors)

    @property
    def alarms(self) -> tuple[Alarm, ...]:
        """All alarms so far, in order of time."""
        return tuple(sorted((a for monitor in self._monitors for a in monitor.alarms), key=lambda a: a.time))
