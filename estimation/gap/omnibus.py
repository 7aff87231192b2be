"""Is anything left that no named effect explains? Nameless terms, restless times and restless regimes.

Three families of statistics on the residuals of a fitted model, each calibrated on the same simulated nulls:
nameless terms (simple functions of the motion added to an output or to a force equation), energy in a second of flight,
and energy that follows some activity (a clipped, stale or sticking sensor errs where its signal moves most).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.baseline import Round
from estimation.gap.dormant import DISTURBANCE
from estimation.gap.edges import jumping_outputs
from estimation.gap.fitting import Fit, Problem, prior_terms
from estimation.gap.screen import reduce_record

SHAPES = {"linear": "{}", "odd": "{0}|{0}|", "even": "{}^2", "rate": "d{}/dt"}
WINDOW = 1.0  # s


@dataclass(frozen=True)
class Signal:
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
    leading: tuple[Signal, ...]

    @property
    def significant(self) -> bool:
        return self.score > self.threshold


def examine(round_: Round, level: float = 0.99) -> Omnibus:
    """All three families on the residuals of a round's baseline."""
    problem, found = round_.baseline.problem, round_.baseline.fit
    nulls = len(round_.null_residuals)
    terms, term_null = _terms(problem, found, round_.null_residuals)
    white = _white(problem, found, round_)
    times, time_null = _times(problem, white, nulls)
    activity, activity_null = _activity(problem, found, white, nulls)
    signals = [*terms, *times, *activity]
    largest = np.max([term_null, time_null, activity_null], axis=0)
    ranked = tuple(sorted(signals, key=lambda s: -s.score)[:8])
    spread = float(np.std(largest)) * np.sqrt(6.0) / np.pi
    gumbel = float(np.mean(largest)) - 0.5772 * spread - spread * float(np.log(-np.log(level)))
    return Omnibus(ranked[0].score if ranked else 0.0, max(gumbel, float(np.quantile(largest, level))), ranked)


def _regressors(problem: Problem, found: Fit, index: int) -> dict[tuple[str, str], Array]:
    """(signal, shape) -> (N,) functions of the fitted motion and the controls, of unit rms."""
    residual = found.residuals[index]
    coarse = problem.coarse[index]
    shown = np.nan_to_num(coarse.z - np.nan_to_num(residual))
    signals = {n: shown[:, i] for i, n in enumerate(problem.model.output_names)}
    signals |= {s.name: coarse.u[:, i] for i, s in enumerate(problem.model.inputs) if s.control}
    made = {}
    for name, s in signals.items():
        for shape, values in (
            ("linear", s), ("odd", s * np.abs(s)), ("even", s**2), ("rate", np.gradient(s, coarse.time)),
        ):  # fmt: skip
            rms = float(np.sqrt(np.mean(values**2)))
            if rms > 0.0:
                made[(name, shape)] = values / rms
    return made


def _terms(problem: Problem, found: Fit, nulls: Sequence[tuple[Array, ...]]) -> tuple[list[Signal], Array]:
    """Scores of nameless terms on the data, and the largest standardised score of every null."""
    names = problem.model.input_names
    doors = [n for n in names if n.startswith(DISTURBANCE.format(""))]
    outputs = problem.model.output_names
    keys: list[tuple[str, str, str]] = []
    grams = []
    n, m = len(problem.free), len(nulls)
    all_keys = None
    per_record = []
    for i in range(len(problem.records)):
        regressors = _regressors(problem, found, i)
        all_keys = set(regressors) if all_keys is None else all_keys & set(regressors)
        per_record.append(regressors)
    common = sorted(all_keys or ())
    for place in (*outputs, *doors):
        keys += [(place, *k) for k in common if not (place == k[0] and k[1] == "linear")]
    for i in range(len(problem.records)):
        changes = [_change(problem, found, i, place, per_record[i][(signal, shape)]) for place, signal, shape in keys]
        grams.append(reduce_record(problem, found, i, changes, [null[i] for null in nulls]).gram)
    G = np.sum(grams, axis=0)
    weight, distance = prior_terms(problem, problem.free, found.values)
    G[:n, :n] += np.diag(weight)
    k = len(keys)
    G[:n, n + k] += distance
    G[n + k, :n] += distance
    rest = G[n:, n:] - G[n:, :n] @ np.linalg.pinv(G[:n, :n], hermitian=True, rcond=1e-12) @ G[:n, n:]
    power = np.maximum(np.diag(rest)[:k], 1e-300)
    seen = power > 1e-3 * np.maximum(np.diag(G)[n : n + k], 1e-300)  # absorbed entirely: says nothing
    z = rest[:k, k:] / np.sqrt(power)[:, None]
    inflation = np.maximum(1.0, np.mean(z[:, 1:] ** 2, axis=1))
    standard = np.abs(z) / np.sqrt(inflation)[:, None]
    standard[~seen] = 0.0
    words = {
        place: place.removeprefix(DISTURBANCE.format("")) + "_dot" if place in doors else place
        for place in (*outputs, *doors)
    }
    signals = [
        Signal("term", words[p], SHAPES[shape].format(s), float(standard[j, 0]), float(z[j, 0] ** 2))
        for j, (p, s, shape) in enumerate(keys)
    ]
    return signals, standard[:, 1 : m + 1].max(axis=0)


def _change(problem: Problem, found: Fit, index: int, place: str, regressor: Array) -> Array:
    """(N, ny) change of the outputs by a regressor of unit rms added to an output or to the rate of a state."""
    coarse = problem.coarse[index]
    if place in problem.model.output_names:
        change = np.zeros_like(coarse.z)
        column = problem.model.output_names.index(place)
        change[:, column] = regressor * problem_scale(coarse.z[:, column])
        return change
    u = coarse.u.copy()
    step = 0.05 if place != DISTURBANCE.format("beta") else 0.005
    u[:, problem.model.input_names.index(place)] = step * regressor
    moved = problem.residual(index, found.values, found.locals[index], inputs=u)
    return np.zeros_like(coarse.z) if moved is None else np.nan_to_num(found.residuals[index] - moved) / step


def problem_scale(values: Array) -> float:
    """A scale for additions to an output: a tenth of its own scatter."""
    return 0.1 * float(np.nanstd(values)) or 1.0


def _white(problem: Problem, found: Fit, round_: Round) -> list[Array]:
    """Per record (N, ny, 1 + nulls): whitened residuals of the data and the nulls, local unknowns taken out."""
    result = []
    for i in range(len(problem.records)):
        linear = problem.linearised(i, found.values, found.locals[i])
        assert linear is not None, "a converged fit can be linearised"
        residual, dy = linear
        stack = np.concatenate([residual[:, :, None], *(null[i][:, :, None] for null in round_.null_residuals)], axis=2)
        stack = np.nan_to_num(stack)
        rows = problem.whiteners[i].rows(np.concatenate([dy, stack], axis=2))
        J = rows[:, : dy.shape[2]]
        scale = 1.0 / np.sqrt(np.maximum(np.sum(J**2, axis=0), 1e-300))
        A = (J * scale).T @ (J * scale) + 1e-9 * np.eye(J.shape[1])
        theta = scale[:, None] * np.linalg.solve(A, (J * scale).T @ rows[:, dy.shape[2] :])
        left = stack - np.einsum("tyn,nm->tym", dy, theta)
        result.append(problem.whiteners[i].series(left))
    return result


def _times(problem: Problem, white: Sequence[Array], nulls: int) -> tuple[list[Signal], Array]:
    """Energy of every channel in windows of a second, standardised by the same window on the nulls."""
    signals: list[Signal] = []
    largest = np.zeros(nulls)
    for i, series in enumerate(white):
        time = problem.coarse[i].time
        width = max(round(WINDOW / float(np.median(np.diff(time)))), 4)
        count = series.shape[0] // width
        energy = np.log(np.sum((series[: count * width] ** 2).reshape(count, width, *series.shape[1:]), axis=1) + 1e-12)
        centre = np.median(energy[:, :, 1:], axis=2)
        spread = np.std(energy[:, :, 1:], axis=2)
        z = (energy - centre[:, :, None]) / np.maximum(spread, 1e-9)[:, :, None]
        largest = np.maximum(largest, z[:, :, 1:].max(axis=(0, 1)))
        for w, c in zip(*np.unravel_index(np.argsort(-z[:, :, 0].ravel())[:3], z.shape[:2]), strict=True):
            span = (float(time[w * width]), float(time[(w + 1) * width - 1]))
            times = float(np.exp((energy - centre[:, :, None])[w, c, 0] / 2))
            what = f"residual {times:.1f} times its usual size"
            place, flight = problem.model.output_names[c], problem.records[i].flight
            signals.append(Signal("time", place, what, float(z[w, c, 0]), flight=flight, span=span))
    return signals, largest


def _activity(problem: Problem, found: Fit, white: Sequence[Array], nulls: int) -> tuple[list[Signal], Array]:
    """Does the energy of a channel follow the size or the rate of some signal?"""
    total: dict[tuple[int, str], Array] = {}
    jumping = {s.name for s in problem.model.inputs if s.control} | set(jumping_outputs(problem.model))
    for i, series in enumerate(white):
        for (name, shape), values in _regressors(problem, found, i).items():
            # fast surfaces between two samples leave scatter of their own, and so does what jumps with them: rates of
            # theirs say nothing here, nor does the scatter of an output that jumps
            if shape not in ("even", "rate") or (shape == "rate" and name in jumping):
                continue
            weight = np.minimum(np.abs(values), 3.0)
            weight = weight - weight.mean()
            for c in (c for c, output in enumerate(problem.model.output_names) if output not in jumping):
                energy = np.minimum(series[:, c] ** 2, 16.0)
                key = (c, f"|{name}|" if shape == "even" else f"|d{name}/dt|")
                total[key] = total.get(key, np.zeros(series.shape[2])) + weight @ energy
    signals = []
    largest = np.zeros(nulls)
    for (c, what), values in total.items():
        centre, spread = float(np.mean(values[1:])), float(np.std(values[1:])) + 1e-12
        z = (values - centre) / spread
        largest = np.maximum(largest, z[1:])
        signals.append(Signal("activity", problem.model.output_names[c], f"scatter grows with {what}", float(z[0])))
    return signals, largest
