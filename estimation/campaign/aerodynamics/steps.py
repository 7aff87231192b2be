"""Steps in time: dates from which all parameters of a group's flights together are shifted.

A vane that slipped moves several parameters at once; together they date the step far better than each by itself. The statistic
is the largest Wald chi-square over all dates, of shifts of all parameters beside the curves over the conditions. Its distribution
without a step comes from simulated campaigns.

A parameter that a step moved has a curve before it and another from it on, because the mean of both was never flown. A parameter
that no step clearly moved keeps one curve over all flights; where the parameters show a step only together, all are split.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.campaign import pooling
from estimation.campaign.aerodynamics import mixed
from estimation.campaign.aerodynamics.pooled import GroupFlights, PooledCurves, envelope
from groundstation.flight import Array

Index = NDArray[np.intp]

FEWEST_BESIDE = 3  # flights on either side of a date
MOST_STEPS = 3  # of one group: more are a drift, and its flights are not of one aircraft
MOST_DATES = 300  # tried; of more, evenly spread ones
DRAWS = 499  # simulated campaigns without a step: the smallest probability is 0.002
AT_ONCE = 50  # draws computed together, to bound memory
SINGULAR = 1e-9  # of the largest eigenvalue of an information matrix: smaller ones count as zero
DATE_95 = 7.35
"""Drop of the statistic to the ends of the 95 % interval of the date: (1 - exp(-x/2))^2 = 0.95 (Yao 1987, Ann. Stat. 15)."""


@dataclass(frozen=True)
class ParameterStep:
    """One parameter at a step. std: of the change; probability: of a change this large in any parameter by chance."""

    parameter: str
    change: float
    std: float
    probability: float


@dataclass(frozen=True)
class DateStep:
    """first: index of the first flight after it; dates: 95 % interval; probability: of a statistic this large at any date without
    a step; moved: all parameters whose shift can be estimated; freedom: degrees of freedom of the shifts."""

    first: int
    dates: tuple[str, str]
    probability: float
    moved: tuple[ParameterStep, ...]
    freedom: int


def with_steps(group: GroupFlights, seed: int) -> tuple[PooledCurves | None, tuple[DateStep, ...]]:
    """The curves of a group with the steps in time that its flights show. group: in order of date."""
    shifts = np.zeros((len(group.flights), 0))
    curves = envelope(group)
    located_steps: list[tuple[int, tuple[str, str], float]] = []
    while curves is not None and len(located_steps) < MOST_STEPS:
        step = _search(curves, [f for f, _, _ in located_steps], np.random.default_rng([seed, len(located_steps)]))
        if step is None:
            break
        first = group.flights.index(curves.group.flights[step[0]])
        after_step = (np.arange(len(group.flights)) >= first).astype(float)
        shifted_curves = envelope(group, np.column_stack([shifts, after_step]))
        if shifted_curves is None:
            break
        shifts, curves = np.column_stack([shifts, after_step]), shifted_curves
        located_steps.append((step[0], step[1], step[2]))
    if curves is None:
        return None, ()
    return curves, tuple(_described(curves, number, *step) for number, step in enumerate(located_steps))


def _described(curves: PooledCurves, number: int, first: int, dates: tuple[str, str], probability: float) -> DateStep:
    """A step with its sizes, from the curves that have all steps as shifts."""
    parameter_shifts = [
        (j, s) for j in range(len(curves.group.parameters)) if (s := curves.shift(j, number)) is not None
    ]
    freedom = int(min((curves.fit.freedom[j] for j, _ in parameter_shifts), default=1))
    parameter_steps = []
    for j, (change, std) in parameter_shifts:
        p = pooling.two_sided(change / std, int(curves.fit.freedom[j]))
        parameter_steps.append(
            ParameterStep(curves.group.parameters[j], change, std, min(1.0, p * len(parameter_shifts)))
        )
    return DateStep(first, dates, probability, tuple(parameter_steps), freedom)


def _search(
    curves: PooledCurves, earlier_steps: Sequence[int], rng: np.random.Generator
) -> tuple[int, tuple[str, str], float] | None:
    """(first flight after the step, 95 % interval of its date, probability), None where none is significant.

    earlier_steps: first flights after steps found before, from which it keeps FEWEST_BESIDE flights away.
    """
    known_mask = curves.group.data.known[curves.sound]
    dates = [d for d, s in zip(curves.group.dates, curves.sound, strict=True) if s]
    places = _places(dates)
    sound_indices = np.flatnonzero(curves.sound)
    places = np.array(
        [k for k in places if all(abs(sound_indices[k] - b) >= FEWEST_BESIDE for b in earlier_steps)], np.intp
    )
    if not places.size:
        return None
    statistics = _Statistics(curves, known_mask, places)
    chi2 = statistics.chi_square(np.where(known_mask, curves.fit.residual, 0.0)[None])[0]
    largest = statistics.by_chance(rng)
    probability = (1.0 + float(np.sum(largest >= chi2.max()))) / (1.0 + largest.size)
    if probability > pooling.LEVEL:
        return None
    likely_places = places[chi2 >= chi2.max() - DATE_95]
    date_range = dates[int(likely_places.min()) - 1], dates[int(likely_places.max())]
    return int(sound_indices[places[int(np.argmax(chi2))]]), date_range, probability


def _places(dates: Sequence[str]) -> Index:
    """Indices of the first flights of a date, with enough flights on either side."""
    eligible = [
        k for k in range(FEWEST_BESIDE, len(dates) - FEWEST_BESIDE + 1) if dates[k - 1] and dates[k] != dates[k - 1]
    ]
    eligible_places = np.array(eligible, np.intp)
    if eligible_places.size <= MOST_DATES:
        return eligible_places
    return eligible_places[np.linspace(0, eligible_places.size - 1, MOST_DATES).astype(np.intp)]


class _Statistics:
    """Wald's chi-square of a step of all parameters at each place, from residuals about the curves without the step."""

    def __init__(self, curves: PooledCurves, known: NDArray[np.bool_], places: Index) -> None:
        fit, design = curves.fit, curves.design
        self.known, self.places = known, places
        self.W = mixed.inverses(fit.S, known)
        self.S = fit.S
        self.X = design.X
        WX = self.W @ design.X
        count = design.X.shape[2]
        A = np.einsum("nkp,nkq->pq", design.X, WX, optimize=True)
        A[np.diag_indices(count)] += [0.0 if p < 0 else 1.0 / fit.smooth[p] for p in design.penalty]
        self.to_b = np.linalg.solve(A, WX.reshape(-1, count).T)  # (p, flights k): coefficients from estimates
        later_information = _sums_from(self.W, places)
        cross = _sums_from(WX, places)
        information = later_information - np.einsum("ckp,pq,clq->ckl", cross, np.linalg.inv(A), cross, optimize=True)
        self.inverse = np.array([np.linalg.pinv(i, rcond=SINGULAR, hermitian=True) for i in information])

    def chi_square(self, residual: Array) -> Array:
        """(draws, places) from (draws, flights, k) residuals."""
        score = np.stack([_sums_from(r, self.places) for r in np.einsum("nkl,dnl->dnk", self.W, residual)])
        chi2: Array = np.einsum("dck,ckl,dcl->dc", score, self.inverse, score, optimize=True)
        return chi2

    def by_chance(self, rng: np.random.Generator) -> Array:
        """(DRAWS,) largest statistics of simulated campaigns without a step, with the estimated variances."""
        n, k = self.known.shape
        root = np.linalg.cholesky(np.where(self.known[:, :, None] & self.known[:, None, :], self.S, np.eye(k)))
        largest: list[float] = []
        while len(largest) < DRAWS:
            count = min(AT_ONCE, DRAWS - len(largest))
            y = np.where(self.known, np.einsum("nkl,dnl->dnk", root, rng.standard_normal((count, n, k))), 0.0)
            b = y.reshape(count, -1) @ self.to_b.T
            residual = np.where(self.known, y - np.einsum("nkp,dp->dnk", self.X, b, optimize=True), 0.0)
            largest += self.chi_square(residual).max(axis=1).tolist()
        return np.array(largest)


def _sums_from(values: Array, places: Index) -> Array:
    """(places, ...) sums over the flights from each place on, of (flights, ...)."""
    sums: Array = np.cumsum(values[::-1], axis=0)[::-1][places]
    return sums


# ------------------------------------------------------------------------------------------- sides of a step

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Side:
    """The flights between two steps that moved a parameter. since, until: dates of the first and the last of them, empty where no
    step moved it; shifts: (effects,) of the curves there; flights: (flights,) mask over the group."""

    since: str
    until: str
    shifts: Array
    flights: Mask


def moved_by(steps: Sequence[DateStep], parameter: str) -> list[int]:
    """Indices of the steps that moved a parameter, in order of time."""
    step_numbers = []
    for number, step in enumerate(steps):
        clearly = [m.parameter for m in step.moved if m.probability <= pooling.LEVEL]
        if parameter in (clearly or [m.parameter for m in step.moved]):
            step_numbers.append(number)
    return sorted(step_numbers, key=lambda n: steps[n].first)


def sides(curves: PooledCurves, steps: Sequence[DateStep], parameter: str) -> Iterator[Side]:
    """The periods in which a parameter has a curve of its own, in order of time."""
    step_numbers = moved_by(steps, parameter)
    count = len(curves.group.flights)
    edges = [0, *(steps[n].first for n in step_numbers), count]
    place = np.arange(count)
    for first, end in zip(edges, edges[1:], strict=False):
        shifts = np.zeros(curves.shifts.shape[1])
        shifts[step_numbers] = curves.shifts[first, step_numbers]
        dates = (curves.group.dates[first], curves.group.dates[end - 1]) if step_numbers else ("", "")
        yield Side(*dates, shifts, (place >= first) & (place < end))


def starts_of(curves: PooledCurves, steps: Sequence[DateStep], parameter: str) -> list[tuple[str, str]]:
    """Date and name of the first flight after each step that moved a parameter."""
    return [
        (curves.group.dates[i], curves.group.flights[i]) for i in (steps[n].first for n in moved_by(steps, parameter))
    ]
