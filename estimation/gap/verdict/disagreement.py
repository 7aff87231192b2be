"""Where the disagreement lives, seen three times: with the prior parameters frozen, after the refit, and with the effects named.

Refitting hides an effect: derivatives move until they carry most of it. Frozen at what was believed before the flight the
disagreement is large but in its place; after the refit it is small and elsewhere. Both are shown, over channel, time,
flight regime and equation. The equations are asked by a smoother: the disturbance of each force equation that most likely
made the residuals, as force and moment coefficients.
"""

from dataclasses import replace

import numpy as np

from estimation.engine.kernel import Array
from estimation.engine.simulate import Simulator
from estimation.gap.answer.result import DisagreementView
from estimation.gap.criteria import Criteria
from estimation.gap.likelihood.baseline import Baseline
from estimation.gap.likelihood.fitting import LikelihoodProblem, ModelFit, fit
from estimation.gap.likelihood.whitening import (
    NoiseModel,
    NoisePart,
    NoiseSource,
    as_seen,
    linear_motion,
    shapes_of,
    spectral_matrix,
)
from estimation.gap.records.flight_records import FlightRecords
from estimation.gap.tests_of_fit.measure import plain_residuals
from estimation.gap.verdict.effect_location import signals_of
from estimation.models.dependence import force_states

LINES = {"beta": "CY", "p": "Cl", "r": "Cn", "alpha": "CL", "q": "Cm"}


def views(first: Baseline, last: Baseline, prepared: FlightRecords, changed: bool) -> tuple[DisagreementView, ...]:
    """The stages there are: prior frozen (unless its motion runs away), refit, and with the named effects."""
    made = []
    frozen = prior_frozen(first)
    if frozen is not None:
        made.append(view("prior parameters frozen", frozen, prepared))
    made.append(view("after the refit", first, prepared))
    if changed:
        made.append(view("with the named effects", last, prepared))
    return tuple(made)


def prior_frozen(baseline: Baseline) -> Baseline | None:
    """The baseline with every derivative at its prior and only initial states and biases fitted; None where that diverges."""
    problem = baseline.problem
    believed = {p.name: p.reference for p in problem.model.parameters if p.reference is not None}
    found = fit(problem, {**problem.starts(), **believed}, baseline.fit.locals, frozen=True)
    return None if found.diverged or not found.residuals else replace(baseline, fit=found)


def view(stage: str, baseline: Baseline, prepared: FlightRecords) -> DisagreementView:
    """Maps of the residuals of one fitted model."""
    problem, found, scatter = baseline.problem, baseline.fit, baseline.scatter
    plain = [plain_residuals(problem, found, i, scatter) for i in range(len(problem.records))]
    outputs = problem.model.output_names
    squares = [(r / scatter) ** 2 for r in plain]
    everything = np.concatenate(squares)
    missing = tuple(missing_coefficients(problem, found, i, r, scatter) for i, r in enumerate(plain))
    return DisagreementView(
        stage=stage,
        gap=float(np.sqrt(np.nanmean(everything))),
        channels={n: float(np.sqrt(np.nanmean(everything[:, c]))) for c, n in enumerate(outputs)},
        times=tuple(
            (prepared.names[problem.records[i].flight], *window)
            for i, s in enumerate(squares)
            for window in windows(problem.coarse[i].time, s, baseline.criteria)
        ),
        regime=by_regime(replace(baseline, fit=replace(found, residuals=tuple(plain)))),
        equations={
            n: float(np.sqrt(np.mean(np.concatenate([m[n] for m in missing]) ** 2))) for n in (missing[0] or {})
        },
        missing=missing,
    )


def windows(time: Array, squares: Array, criteria: Criteria) -> list[tuple[float, float, float]]:
    """(from, to [s], gap) of successive windows."""
    width = max(round(criteria.map_window / float(np.median(np.diff(time)))), 2)
    return [
        (float(time[k]), float(time[min(k + width, time.size) - 1]), float(np.sqrt(np.nanmean(squares[k : k + width]))))
        for k in range(0, time.size - width // 2, width)
    ]


def missing_coefficients(
    problem: LikelihoodProblem, found: ModelFit, index: int, residual: Array, scatter: Array
) -> dict[str, Array]:
    """Equation -> (N,) disturbance that most likely made a residual (N, ny): a Wiener smoother over the linearised motion,
    every equation given the strength at which it alone would double the measurement noise."""
    model, segment = problem.model, problem.coarse[index]
    simulator = Simulator.build(model, (), substeps=1, hold="linear")
    values = {**problem.starts(), **found.values}
    linear = linear_motion(model, simulator, segment, values)
    states = force_states(problem.base)
    shapes = as_seen(shapes_of(model, linear, len(segment), problem.criteria, states), np.isfinite(residual))
    strength = {}
    for name in states:
        power = (
            float(np.mean(np.sum(np.abs(shapes.parts[NoisePart(NoiseSource.RATE, name)]) ** 2 / scatter**2, axis=1)))
            / scatter.size
        )
        if power > 0.0:
            strength[NoisePart(NoiseSource.RATE, name)] = 1.0 / power
    S = spectral_matrix(NoiseModel(scatter**2, strength), shapes)
    weighed = np.linalg.solve(S, np.fft.rfft(np.nan_to_num(residual), axis=0)[:, :, None])[:, :, 0]
    result = {}
    for part, v in strength.items():
        name = part.of
        spectrum = v * np.sum(shapes.parts[part].conj() * weighed, axis=1)
        rate = np.fft.irfft(spectrum, n=len(segment))
        factor = _coefficient_per_rate(problem, name, index)
        result[LINES[name] if factor is not None else f"{name}_dot"] = rate * (1.0 if factor is None else factor)
    return result


def _coefficient_per_rate(problem: LikelihoodProblem, state: str, index: int) -> float | None:
    """Coefficient that makes a unit rate of a state at the mean dynamic pressure; None where the model does not say."""
    known, record = problem.model.constants, problem.records[index]
    if state not in LINES or LINES[state] not in problem.model.definitions or "V" not in record.inputs:
        return None
    V = float(np.mean(record.inputs["V"]))
    rho = float(np.mean(record.inputs["rho"])) if "rho" in record.inputs else known.get("rho", 0.0)
    pressure = 0.5 * rho * V**2
    need = {
        "beta": ("m", "S"),
        "alpha": ("m", "S"),
        "p": ("Ixx", "S", "b"),
        "r": ("Izz", "S", "b"),
        "q": ("Iyy", "S", "c"),
    }
    if pressure <= 0.0 or any(n not in known for n in need[state]):
        return None
    inertia, *lengths = (known[n] for n in need[state])
    factor = inertia / (pressure * float(np.prod(lengths)))
    return {"beta": V, "alpha": -V}.get(state, 1.0) * factor


def by_regime(baseline: Baseline) -> dict[str, list[dict[str, float]]]:
    """Map of the disagreement over the flight regime: per signal, bins of rms residual / noise over all outputs."""
    squares = np.concatenate([(r / baseline.scatter) ** 2 for r in baseline.fit.residuals])
    known = np.isfinite(squares).sum(axis=1)
    total = np.where(known > 0, np.nansum(squares, axis=1) / np.maximum(known, 1), np.nan)
    return {name: binned(values, total, baseline.criteria) for name, values in signals_of(baseline).items()}


def binned(values: Array, squares: Array, criteria: Criteria) -> list[dict[str, float]]:
    """Root mean of `squares` (N,) in equally filled bins of a signal (N,), low to high; of samples where nothing was compared
    (NaN) none counts."""
    compared = np.isfinite(squares)
    if not compared.any():
        return []
    values, squares = values[compared], squares[compared]
    ends = np.unique(np.quantile(values, np.linspace(0, 1, criteria.map_bins + 1)))
    rows = []
    for a, b in zip(ends[:-1], ends[1:], strict=True):
        gap = float(np.sqrt(np.mean(squares[(values >= a) & (values <= b)])))
        rows.append({"from": round(float(a), 5), "to": round(float(b), 5), "gap": round(gap, 4)})
    return rows
