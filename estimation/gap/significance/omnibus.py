"""The omnibus test: is there anything in the residuals that no named effect explains?

Three families of statistics on the residuals of a fitted model, each calibrated on the same simulated nulls:
nameless terms (simple functions of the motion added to an output or to a force equation), energy in windows of a second,
and energy that grows with some activity (a clipped, stale or sticking sensor errs where its signal moves most).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from estimation.engine.kernel import Array
from estimation.estimators.normal_equations import solved
from estimation.gap.criteria import Criteria
from estimation.gap.fit.problem import LikelihoodProblem, ModelFit
from estimation.gap.fit.surface_steps import jumping_outputs
from estimation.gap.records.candidate_model import DISTURBANCE
from estimation.gap.significance.calibration import Round, unknown_above
from estimation.gap.significance.measured_again import MeasuredAgain, own_shares
from estimation.gap.significance.screen import Projected, gram_of
from estimation.gap.significance.tangent import Tangent, is_door, output_changes

LEADING = 8  # signals for the answer
FIRST_ASKED = 16  # terms asked beyond the noise of controls; the others only where eight of all do not stay above them
SHAPES = {"linear": "{}", "odd": "{0}|{0}|", "even": "{}^2", "rate": "d{}/dt"}
TENTH = 0.1  # of an output's scatter: size of an addition to it, which does not change its score
FEWEST_SETS = 4  # simulated, for the scatter of a score
MEASURED_AGAIN_SEED = 1  # seed of the flights whose controls are measured again
NOTHING = 1e-12  # energy of a window without samples
RESTLESS = 3  # windows of each record with the largest scores
FEWEST_SAMPLES = 4  # in a window
SINGLE = 2  # wrong values side by side in a channel, or by chance in a second, which no test of single values finds


@dataclass(frozen=True)
class OmnibusSignal:
    """A nameless signal. kind: term | time | activity. place: channel or equation. what: words. score: in units of its scatter on
    nulls. gain: twice the log-likelihood, key: place, signal and shape, sign: of the score (terms only). span: seconds in a
    flight (time only)."""

    kind: str
    place: str
    what: str
    score: float
    gain: float = 0.0
    flight: int = -1
    span: tuple[float, float] | None = None
    key: tuple[str, str, str] = ("", "", "")
    sign: float = 1.0


@dataclass(frozen=True)
class Omnibus:
    """Strongest signal of the data over all families, its family-wise threshold from nulls, and the leading ones."""

    score: float
    threshold: float
    leading: tuple[OmnibusSignal, ...]

    @property
    def significant(self) -> bool:
        """Whether the strongest signal is an unknown effect, by itself."""
        return self.score > self.threshold

    @property
    def last(self) -> float:
        """Score above which another signal would be among the leading ones."""
        return self.leading[-1].score if len(self.leading) == LEADING else -np.inf


@dataclass(frozen=True)
class Remainder:
    """What the residuals of a round's baseline still hold. Each part is computed when it is first asked for: of a round in which
    an effect is accepted mostly only a bound is needed."""

    round_: Round

    @cached_property
    def _terms(self) -> tuple[list[OmnibusSignal], Array]:
        return nameless_terms(self.round_.tangent)

    @property
    def most(self) -> float:
        """Largest gain of a nameless term before what the noise of controls gives it is taken off: never below `nameless`."""
        return max((s.gain for s in self._terms[0]), default=0.0)

    @property
    def nameless(self) -> float:
        """Gain of the best nameless term."""
        return max((s.gain for s in self.omnibus.leading if s.kind == "term"), default=0.0)

    @cached_property
    def omnibus(self) -> Omnibus:
        """All three families."""
        problem, model_fit = self.round_.baseline.problem, self.round_.baseline.fit
        criteria, nulls = self.round_.criteria, len(self.round_.null_residuals)
        terms, term_null = self._terms
        white = whitened(self.round_)
        times, time_null = restless_times(problem, white, nulls)
        activity, activity_null = scatter_with_activity(problem, model_fit, white, nulls)
        largest = np.max([term_null, time_null, activity_null], axis=0)
        limit = unknown_above(largest, criteria)
        doubtful = sorted((s for s in terms if s.score > limit), key=lambda s: -s.score)
        signals = [*(s for s in terms if s.score <= limit), *times, *activity]
        for some in (doubtful[:FIRST_ASKED], doubtful[FIRST_ASKED:]):
            # a score only falls: what is behind all leading signals before it is asked is behind them afterwards
            if some and some[0].score > summed_up(signals, largest, criteria).last:
                signals += beyond_control_noise(self.again, some)
        return summed_up(signals, largest, criteria)

    @cached_property
    def again(self) -> MeasuredAgain:
        """The flights of the round with their controls measured again."""
        return MeasuredAgain(self.round_.baseline, MEASURED_AGAIN_SEED)


def examine(round_: Round) -> Omnibus:
    """All three families on the residuals of a round's baseline."""
    return Remainder(round_).omnibus


def summed_up(signals: Sequence[OmnibusSignal], largest: Array, criteria: Criteria) -> Omnibus:
    """The strongest signals against the largest score of every null, (nulls,)."""
    ranked = tuple(sorted(signals, key=lambda s: -s.score)[:LEADING])
    return Omnibus(ranked[0].score if ranked else 0.0, unknown_above(largest, criteria), ranked)


# ---- nameless terms
def regressors_of(problem: LikelihoodProblem, model_fit: ModelFit, index: int) -> dict[tuple[str, str], Array]:
    """(signal, shape) -> (N,) functions of the fitted motion and the controls."""
    coarse, outputs = problem.coarse[index], problem.fitted_outputs(index, model_fit)
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
    """Functions of every record, (signal, shape) -> (N,), scaled to unit rms over all records, because a term has one coefficient
    in all of them. With unit rms in each, a term would be as large in quiet flight, where only gusts and the answer to them move
    anything, as in manoeuvres."""
    scaled: list[dict[tuple[str, str], Array]] = [{} for _ in regressors]
    for key in sorted(set.intersection(*(set(r) for r in regressors))):
        rms = float(np.sqrt(np.mean(np.concatenate([r[key] for r in regressors]) ** 2)))
        for target, source in zip(scaled, regressors, strict=True):
            if rms > 0.0:
                target[key] = source[key] / rms
    return scaled


def nameless_terms(tangent: Tangent) -> tuple[list[OmnibusSignal], Array]:
    """Scores of nameless terms on the data, and the largest standardised score of every null."""
    model = tangent.problem.model
    doors = [n for n in model.input_names if is_door(n)]
    functions = sorted(regressors_of(tangent.problem, tangent.fit, 0))
    keys = [(place, *f) for place in (*model.output_names, *doors) for f in functions if (place, "linear") != f]
    projected = _projected(tangent, keys)
    z, standard = standardised(projected, tangent.problem.criteria)
    signals = [
        OmnibusSignal(
            "term",
            equation(key[0]),
            SHAPES[key[2]].format(key[1]),
            float(score),
            float(signed**2),
            key=key,
            sign=float(np.sign(signed)),
        )
        for key, score, signed in zip(keys, standard[:, 0], z[:, 0], strict=True)
    ]
    return signals, standard[:, 1:].max(axis=0)


def equation(place: str) -> str:
    """The name of the place where a term is added: an output, or the equation of a door."""
    return place.removeprefix(DISTURBANCE.format("")) + "_dot" if is_door(place) else place


def _projected(tangent: Tangent, keys: Sequence[tuple[str, str, str]]) -> Projected:
    """Nameless terms (place, signal, shape) with the base projected out."""
    problem, model_fit = tangent.problem, tangent.fit
    regressors = pooled([regressors_of(problem, model_fit, i) for i in range(len(problem.records))])

    def changes(index: int) -> Iterator[Array]:
        zeros, scale = np.zeros(len(problem.coarse[index])), _scale_of_additions(problem, index)
        terms = [(place, regressors[index].get((name, shape), zeros)) for place, name, shape in keys]
        return output_changes(problem, model_fit, index, [(p, r * scale[p] if p in scale else r) for p, r in terms])

    return Projected.of(gram_of(tangent, changes), len(problem.free), len(keys))


def _scale_of_additions(problem: LikelihoodProblem, index: int) -> dict[str, float]:
    """Output -> size of an addition to it on one record; 1 where it does not vary."""
    z, scale = problem.coarse[index].z, {}
    for column, name in enumerate(problem.model.output_names):
        measured = z[np.isfinite(z[:, column]), column]
        scale[name] = (TENTH * float(measured.std()) if measured.size else 0.0) or 1.0
    return scale


def beyond_control_noise(again: MeasuredAgain, signals: Sequence[OmnibusSignal]) -> list[OmnibusSignal]:
    """Terms with the part of their score that exceeds the noise of recorded controls.

    That noise is in the motion that a term is made of and in the residual, which correlate with nothing hidden. Nulls do not show
    this, for their terms are made of the motion of the flights. Simulated flights without an effect whose controls are measured
    again do: their mean score is subtracted, and their scatter counts where it exceeds that of the nulls. Unchanged where such
    flights cannot be flown.
    """
    scores = _scores(again, signals)
    if len(scores) < FEWEST_SETS:
        return list(signals)
    mean, wider = scores.mean(axis=0), np.maximum(scores.std(axis=0), 1.0)
    shares = own_shares(np.array([s.sign * np.sqrt(s.gain) for s in signals]), mean)
    return [
        replace(s, score=s.score * float(share / width), gain=s.gain * float(share) ** 2)
        for s, share, width in zip(signals, shares, wider, strict=True)
    ]


def _scores(again: MeasuredAgain, signals: Sequence[OmnibusSignal]) -> Array:
    """(sets, terms) signed scores of nameless terms on flights whose controls are measured again."""
    keys = [s.key for s in signals]
    tangents = (Tangent(problem, fit, (fit.residuals,)) for problem, fit in again.problems())
    return np.array([_projected(tangent, keys).scores()[:, 1] for tangent in tangents])


def standardised(projected: Projected, criteria: Criteria) -> tuple[Array, Array]:
    """(k, 1 + nulls) signed scores, and their sizes in units of the scatter on the nulls; zero where the base absorbs all."""
    z = projected.scores()
    # the scores of a null that nearly runs away have no limit
    with np.errstate(over="ignore"):
        scatter = np.sqrt(np.maximum(1.0, np.mean(z[:, 1:] ** 2, axis=1)))
    standard = np.abs(z) / scatter[:, None]
    standard[np.diag(projected.B) <= criteria.nameless_seen * projected.raw] = 0.0
    return z, standard


# ---- energy in time and with activity
def whitened(round_: Round) -> list[Array]:
    """Per record (N, ny, 1 + nulls): whitened residuals of the data and the nulls, local unknowns projected out."""
    problem, model_fit = round_.baseline.problem, round_.baseline.fit
    result = []
    for i in range(len(problem.records)):
        stack = np.stack([model_fit.residuals[i], *(null[i] for null in round_.null_residuals)], axis=2)
        residuals = np.nan_to_num(stack)
        linear = problem.linearised(i, model_fit.values, model_fit.locals[i])
        if linear is not None:  # else the local unknowns stay as fitted, for data and nulls alike
            dy = linear[1]
            n = dy.shape[2]
            gram = problem.whiteners[i].gram(dy, residuals)
            residuals = residuals - dy @ solved(gram[:n, :n], gram[:n, n:])
        result.append(problem.whiteners[i].series(residuals))
    return result


def restless_times(problem: LikelihoodProblem, white: Sequence[Array], nulls: int) -> tuple[list[OmnibusSignal], Array]:
    """Energy of every channel in windows of a second, standardised by the same window of the nulls."""
    signals: list[OmnibusSignal] = []
    largest = np.zeros(nulls)
    for i, series in enumerate(white):
        time = problem.coarse[i].time
        width = max(round(problem.criteria.gust_memory / float(np.median(np.diff(time)))), FEWEST_SAMPLES)
        width = min(width, len(time))  # a short stretch between two gaps is one window
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
    distance from the nulls in units of their scatter.

    The `SINGLE` largest samples of a window do not count: so many wrong values in a second are no event.
    """
    count = series.shape[0] // width
    squares = (series[: count * width] ** 2).reshape(count, width, *series.shape[1:])
    counted = max(width - SINGLE, 1)
    energy = np.log(np.sum(np.partition(squares, counted - 1, axis=1)[:, :counted], axis=1) + NOTHING)
    energy -= np.median(energy[:, :, 1:], axis=2)[:, :, None]
    return energy, beside_others(energy)


def beside_others(values: Array) -> Array:
    """(..., 1 + nulls) values of the data and of nulls -> distances from the mean of the nulls in units of their scatter; each
    null from the other nulls.

    A null that is part of its own reference looks smaller than it is (four standard deviations among forty nulls by a quarter).
    The data are no part of it and would be significant too often.
    """
    values = values - values[..., 1:].mean(axis=-1, keepdims=True)
    nulls, count = values[..., 1:], values.shape[-1] - 1
    squares = np.sum(nulls**2, axis=-1, keepdims=True)
    mean = np.concatenate([np.zeros_like(squares), -nulls / (count - 1)], axis=-1)
    power = np.concatenate([squares / count, (squares - nulls**2) / (count - 1)], axis=-1)
    return np.asarray((values - mean) / np.sqrt(np.maximum(power - mean**2, NOTHING)))


def scatter_with_activity(
    problem: LikelihoodProblem, model_fit: ModelFit, white: Sequence[Array], nulls: int
) -> tuple[list[OmnibusSignal], Array]:
    """How much the energy of each channel grows with the size or the rate of each signal, and the largest score of every null."""
    total: dict[tuple[int, str], Array] = {}
    jumping = {s.name for s in problem.model.inputs if s.control} | set(jumping_outputs(problem.model))
    for i, series in enumerate(white):
        (regressors,) = pooled([regressors_of(problem, model_fit, i)])
        for (name, shape), values in regressors.items():
            # fast surfaces between two samples cause scatter, and so do signals that jump with them: their rates are no
            # activity, and outputs that jump are not tested
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
    """(1 + nulls,) product of the energy of whitened series (N, 1 + nulls) with an activity (N,) of unit rms about its mean."""
    weight = np.minimum(np.abs(activity), criteria.certain)
    return np.asarray((weight - weight.mean()) @ np.minimum(white**2, criteria.certain**2))
