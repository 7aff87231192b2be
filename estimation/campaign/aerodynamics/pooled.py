"""Curves over the envelope from the estimates of many flights: forms chosen by leaving flights out, outlying flights excluded.

estimate_i = s(conditions_i) + u_i + e_i for all parameters of a group at once. So a flight that is off in several parameters
shows in all of them together, and correlated estimates are not counted twice.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from estimation.campaign import pooling
from estimation.campaign.aerodynamics import mixed
from estimation.campaign.aerodynamics.forms import CONSTANT, ConditionScale, PolynomialForm, larger_forms, near_flights
from estimation.campaign.aerodynamics.mixed import MixedData, MixedDesign, MixedFit
from groundstation.flight import Array

Mask = NDArray[np.bool_]

SPARE_FLIGHTS = 4  # beyond the terms: with fewer a form cannot be judged
MOST_OUTLYING = 0.25  # of the flights: more are not outliers but another aircraft
FEWEST_SHIFTED = 2  # flights on either side of a shift: fewer do not show their scatter
ROUNDS = 5  # of excluding outlying flights and fitting again
CONDITION_LIMIT = 1e10  # condition number of a design: beyond, these flights do not separate its terms
SPARE_FOR_PLANE = 4  # flights beyond twice the slopes, from which a plane is fitted before the search for outliers
REWEIGHTINGS = 30  # of least absolute deviations: the limits of outliers need ten
LEAST_DEVIATION = 1e-3  # in bounds: smaller residuals weigh the same


@dataclass(frozen=True)
class GroupFlights:
    """Flights of one group by one method. flights, dates: name and date of each; conditions: (flights, 4), `forms.CONDITIONS`."""

    parameters: tuple[str, ...]
    flights: tuple[str, ...]
    dates: tuple[str, ...]
    conditions: Array
    data: MixedData


@dataclass(frozen=True)
class PooledCurves:
    """The curves of a group. forms: of each parameter; shifts: (flights, effects) that may move its estimates; shifted: effects
    that can be estimated, of each parameter; sound: (flights,) mask of those that enter the curves; distance, limit: (flights,)
    squared distance of each flight from the fit to the others, and the one that a sound flight exceeds with probability LEVEL."""

    group: GroupFlights
    scale: ConditionScale
    forms: tuple[PolynomialForm, ...]
    shifts: Array
    shifted: tuple[tuple[int, ...], ...]
    fit: MixedFit
    design: MixedDesign
    sound: Mask
    distance: Array
    limit: Array

    @cached_property
    def x(self) -> Array:
        """(sound flights, 4) scaled conditions."""
        return self.scale.scaled(self.group.conditions[self.sound])

    def columns(self, parameter: int, conditions: Array, shifts: Array | None = None) -> Array:
        """(points, terms) columns of a parameter's form. shifts: (effects,), by default their mean, which is zero."""
        form_columns = self.forms[parameter].columns(self.scale.scaled(conditions))
        effects = self.shifted[parameter]
        effect_values = np.zeros(len(effects)) if shifts is None else shifts[list(effects)]
        return np.column_stack([form_columns, np.tile(effect_values, (len(form_columns), 1))])

    def shift(self, parameter: int, effect: int) -> tuple[float, float] | None:
        """Coefficient and standard error of an effect on a parameter; None where it cannot be estimated."""
        if effect not in self.shifted[parameter]:
            return None
        first = int(np.flatnonzero(self.design.owner == parameter)[0]) + len(self.forms[parameter].penalty)
        place = first + self.shifted[parameter].index(effect)
        return float(self.fit.b[place]), float(np.sqrt(self.fit.covariance[place, place]))

    def at(self, parameter: int, conditions: Array, shifts: Array | None = None) -> tuple[Array, Array]:
        """(points,) value and standard error of a parameter's curve at conditions (points, 4). shifts: as in `columns`."""
        return mixed.predicted(self.fit, self.columns(parameter, conditions, shifts), self.design.owner, parameter)

    def of_flight(self, parameter: int, flight: int) -> tuple[float, float]:
        """Value and standard error of a parameter's curve at the conditions and shifts of one flight."""
        form_columns = self.forms[parameter].columns(self.scale.scaled(self.group.conditions[flight : flight + 1]))
        row = np.column_stack([form_columns, self.shifts[flight : flight + 1, self.shifted[parameter]]])
        value, std = mixed.predicted(self.fit, row, self.design.owner, parameter)
        return float(value[0]), float(std[0])

    def half_band(self, parameter: int, std: Array) -> Array:
        """Half width of the 95 % band."""
        half: Array = pooling.t_quantile(1.0 - pooling.LEVEL / 2.0, int(self.fit.freedom[parameter])) * std
        return half

    def flown(self, conditions: Array, flights: Mask | None = None) -> Mask:
        """(points,) whether a sound flight was near in every condition that changed. flights: mask of those to look at."""
        flight_conditions = self.x if flights is None else self.x[flights[self.sound]]
        return near_flights(self.scale.scaled(conditions), flight_conditions, np.flatnonzero(self.scale.changed))

    def formula(self, parameter: int, shifts: Array | None = None) -> str | None:
        """An expression of alpha, V and delta_e for a model file, where the form has one. shifts: as in `columns`."""
        form, effects = self.forms[parameter], self.shifted[parameter]
        b = self.fit.b[self.design.owner == parameter]
        free = b[: form.size].copy()
        if shifts is not None and effects:
            free[0] += b[len(form.penalty) :] @ shifts[list(effects)]
        return form.formula(self.scale, free)


def envelope(group: GroupFlights, shifts: Array | None = None) -> PooledCurves | None:
    """Curves of all parameters that enough flights have; None where there is none.

    shifts: (flights, effects), such as of a configuration or a date, each of which may move every parameter by a constant. They
    are centred on their means, so that the curves are those of the mean flight.
    """
    usable_columns = np.flatnonzero(group.data.known.sum(axis=0) >= CONSTANT.size + SPARE_FLIGHTS)
    if not usable_columns.size:
        return None
    names = tuple(group.parameters[j] for j in usable_columns)
    data = MixedData(
        group.data.y[:, usable_columns],
        group.data.V[:, usable_columns][:, :, usable_columns],
        group.data.known[:, usable_columns],
    )
    flights_known: Mask = data.known.sum(axis=1) > 0
    group = GroupFlights(
        names,
        tuple(f for f, t in zip(group.flights, flights_known, strict=True) if t),
        tuple(d for d, t in zip(group.dates, flights_known, strict=True) if t),
        group.conditions[flights_known],
        data.part(flights_known),
    )
    centred_shifts = np.zeros((len(flights_known), 0)) if shifts is None else shifts
    centred_shifts = (centred_shifts - centred_shifts.mean(axis=0))[flights_known]
    scale = ConditionScale.from_conditions(group.conditions)
    x = scale.scaled(group.conditions)
    sound_flights = _without_gross_outliers(group.data, np.column_stack([x[:, scale.changed], centred_shifts]))
    for number in range(ROUNDS):
        sound_data = group.data.part(sound_flights)
        shifted = tuple(
            _estimable_shifts(centred_shifts[sound_flights][sound_data.known[:, j]]) for j in range(len(names))
        )
        forms = tuple(
            choose(sound_data.one(j), x[sound_flights], scale.changed, centred_shifts[sound_flights][:, shifted[j]])
            for j in range(len(names))
        )
        full_design = _design(group.data, forms, x, centred_shifts, shifted)
        design = full_design.part(sound_flights)
        mixed_fit = mixed.fit(sound_data, design)
        distance = _distances(group.data, full_design, sound_flights, mixed_fit)
        limit = np.array([_limit(int(c), len(flights_known)) for c in group.data.known.sum(axis=1)])
        still_sound = distance <= limit
        settled = np.array_equal(still_sound, sound_flights) or still_sound.mean() < 1.0 - MOST_OUTLYING
        if settled or number == ROUNDS - 1:
            break
        sound_flights = still_sound
    return PooledCurves(group, scale, forms, centred_shifts, shifted, mixed_fit, design, sound_flights, distance, limit)


def choose(data: MixedData, x: Array, changed: Mask, shifts: Array) -> PolynomialForm:
    """The form of one parameter, extended step by step while flights left out are clearly better predicted.

    Clearly: the mean gain in log density exceeds its standard error over flights; by chance about one form tried in a hundred
    does. shifts: (flights, effects), which are part of every form.
    """
    rows = data.known[:, 0]
    known_data, known_conditions, known_shifts = data.part(rows), x[rows], shifts[rows]
    best_form, scores = CONSTANT, _scores(known_data, CONSTANT, known_conditions, known_shifts)
    while True:
        scored_forms = [
            (form, form_scores)
            for form in larger_forms(best_form, changed)
            if rows.sum() >= form.size + 2 * len(form.splines) + shifts.shape[1] + SPARE_FLIGHTS
            and (form_scores := _scores(known_data, form, known_conditions, known_shifts)) is not None
        ]
        if scores is None or not scored_forms:
            return best_form
        form, form_scores = max(scored_forms, key=lambda t: float(t[1].mean()))
        gain = form_scores - scores
        if gain.mean() <= float(gain.std(ddof=1)) / np.sqrt(gain.size):
            return best_form
        best_form, scores = form, form_scores


def bootstrap(envelope: PooledCurves, count: int, seed: int) -> Array:
    """(replicates, coefficients) from bootstrapped flights."""
    data = envelope.group.data.part(envelope.sound)
    return mixed.replicates(data, envelope.design, envelope.fit, count, np.random.default_rng(seed))


def group_flights_of(
    parameters: Sequence[str],
    flights: Sequence[tuple[str, str]],
    conditions: Array,
    values: Array,
    std: Array,
    correlation: Array,
) -> GroupFlights:
    """From (date, name) of flights, estimates and bounds (flights, k), NaN if unknown, and correlations (flights, k, k)."""
    known = np.isfinite(values) & np.isfinite(std) & (std > 0.0)
    safe_std = np.where(known, std, 1.0)
    V = correlation * safe_std[:, :, None] * safe_std[:, None, :]
    V[:, np.arange(len(parameters)), np.arange(len(parameters))] = safe_std**2
    names = tuple(name for _, name in flights)
    return GroupFlights(tuple(parameters), names, tuple(d for d, _ in flights), conditions, MixedData(values, V, known))


# ------------------------------------------------------------------------------------------------------ inside


def _scores(data: MixedData, form: PolynomialForm, x: Array, shifts: Array) -> Array | None:
    """(flights,) log density of each as predicted by the others; None where the flights do not separate the terms."""
    free = np.column_stack([form.columns(x)[:, : form.size], shifts])
    if np.linalg.cond(free.T @ free) > CONDITION_LIMIT:
        return None
    effects = tuple(range(shifts.shape[1]))
    return mixed.fit(data, _design(data, (form,), x, shifts, (effects,))).scores()


def _design(
    data: MixedData, forms: Sequence[PolynomialForm], x: Array, shifts: Array, shifted: Sequence[tuple[int, ...]]
) -> MixedDesign:
    columns = [np.column_stack([f.columns(x), shifts[:, effects]]) for f, effects in zip(forms, shifted, strict=True)]
    penalties = [(*f.penalty, *(-1 for _ in effects)) for f, effects in zip(forms, shifted, strict=True)]
    return MixedDesign.from_columns(columns, penalties, data.known)


def _estimable_shifts(shifts: Array) -> tuple[int, ...]:
    """Indices of the effects with FEWEST_SHIFTED flights on either side. shifts: (flights, effects)."""
    sides = np.minimum((shifts > 0.0).sum(axis=0), (shifts <= 0.0).sum(axis=0))
    return tuple(np.flatnonzero(sides >= FEWEST_SHIFTED).tolist())


def _distances(data: MixedData, full_design: MixedDesign, sound_flights: Mask, mixed_fit: MixedFit) -> Array:
    """(flights,) squared distance from the fit to the sound flights; of a sound flight, from the fit to the others."""
    distance = np.zeros(sound_flights.size)
    distance[sound_flights] = mixed_fit.left_out(data.known[sound_flights])
    if not sound_flights.all():
        rest = data.part(~sound_flights)
        X, C = full_design.X[~sound_flights], mixed_fit.covariance
        S = rest.V + np.eye(mixed_fit.tau2.size) * mixed_fit.tau2 + np.einsum("nkp,pq,nlq->nkl", X, C, X, optimize=True)
        pair_known = rest.known[:, :, None] & rest.known[:, None, :]
        r = np.where(rest.known, rest.y - X @ mixed_fit.b, 0.0)
        solved = np.linalg.solve(np.where(pair_known, S, np.eye(mixed_fit.tau2.size)), r[:, :, None])[:, :, 0]
        distance[~sound_flights] = np.einsum("nk,nk->n", r, solved)
    return distance


def _limit(parameters: int, flights: int) -> float:
    """Squared distance that one of this many sound flights exceeds with probability LEVEL."""
    from scipy.special import chdtri

    return float(chdtri(max(parameters, 1), pooling.LEVEL / flights))


def _without_gross_outliers(data: MixedData, x: Array) -> Mask:
    """(flights,) the flights to start from, near a plane over x (flights, columns) in each parameter.

    Bounds are widened to the scatter of the middle half, so that bad flights cannot hide one another.
    """
    outlying = np.zeros(len(x), bool)
    for j in range(data.y.shape[1]):
        rows = data.known[:, j]
        y, s = data.y[rows, j], np.sqrt(data.V[rows, j, j])
        X = np.ones((len(y), 1))
        if rows.sum() > 2 * x.shape[1] + SPARE_FOR_PLANE:
            X = np.column_stack([X, x[rows]])
        z = _robust_residual(y / s, X / s[:, None])
        widening = max(1.0, pooling.ROBUST * float(np.median(np.abs(z))))
        outlying[rows] |= np.abs(z) / widening > pooling.outlier_limit(len(y))
    return ~outlying if outlying.mean() <= MOST_OUTLYING else np.ones(len(x), bool)


def _robust_residual(y: Array, X: Array) -> Array:
    """Residuals of the fit of least absolute deviations, by iterated reweighting."""
    weight = np.ones(len(y))
    for _ in range(REWEIGHTINGS):
        b, *_ = np.linalg.lstsq(X * weight[:, None], y * weight, rcond=None)
        weight = 1.0 / np.sqrt(np.maximum(np.abs(y - X @ b), LEAST_DEVIATION))
    residual: Array = y - X @ b
    return residual
