"""Nameless terms: simple functions of the motion added to an output or to a force equation, with scores from nulls."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.criteria import Criteria
from estimation.gap.fit.problem import LikelihoodProblem, ModelFit
from estimation.gap.records.candidate_model import DISTURBANCE
from estimation.gap.significance.calibration import Round
from estimation.gap.significance.measured_again import MeasuredAgain, own_shares
from estimation.gap.significance.screen import Projected, gram_of
from estimation.gap.significance.tangent import Tangent, is_door, output_changes

SHAPES = {"linear": "{}", "odd": "{0}|{0}|", "even": "{}^2", "rate": "d{}/dt"}
TENTH = 0.1  # of an output's scatter: size of an addition to it, which does not change its score
FEWEST = 4  # simulated sets, for the scatter of a score
MEASURED_AGAIN_SEED = 1  # seed of the flights whose controls are measured again


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


def beyond_control_noise(round_: Round, signals: Sequence[OmnibusSignal]) -> list[OmnibusSignal]:
    """Terms with the part of their score that exceeds the noise of recorded controls.

    That noise is in the motion that a term is made of and in the residual, which correlate with nothing hidden. Nulls do not show
    this, for their terms are made of the motion of the flights. Simulated flights without an effect whose controls are measured
    again do: their mean score is subtracted, and their scatter counts where it exceeds that of the nulls. Unchanged where such
    flights cannot be flown.
    """
    scores = _scores(MeasuredAgain(round_.baseline, MEASURED_AGAIN_SEED), signals)
    if len(scores) < FEWEST:
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
