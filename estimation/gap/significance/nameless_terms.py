"""Nameless terms: simple functions of the motion added to an output or to a force equation, held against nulls."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.criteria import Criteria
from estimation.gap.fit.problem import LikelihoodProblem, ModelFit
from estimation.gap.records.candidate_model import DISTURBANCE
from estimation.gap.significance.calibration import Round
from estimation.gap.significance.measured_again import MeasuredAgain
from estimation.gap.significance.screen import Projected, gram_of
from estimation.gap.significance.tangent import Tangent, is_door, through_doors

SHAPES = {"linear": "{}", "odd": "{0}|{0}|", "even": "{}^2", "rate": "d{}/dt"}
TENTH = 0.1  # of an output's scatter: the size of an addition to it, which no score depends on
CONTROLS_ANEW = 1  # seed of the flights whose controls are measured anew
FEWEST_ANEW = 4  # of them, that tell how far a score scatters
NOTHING = 1e-12  # a score of none


@dataclass(frozen=True)
class OmnibusSignal:
    """What stood out. kind: term | time | activity. place: channel or equation. what: words. score: in units of its
    scatter on nulls. gain: twice the log-likelihood, key: place, signal and shape, sign: of the score (terms only). span: seconds
    in a flight (time only)."""

    kind: str
    place: str
    what: str
    score: float
    gain: float = 0.0
    flight: int = -1
    span: tuple[float, float] | None = None
    key: tuple[str, str, str] = ("", "", "")
    sign: float = 1.0


def regressors_of(problem: LikelihoodProblem, found: ModelFit, index: int) -> dict[tuple[str, str], Array]:
    """(signal, shape) -> (N,) functions of the fitted motion and the controls."""
    coarse, outputs = problem.coarse[index], problem.fitted_outputs(index, found)
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
    """The word for where a term is added: an output, or the equation behind a door."""
    return place.removeprefix(DISTURBANCE.format("")) + "_dot" if is_door(place) else place


def _projected(tangent: Tangent, keys: Sequence[tuple[str, str, str]]) -> Projected:
    """Nameless terms (place, signal, shape) with what the base absorbs taken out."""
    problem, model_fit = tangent.problem, tangent.fit
    regressors = pooled([regressors_of(problem, model_fit, i) for i in range(len(problem.records))])
    zeros = [np.zeros(len(s)) for s in problem.coarse]
    asks = [[(k[0], r.get(k[1:], nothing)) for k in keys] for r, nothing in zip(regressors, zeros, strict=True)]
    gram = gram_of(tangent, lambda i: _changes(problem, model_fit, i, asks[i]))
    return Projected.of(gram, len(problem.free), len(keys))


def beyond_control_noise(round_: Round, signals: Sequence[OmnibusSignal]) -> list[OmnibusSignal]:
    """Terms with what they score beyond the noise of recorded controls.

    That noise is in the motion a term is made of as well as in the residual it is held against, so that both go together where
    nothing is hidden: nulls, held against the motion of the flights, do not show it. Flights without any effect whose controls
    are measured anew do, each with a motion of its own: their mean score is taken off, and where they scatter farther than nulls
    that counts. As they are where such flights cannot be flown.
    """
    keys = [s.key for s in signals]
    scores = [
        _projected(Tangent(problem, found, (found.residuals,)), keys).scores()[:, 1]
        for problem, found in MeasuredAgain(round_.baseline, CONTROLS_ANEW).problems()
    ]
    if len(scores) < FEWEST_ANEW:
        return list(signals)
    scattered = np.array(scores)
    shares = own_shares(np.array([s.sign * np.sqrt(s.gain) for s in signals]), scattered.mean(axis=0))
    wider = np.maximum(scattered.std(axis=0), 1.0)
    return [
        replace(s, score=s.score * float(share / width), gain=s.gain * float(share) ** 2)
        for s, share, width in zip(signals, shares, wider, strict=True)
    ]


def own_shares(signed: Array, mean: Array) -> Array:
    """(terms,) shares, 0 to 1, of signed scores that are left without a mean, which may be of the other sign."""
    towards = np.maximum(np.sign(signed) * mean, 0.0)
    return np.asarray(np.maximum(1.0 - towards / np.maximum(np.abs(signed), NOTHING), 0.0))


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
            measured = z[np.isfinite(z[:, column]), column]
            change[:, column] = regressor * ((TENTH * float(measured.std()) if measured.size else 0.0) or 1.0)
        else:
            change = next(responses)
        changes.append(change)
    return changes
