"""The shapes of an effect without a name: a curve, a lag, a swing, an event in time, a held instrument, a held-out flight."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from estimation.engine.kernel import Array

TURN = 2.0 * math.pi  # rad


def rounded(value: float | None, digits: int = 4) -> float | None:
    """Rounded for a file; None where `value` is None or not finite, which JSON cannot hold."""
    return None if value is None or not math.isfinite(value) else round(float(value), digits)


def rounded_fields(record: object, **digits: int) -> dict[str, float | None]:
    """Fields of a record for a file, each rounded to so many digits."""
    return {name: rounded(getattr(record, name), n) for name, n in digits.items()}


def rounded_estimate(estimate: tuple[float, float], digits: int) -> dict[str, float | None]:
    """(value, standard deviation) for a file."""
    value, std = estimate
    return {"estimate": rounded(value, digits), "std": rounded(std, digits)}


@dataclass(frozen=True)
class Alike:
    """An effect of the catalogue with the form of a shape. estimate: (value, bound) of its parameter; why_not: the reason why the
    shape is not given its name."""

    effect: str
    title: str
    parameter: str
    estimate: tuple[float, float]
    unit: str
    why_not: str

    def to_json(self) -> dict[str, Any]:
        estimate = rounded_estimate(self.estimate, 9)
        return {
            "effect": self.effect, "parameter": self.parameter, **estimate, "unit": self.unit, "why_not": self.why_not,
        }  # fmt: skip


@dataclass(frozen=True)
class ShapeCurve:
    """A nameless part of a coefficient as a function of one or two variables.

    output: the coefficient. variables: one, or two where it is a function of the first times the second. grid: (n,) values of
    the first; value, std: (n,) the part and its standard deviation there (per unit of the second). unit: of the grid. low, high:
    range flown; the function is constant outside. closed: share of the gap above that of flights with nothing hidden, held-out
    where there are such flights, by whitened energy or plain. analytic: a formula that does as well, or None; candidates:
    (formula, unknown -> (estimate, bound), share of the whitened energy closed, whether that is as good). rivals: (coefficient,
    variables, share of this one's gain). left_out: (training flight, share of it within the range of the others, twice the
    log-likelihood gained where it is predicted from them). alike: effects of the catalogue with the form of a candidate that is
    as good as the curve.
    """

    output: str
    variables: tuple[str, ...]
    grid: Array
    value: Array
    std: Array
    unit: str
    low: float
    high: float
    closed: float
    analytic: str | None
    candidates: tuple[tuple[str, Mapping[str, tuple[float, float]], float, bool], ...]
    rivals: tuple[tuple[str, tuple[str, ...], float], ...]
    left_out: tuple[tuple[str, float, float], ...]
    regime: str
    separate_by: str
    alike: tuple[Alike, ...] = ()

    def to_json(self) -> dict[str, Any]:
        return {
            "kind": "function", "nameless": True, "output": self.output, "variables": list(self.variables),
            "grid": [[rounded(x, 6) for x in self.grid]], "value": [rounded(v, 9) for v in self.value],
            "std": [rounded(v, 9) for v in self.std], "unit": self.unit, "range": [rounded(self.low, 6), rounded(self.high, 6)],
            "closed": rounded(self.closed), "analytic": self.analytic,
            "candidates": [
                {"analytic": text, "closed": rounded(closed), "as_good": as_good,
                 "parameters": {n: rounded_estimate(e, 9) for n, e in estimates.items()}}
                for text, estimates, closed, as_good in self.candidates
            ],
            "alternatives": [{"output": o, "variables": list(v), "share_of_gain": rounded(g, 3)} for o, v, g in self.rivals],
            "left_out": [{"flight": n, "inside": rounded(i, 3), "gain": rounded(g, 1)} for n, i, g in self.left_out],
            "regime": self.regime, "separate_by": self.separate_by, "alike": [a.to_json() for a in self.alike],
        }  # fmt: skip


@dataclass(frozen=True)
class LaggedTerm:
    """A coefficient that lags a variable, where no function of the motion closes the gap. line: the coefficient; time: time
    constant [s]; gain: twice the log-likelihood by linear theory."""

    line: str
    variable: str
    time: float
    gain: float
    score: float
    threshold: float

    @property
    def words(self) -> str:
        return f"{self.line} follows {self.variable} some {self.time:.2g} s late"

    def to_json(self) -> dict[str, Any]:
        return {
            "kind": "memory", "nameless": True, "output": self.line, "variables": [self.variable],
            "time_constant": round(self.time, 3), **rounded_fields(self, score=2, threshold=2),
        }  # fmt: skip


@dataclass(frozen=True)
class SwingingTerm:
    """A coefficient with a part that an oscillator adds. line: the coefficient. by: acceleration (ax, ay, az m/s2; p_dot, q_dot,
    r_dot rad/s2) -> steady change of the coefficient per unit of it. frequency: undamped [rad/s]; damping: of critical; each with
    its standard deviation once fitted. gain: twice the log-likelihood by linear theory, less one for each unknown."""

    line: str
    by: Mapping[str, float]
    frequency: float
    damping: float
    gain: float
    score: float
    threshold: float
    frequency_std: float | None = None
    damping_std: float | None = None

    @property
    def words(self) -> str:
        return f"{self.line} swings at {self.frequency / TURN:.2g} Hz as {' and '.join(self.by)} drive it"

    def to_json(self) -> dict[str, Any]:
        return {
            "kind": "swing", "nameless": True, "output": self.line, "variables": list(self.by),
            "sizes": {a: rounded(v, 9) for a, v in self.by.items()},
            **rounded_fields(self, frequency=4, frequency_std=4, damping=4, damping_std=4, score=2, threshold=2),
        }  # fmt: skip


@dataclass(frozen=True)
class EventReport:
    """One event. what: drift | slip | burst. channel: the output, "" for a disturbance of the motion. flight: its name, "" for
    all of them. start, end: s on the flight's clock. air: the state that a gust changes. sizes: (estimate, bound) in `unit`: the
    change over each flight by a drift, the step of a slip, the peak rates that a burst adds to the force equations, the largest
    change of `air` by a gust."""

    what: str
    channel: str
    flight: str
    start: float
    end: float
    sizes: tuple[tuple[float, float], ...]
    unit: str
    score: float
    threshold: float
    air: str = ""

    def to_json(self) -> dict[str, Any]:
        return {
            "what": self.what, "channel": self.channel, **({"air": self.air} if self.air else {}), "flight": self.flight,
            **rounded_fields(self, start=3, end=3), "size": [rounded_estimate(size, 6) for size in self.sizes],
            "unit": self.unit, **rounded_fields(self, score=2, threshold=2),
        }  # fmt: skip


@dataclass(frozen=True)
class HeldInstrument:
    """An instrument that holds its values; no term of the model is wrong.

    channel: the output. every: mean time [s] between new values. share: of the samples that repeat. ratio: rms residual there
    over that at new values; threshold: the ratio that is too large.
    """

    channel: str
    every: float
    share: float
    ratio: float
    threshold: float

    def to_json(self) -> dict[str, Any]:
        numbers = rounded_fields(self, every=4, share=3, ratio=2, threshold=2)
        return {"kind": "held", "nameless": True, "channel": self.channel, **numbers}


@dataclass(frozen=True)
class NotPredicted:
    """A held-out flight that the model does not predict, though nothing is significant on the training flights.

    channels: outputs with large residuals, the worst first. segments: (from, to [s]) with large residuals. gap: of the held-out
    flights; highest: upper end of the gap with nothing hidden.
    """

    flight: str
    channels: tuple[str, ...]
    segments: tuple[tuple[float, float], ...]
    gap: float
    highest: float

    def to_json(self) -> dict[str, Any]:
        place = {"flight": self.flight, "channels": list(self.channels)}
        return {"kind": "held_out", "nameless": True, **place, **rounded_fields(self, gap=3, highest=3)}


@dataclass(frozen=True)
class Happened:
    """Events that leave nothing else to explain, the most significant first."""

    events: Sequence[EventReport]

    def to_json(self) -> dict[str, Any]:
        first = self.events[0]
        return {"kind": "event", "nameless": True, **first.to_json(), "events": [e.to_json() for e in self.events]}


Follower = LaggedTerm | SwingingTerm
Shape = ShapeCurve | Follower | Happened | HeldInstrument | NotPredicted
