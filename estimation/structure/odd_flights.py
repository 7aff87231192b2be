"""A flight of a joint fit that differs from the others.

Leave-one-out: the scores of a flight at the estimate of all others have a covariance from its own noise and the uncertainty of
that estimate. Where they exceed it, the most likely cause in this flight alone is named: all forces scaled by one factor (mass or
dynamic pressure), one coefficient, one derivative, or one of the candidates of the structure test.

Only the first part of a long flight is tested (`first_part`): minutes show a lack, and an hour would take longer than its fit.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import NDArray

from estimation.estimators.normal_equations import pseudo_inverse
from estimation.estimators.result import FlightFit, Result, finite_or_none
from estimation.estimators.uncertainty import input_movement, inputs_beside
from estimation.models.base import Model, ParameterRole
from estimation.prepare.flight_data import FlightData, Segment
from estimation.structure.candidates import CandidateKind, force_lines
from estimation.structure.linearised import LinearisedFit
from groundstation.flight import Flight

MOST_SAMPLES = 16_000
"""Most samples of one flight: 80 s at 200 Hz, a quarter of an hour at 20 Hz. With some 50 columns and as many draws of the inputs
they take 130 MB."""
FEWEST_SAMPLES = 8  # of a segment that the limit cuts off


def first_part(result: Result, data: list[FlightData]) -> tuple[Result, list[FlightData]]:
    """A result and its flights, each cut to its first MOST_SAMPLES samples."""
    if all(d.used <= MOST_SAMPLES for d in data) or any(
        len(d.segments) != len(f.initial_states) for d, f in zip(data, result.flights, strict=True)
    ):
        return result, data
    parts = [_part(d, f) for d, f in zip(data, result.flights, strict=True)]
    return replace(result, flights=tuple(f for _, f in parts)), [d for d, _ in parts]


def _part(data: FlightData, fit: FlightFit) -> tuple[FlightData, FlightFit]:
    segments: list[Segment] = []
    remaining = MOST_SAMPLES
    for s in data.segments:
        if remaining < FEWEST_SAMPLES:
            break
        count = min(len(s), remaining)
        segments.append(s if count == len(s) else s.part(0, count, np.array(s.x0)))
        remaining -= count
    initial_states = fit.initial_states[: len(segments)]
    return replace(data, segments=tuple(segments)), replace(fit, initial_states=initial_states)


Array = NDArray[np.float64]

CHANCE = 1e-4
"""Probability by chance, after correction for the number of flights, below which a flight is odd."""
INFLATED = 2.0
"""Factor on a flight's score covariance: flights of one aircraft differ in speed, loading and air."""
SIMPLE = 0.8
"""Share of the best explanation's gain from which a simpler cause, all forces or a whole coefficient by one factor, is named
instead."""
ALL_FORCES = "mass or dynamic pressure"
SMALLEST_FACTOR = 0.05  # of all forces, so that their inverse, the ratio of masses, stays finite


@dataclass(frozen=True)
class OddFlight:
    """A flight that differs. what: the most likely cause; ratio: this flight's value over the others' (mass, derivative, scale),
    for a lag its value [s]; probability: of such a difference by chance; parameter, moves: the joint estimate that the flight
    moves most, and by how many bounds; other_flight: name of the other flight where there are only two."""

    flight: str
    what: str
    ratio: float
    probability: float
    parameter: str
    moves: float
    other_flight: str = ""

    @property
    def text(self) -> str:
        """As it is printed."""
        size = f"{self.ratio:.3g} s" if self.what.startswith("lag") else f"{self.ratio:.3g} times the others'"
        subject = f"{self.flight} differs from the other flights"
        if self.other_flight:
            pair = f"{self.flight} and {self.other_flight}"
            subject = f"{pair} differ from one another, and two flights cannot tell which is the odd one"
        return (
            f"{subject} (probability of chance {self.probability:.1g}), most likely in"
            f" {self.what}: {size}; it moves the joint {self.parameter} by {self.moves:.1f} bounds"
        )

    def to_json(self) -> dict[str, Any]:
        """An entry of `odd` in `estimate --json`."""
        return {
            "flight": self.flight,
            "what": self.what,
            "ratio": finite_or_none(round(self.ratio, 4)),
            "probability": self.probability,
            "moves": {self.parameter: round(self.moves, 2)},
        }


@dataclass(frozen=True)
class _Hypothesis:
    """One cause: a change along `direction` of the parameters or candidates `columns`; null: ratio without a change."""

    what: str
    columns: tuple[int, ...]
    direction: Array
    kind: CandidateKind | None = None
    null: float = 1.0


CORRECTION_BOUNDS = "compatibility_bounds"
"""Key of a flight's provenance: instrument factor that was corrected -> its corrected bound."""


def scale_bounds(flight: Flight) -> dict[str, float]:
    """Channel -> relative 1 sigma of its scale, for the scale factors that were corrected in the flight."""
    detail = flight.provenance.detail
    bounds, factors = detail.get(CORRECTION_BOUNDS), detail.get("compatibility")
    if not isinstance(bounds, dict) or not isinstance(factors, dict):
        return {}
    scales = {n: (bound, factors.get(n)) for n, bound in bounds.items() if str(n).startswith("K_")}
    return {
        name.removeprefix("K_"): min(1.0, abs(bound / factor))
        for name, (bound, factor) in scales.items()
        if _is_number(bound) and _is_number(factor) and factor != 0.0
    }


def _is_number(value: object) -> TypeGuard[float]:
    """Whether a value is a finite number: a flight's provenance comes from a file and may hold anything."""
    return isinstance(value, int | float) and math.isfinite(value)


Scales = Mapping[str, Mapping[str, float]]
"""Flight -> channel -> relative 1 sigma of its scale, or of the derivatives that multiply it where it is a control."""


def attenuations(model: Model, data: FlightData) -> dict[str, float]:
    """Control -> relative amount by which noise in its record makes the derivatives that multiply it too small: the noise's share
    of the variance (errors in variables; Fuller 1987, eq. 1.1.9)."""
    movement = input_movement(model, [data])
    return {control: min(1.0, (noise / rms) ** 2) for control, (rms, noise) in movement.items() if rms > 0.0 < noise}


def odd_flights(linear: LinearisedFit, result: Result, scales: Scales) -> tuple[OddFlight, ...]:
    """The flight that differs most from the others, or none. Of two flights that differ, either may be the odd one; the one with
    the larger statistic is named. scales: uncertainty of each flight's instruments, which is no difference of the aircraft.

    Only one is named, because a flight that differs makes the others look odd beside the joint estimate.
    """
    if len(linear.flights) < 2:
        return ()
    scale_scores = _scale_scores(linear, result.model, scales)
    tests = [_test_flight(linear, result, scale_scores, i) for i in range(len(linear.flights))]
    _, oddest = max(tests, key=lambda test: test[0])
    return () if oddest is None else (oddest,)


def _test_flight(
    linear: LinearisedFit, result: Result, scale_scores: Sequence[Sequence[Array]], index: int
) -> tuple[float, OddFlight | None]:
    """(chi-square over its degrees of freedom, the odd flight or None where chance may explain it)."""
    from scipy.special import chdtrc

    n, k = linear.n, len(linear.tested)
    rest = linear.total([i for i in range(len(linear.flights)) if i != index])
    spread = pseudo_inverse(rest[:n, :n])[0]
    theta = spread @ rest[:n, -1]
    products = linear.flights[index]
    score = products.gram[: n + k, -1] - products.gram[: n + k, :n] @ theta
    covariance = _covariance(linear, index, spread, scale_scores)
    weight, rank = _inverse(covariance[:n, :n])
    chi_square, freedom = float(score[:n] @ weight @ score[:n]), max(rank, 1)
    probability = min(1.0, len(linear.flights) * float(chdtrc(freedom, chi_square)))
    if probability > CHANCE:
        return chi_square / freedom, None
    hypothesis, size = _explained(linear, result, index, score, covariance)
    total = linear.total()
    shift = np.abs(pseudo_inverse(total[:n, :n])[0] @ total[:n, -1] - theta)
    bounds = np.array([result.std_coloured.get(name, np.inf) for name in linear.shared])
    with np.errstate(invalid="ignore", divide="ignore"):
        shift = np.where(np.isfinite(bounds) & (bounds > 0.0), shift / bounds, 0.0)
    strongest = int(np.argmax(shift))
    all_forces = hypothesis.what == ALL_FORCES  # a force larger by a factor is a mass smaller by it
    ratio = 1.0 / max(1.0 + size, SMALLEST_FACTOR) if all_forces else hypothesis.null + size
    names = [f.name for f in linear.flights]
    partner = names[1 - index] if len(names) == 2 else ""
    odd = OddFlight(
        products.name, hypothesis.what, ratio, probability, linear.shared[strongest], float(shift[strongest]), partner
    )
    return chi_square / freedom, odd


def _covariance(linear: LinearisedFit, index: int, spread: Array, scale_scores: Sequence[Sequence[Array]]) -> Array:
    """Covariance of one flight's scores at the estimate of the others. scale_scores: from `_scale_scores`."""
    n, products = linear.n + len(linear.tested), linear.flights[index]
    gram = products.gram[:n, :n]
    total = gram + gram[:, : linear.n] @ spread @ gram[: linear.n]
    for draws, size in ((products.noise[:n], 1.0), (products.edges[:n], linear.edges)):
        if draws.shape[1]:
            total = total + size / draws.shape[1] * (draws @ draws.T)
    for i, scores in enumerate(scale_scores):
        for score in scores:  # another flight's scale acts through the estimate
            column = score if i == index else -gram[:, : linear.n] @ (spread @ score[: linear.n])
            total = total + np.outer(column, column)
    common = products.common[:n]
    return np.asarray(INFLATED * (total + common @ linear.common @ common.T))


def _scale_scores(linear: LinearisedFit, model: Model, scales: Scales) -> list[list[Array]]:
    """For each flight, (columns,) changes of its own scores by one standard deviation of each of its channels' scales."""
    names = (*linear.shared, *(c.name for c in linear.tested))
    n, values = len(names), np.concatenate([linear.values, np.zeros(len(linear.tested))])
    inputs = [inputs_beside(model, name) if name in linear.shared else frozenset[str]() for name in names]

    def direction_of(channel: str) -> Array:
        beside = [channel in i for i in inputs]
        return np.asarray(np.where(beside, values, [name == f"scale_{channel}" for name in names]))

    return [
        [
            bound * (flight.gram[:n, :n] @ direction_of(channel))
            for channel, bound in scales.get(flight.name, {}).items()
        ]
        for flight in linear.flights
    ]


def _explained(
    linear: LinearisedFit, result: Result, index: int, score: Array, covariance: Array
) -> tuple[_Hypothesis, float]:
    """The hypothesis that explains most of a flight's chi-square, simple ones preferred, and its size."""
    gram, n = linear.flights[index].gram, linear.n
    chi_square = float(score[:n] @ _inverse(covariance[:n, :n])[0] @ score[:n])
    ranked = []
    for h in _hypotheses(linear, result):
        columns = np.array(h.columns)
        weight = _inverse(covariance[np.ix_(columns, columns)])[0]
        mean = gram[np.ix_(columns, columns)] @ h.direction
        power = float(mean @ weight @ mean)
        if power > 0.0:
            product = float(mean @ weight @ score[columns])
            with_candidate = float(score[columns] @ weight @ score[columns])
            gain = product**2 / power - max(with_candidate - chi_square, 0.0)  # a candidate's own score is no gain
            ranked.append((gain, h, product / power))
    highest = max(gain for gain, _, _ in ranked)
    simple = [f for f in ranked if f[1].kind is None and f[0] >= SIMPLE * highest]
    gain, leading, size = max(simple or ranked, key=lambda f: f[0])
    return leading, size


def _hypotheses(linear: LinearisedFit, result: Result) -> Iterator[_Hypothesis]:
    """All forces by one factor, one coefficient by a factor, one derivative, one candidate of an instrument."""
    n = linear.n
    shared = tuple(range(n))
    derivatives = {p.name for p in result.model.parameters if p.role is ParameterRole.DERIVATIVE}
    forces = [name in derivatives for name in linear.shared]
    values = linear.values * np.array(forces, float)
    yield _Hypothesis(ALL_FORCES, shared, values)
    for line in force_lines(result.model):
        of_line = np.array([name.startswith(f"{line}_") for name in linear.shared], float)
        if np.count_nonzero(of_line) > 1:
            yield _Hypothesis(f"all of {line}", shared, values * of_line)
    for j in np.flatnonzero(values):
        direction = np.zeros(n)
        direction[j] = linear.values[j]
        yield _Hypothesis(linear.shared[j], shared, direction, CandidateKind.LINEAR)
    for a, candidate in enumerate(linear.tested):
        direction = np.zeros(n + 1)
        direction[n] = 1.0
        if candidate.kind in (CandidateKind.SCALE, CandidateKind.LATE_CONTROL, CandidateKind.LATE_SENSOR):
            is_delay = candidate.kind is not CandidateKind.SCALE
            title = f"{'lag' if is_delay else 'scale'} of {candidate.channel}"
            yield _Hypothesis(title, (*shared, n + a), direction, candidate.kind, candidate.null)


def _inverse(matrix: Array) -> tuple[Array, int]:
    """Pseudo-inverse and rank."""
    inverse, blind = pseudo_inverse(matrix)
    return inverse, len(matrix) - (blind.shape[1] if blind.size else 0)
