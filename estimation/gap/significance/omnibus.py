"""Is anything left that no named effect explains? Nameless terms, restless times and restless regimes.

Three families of statistics on the residuals of a fitted model, each calibrated on the same simulated nulls:
nameless terms (simple functions of the motion added to an output or to a force equation), energy in a second of flight,
and energy that follows some activity (a clipped, stale or sticking sensor errs where its signal moves most).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from estimation.engine.kernel import Array
from estimation.estimators.normal_equations import solved
from estimation.gap.criteria import Criteria
from estimation.gap.fit.problem import LikelihoodProblem, ModelFit
from estimation.gap.fit.surface_steps import jumping_outputs
from estimation.gap.records.candidate_model import DISTURBANCE
from estimation.gap.significance.calibration import Round, upper_quantile
from estimation.gap.significance.screen import Projected, gram_of
from estimation.gap.significance.tangent import Tangent, is_door, through_doors

SHAPES = {"linear": "{}", "odd": "{0}|{0}|", "even": "{}^2", "rate": "d{}/dt"}
LEADING = 8  # signals kept for the answer
TENTH = 0.1  # of an output's scatter: the size of an addition to it, which no score depends on
NOTHING = 1e-12  # energy of a window without samples
RESTLESS = 3  # windows kept of a record, most restless first
FEWEST = 4  # samples a window has at the least


@dataclass(frozen=True)
class OmnibusSignal:
    """What stood out. kind: term | time | activity. place: channel or equation. what: words. score: in units of its
    scatter on nulls. gain: twice the log-likelihood (terms only). span: seconds in a flight (time only)."""

    kind: str
    place: str
    what: str
    score: float
    gain: float = 0.0
    flight: int = -1
    span: tuple[float, float] | None = None


@dataclass(frozen=True)
class Omnibus:
    """Strongest signal of the data over all families, its family-wise threshold from nulls, and the leading ones."""

    score: float
    threshold: float
    leading: tuple[OmnibusSignal, ...]

    @property
    def significant(self) -> bool:
        return self.score > self.threshold

    def matters(self, criteria: Criteria) -> bool:
        """Whether the strongest signal is an unknown effect, by itself."""
        return self.score > criteria.unknown_margin * self.threshold


def examine(round_: Round) -> Omnibus:
    """All three families on the residuals of a round's baseline."""
    problem, model_fit, criteria = round_.baseline.problem, round_.baseline.fit, round_.criteria
    nulls = len(round_.null_residuals)
    terms, term_null = _terms(round_.tangent)
    white = whitened(problem, model_fit, round_)
    times, time_null = restless_times(problem, white, nulls)
    activity, activity_null = scatter_with_activity(problem, model_fit, white, nulls)
    return summed_up([*terms, *times, *activity], np.max([term_null, time_null, activity_null], axis=0), criteria)


def summed_up(signals: Sequence[OmnibusSignal], largest: Array, criteria: Criteria) -> Omnibus:
    """The strongest signals against the largest score of every null, (nulls,)."""
    ranked = tuple(sorted(signals, key=lambda s: -s.score)[:LEADING])
    threshold = upper_quantile(largest, criteria.nameless_level)
    return Omnibus(ranked[0].score if ranked else 0.0, threshold, ranked)


def _regressors(problem: LikelihoodProblem, found: ModelFit, index: int) -> dict[tuple[str, str], Array]:
    """(signal, shape) -> (N,) functions of the fitted motion and the controls."""
    residual = found.residuals[index]
    coarse = problem.coarse[index]
    outputs = np.nan_to_num(coarse.z - np.nan_to_num(residual))
    signals = {n: outputs[:, i] for i, n in enumerate(problem.model.output_names)}
    signals |= {s.name: coarse.u[:, i] for i, s in enumerate(problem.model.inputs) if s.control}
    regressors = {}
    for name, s in signals.items():
        for shape, values in (
            ("linear", s),
            ("odd", s * np.abs(s)),
            ("even", s**2),
            ("rate", np.gradient(s, coarse.time)),
        ):
            regressors[(name, shape)] = values
    return regressors


def pooled(regressors: Sequence[Mapping[tuple[str, str], Array]]) -> list[dict[tuple[str, str], Array]]:
    """Functions of every record, (signal, shape) -> (N,), of unit rms over all records: a term has one coefficient in all of
    them. Of unit rms in each, it had the same size in a record of quiet flight as in one full of manoeuvres, where all that moves
    is gusts and the hand that answers them."""
    scaled: list[dict[tuple[str, str], Array]] = [{} for _ in regressors]
    for key in sorted(set.intersection(*(set(r) for r in regressors))):
        rms = float(np.sqrt(np.mean(np.concatenate([r[key] for r in regressors]) ** 2)))
        for target, source in zip(scaled, regressors, strict=True):
            if rms > 0.0:
                target[key] = source[key] / rms
    return scaled


def _terms(tangent: Tangent) -> tuple[list[OmnibusSignal], Array]:
    """Scores of nameless terms on the data, and the largest standardised score of every null."""
    problem, model_fit = tangent.problem, tangent.fit
    doors = {n: n.removeprefix(DISTURBANCE.format("")) + "_dot" for n in problem.model.input_names if is_door(n)}
    places = {**{n: n for n in problem.model.output_names}, **doors}
    regressors = pooled([_regressors(problem, model_fit, i) for i in range(len(problem.records))])
    keys = [(place, *k) for place in places for k in regressors[0] if not (place == k[0] and k[1] == "linear")]
    asks = [
        [(place, record_regressors[(signal, shape)]) for place, signal, shape in keys]
        for record_regressors in regressors
    ]
    gram = gram_of(tangent, lambda i: _changes(problem, model_fit, i, asks[i]))
    z, standard = standardised(Projected.of(gram, len(problem.free), len(keys)), problem.criteria)
    signals = [
        OmnibusSignal("term", places[p], SHAPES[shape].format(s), float(standard[j, 0]), float(z[j, 0] ** 2))
        for j, (p, s, shape) in enumerate(keys)
    ]
    return signals, standard[:, 1:].max(axis=0)


def standardised(projected: Projected, criteria: Criteria) -> tuple[Array, Array]:
    """(k, 1 + nulls) signed scores, and their sizes in units of the scatter on the nulls; zero where the base absorbs all."""
    z = projected.scores()
    # a null that all but runs away scatters without limit, and nothing stands out of it
    with np.errstate(over="ignore"):
        scatter = np.sqrt(np.maximum(1.0, np.mean(z[:, 1:] ** 2, axis=1)))
    standard = np.abs(z) / scatter[:, None]
    standard[np.diag(projected.B) <= criteria.nameless_seen * projected.raw] = 0.0
    return z, standard


def _changes(problem: LikelihoodProblem, found: ModelFit, index: int, asks: Sequence[tuple[str, Array]]) -> list[Array]:
    """(N, ny) changes of the outputs by each of `asks`: an output that a tenth of its scatter is added to in the course of a
    regressor (N,) of unit rms, or a door with what goes through it."""
    z, outputs = problem.coarse[index].z, problem.model.output_names
    responses = through_doors(problem, found, index, [ask for ask in asks if ask[0] not in outputs])
    changes = []
    for place, regressor in asks:
        if place in outputs:
            change, column = np.zeros_like(z), outputs.index(place)
            change[:, column] = regressor * (TENTH * float(np.nanstd(z[:, column])) or 1.0)
        else:
            change = next(responses)
        changes.append(change)
    return changes


def whitened(problem: LikelihoodProblem, found: ModelFit, round_: Round) -> list[Array]:
    """Per record (N, ny, 1 + nulls): whitened residuals of the data and the nulls, local unknowns taken out."""
    result = []
    for i in range(len(problem.records)):
        stack = np.stack([found.residuals[i], *(null[i] for null in round_.null_residuals)], axis=2)
        residuals = np.nan_to_num(stack)
        linear = problem.linearised(i, found.values, found.locals[i])
        if linear is not None:  # else the local unknowns stay where they are, on data and nulls alike
            dy = linear[1]
            n = dy.shape[2]
            gram = problem.whiteners[i].gram(np.concatenate([dy, residuals], axis=2))
            residuals = residuals - dy @ solved(gram[:n, :n], gram[:n, n:])
        result.append(problem.whiteners[i].series(residuals))
    return result


def restless_times(problem: LikelihoodProblem, white: Sequence[Array], nulls: int) -> tuple[list[OmnibusSignal], Array]:
    """Energy of every channel in windows of a second, standardised by the same window on the nulls."""
    signals: list[OmnibusSignal] = []
    largest = np.zeros(nulls)
    for i, series in enumerate(white):
        time = problem.coarse[i].time
        width = max(round(problem.criteria.nameless_window / float(np.median(np.diff(time)))), FEWEST)
        width = min(width, len(time))  # a stretch between two gaps may be shorter: one window then
        energy, z = window_energy(series, width)
        largest = np.maximum(largest, z[:, :, 1:].max(axis=(0, 1)))
        for w, c in zip(*np.unravel_index(np.argsort(-z[:, :, 0].ravel())[:RESTLESS], z.shape[:2]), strict=True):
            span = (float(time[w * width]), float(time[(w + 1) * width - 1]))
            words = f"residual {float(np.exp(energy[w, c, 0] / 2)):.1f} times its usual size"
            place, flight = problem.model.output_names[c], problem.records[i].flight
            signals.append(OmnibusSignal("time", place, words, float(z[w, c, 0]), flight=flight, span=span))
    return signals, largest


def window_energy(series: Array, width: int) -> tuple[Array, Array]:
    """(windows, ny, 1 + nulls) logarithm of the energy in windows of `width` samples over its median on the nulls, and its
    distance from the nulls in units of their scatter."""
    count = series.shape[0] // width
    energy = np.log(np.sum((series[: count * width] ** 2).reshape(count, width, *series.shape[1:]), axis=1) + NOTHING)
    energy -= np.median(energy[:, :, 1:], axis=2)[:, :, None]
    return energy, beside_others(energy)


def beside_others(values: Array) -> Array:
    """(..., 1 + nulls) values of the data and of nulls -> distances from the mean of the nulls in units of their scatter; for
    each null of the others.

    A null measured by a scatter in which it takes part looks smaller than it is, one of four standard deviations among forty
    by a quarter; the data take no part in it and would be called restless too often.
    """
    values = values - values[..., 1:].mean(axis=-1, keepdims=True)
    nulls, count = values[..., 1:], values.shape[-1] - 1
    squares = np.sum(nulls**2, axis=-1, keepdims=True)
    mean = np.concatenate([np.zeros_like(squares), -nulls / (count - 1)], axis=-1)
    power = np.concatenate([squares / count, (squares - nulls**2) / (count - 1)], axis=-1)
    return np.asarray((values - mean) / np.sqrt(np.maximum(power - mean**2, NOTHING)))


def scatter_with_activity(
    problem: LikelihoodProblem, found: ModelFit, white: Sequence[Array], nulls: int
) -> tuple[list[OmnibusSignal], Array]:
    """Does the energy of a channel follow the size or the rate of some signal?"""
    total: dict[tuple[int, str], Array] = {}
    jumping = {s.name for s in problem.model.inputs if s.control} | set(jumping_outputs(problem.model))
    for i, series in enumerate(white):
        (regressors,) = pooled([_regressors(problem, found, i)])
        for (name, shape), values in regressors.items():
            # fast surfaces between two samples leave scatter of their own, and so does what jumps with them: rates of
            # theirs say nothing here, nor does the scatter of an output that jumps
            if shape not in ("even", "rate") or (shape == "rate" and name in jumping):
                continue
            for c in (c for c, output in enumerate(problem.model.output_names) if output not in jumping):
                key = (c, f"|{name}|" if shape == "even" else f"|d{name}/dt|")
                total[key] = total.get(key, 0.0) + energy_with_activity(values, series[:, c], problem.criteria)
    signals = []
    largest = np.zeros(nulls)
    for (c, words), values in total.items():
        z = beside_others(values)
        largest = np.maximum(largest, z[1:])
        signals.append(
            OmnibusSignal("activity", problem.model.output_names[c], f"scatter grows with {words}", float(z[0]))
        )
    return signals, largest


def energy_with_activity(activity: Array, white: Array, criteria: Criteria) -> Array:
    """(1 + nulls,) how much of the energy of whitened series (N, 1 + nulls) comes with an activity (N,) of unit rms."""
    weight = np.minimum(np.abs(activity), criteria.activity_cap)
    return np.asarray((weight - weight.mean()) @ np.minimum(white**2, criteria.energy_cap))
