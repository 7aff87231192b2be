"""Where the disagreement is, at three stages: with the prior parameters frozen, after the refit, and with the named effects; and
where one effect acts.

A refit hides an effect: derivatives move until they carry most of it. With the parameters frozen at their prior values the
disagreement is large but where it arises; after the refit it is small and elsewhere. Both are shown over channel, time, flight
regime and equation. A smoother gives the equations: the disturbance of each force equation that most likely caused the
residuals, as force and moment coefficients.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from estimation.engine.kernel import Array
from estimation.engine.simulate import Simulator
from estimation.gap.answer.result import PRIOR_FROZEN, DisagreementView, Where
from estimation.gap.criteria import Criteria
from estimation.gap.effects.base import Form
from estimation.gap.fit.baseline import Baseline
from estimation.gap.fit.fitting import fit
from estimation.gap.fit.linear_motion import linear_motion
from estimation.gap.fit.noise import NoiseModel, NoisePart, NoiseSource, as_seen, shapes_of, spectral_matrix
from estimation.gap.fit.problem import LikelihoodProblem, ModelFit
from estimation.gap.records.flight_records import FlightRecords
from estimation.gap.significance.measure import plain_residuals
from estimation.models.dependence import force_states
from groundstation.flight.arrays import true_runs

RATES: dict[str, tuple[str, str, tuple[str, ...]]] = {
    "beta": ("CY", "m", ("S",)),
    "alpha": ("CL", "m", ("S",)),
    "p": ("Cl", "Ixx", ("S", "b")),
    "r": ("Cn", "Izz", ("S", "b")),
    "q": ("Cm", "Iyy", ("S", "c")),
}
"""State -> coefficient that drives its rate, inertia, and the lengths and area that make a coefficient of a force or moment."""
DEGREES = {"beta", "alpha", "phi", "theta", "delta_a", "delta_r", "delta_e", "p", "q", "r"}
SPANS = 4  # stretches of flight given for one effect
NOTHING = 1e-12  # gain of an effect that changes nothing
BINS = 6  # of every signal in the map over the flight regime: a picture, which decides nothing
WINDOW = 2.0  # s, in the map over time: a picture too
EQUATIONS = ("CY", "Cl", "Cn", "CL", "CD", "Cm")


def views(first: Baseline, last: Baseline, prepared: FlightRecords) -> tuple[DisagreementView, ...]:
    """The stages: prior frozen (where there is a prior that does not run away), refit, with the named effects if any."""
    stages = {PRIOR_FROZEN: _prior_frozen(first), "after the refit": first}
    if last is not first:
        stages["with the named effects"] = last
    return tuple(_view(stage, baseline, prepared) for stage, baseline in stages.items() if baseline is not None)


def _prior_frozen(baseline: Baseline) -> Baseline | None:
    """The baseline with every derivative at its prior and only initial states and biases fitted; None where that diverges, or
    there is no prior."""
    problem = baseline.problem
    references = {p.name: p.reference for p in problem.model.parameters if p.reference is not None}
    if not references:
        return None
    frozen_fit = fit(problem, {**problem.starts(), **references}, baseline.fit.locals, frozen=True)
    return None if frozen_fit.diverged or not frozen_fit.residuals else replace(baseline, fit=frozen_fit)


def _view(stage: str, baseline: Baseline, prepared: FlightRecords) -> DisagreementView:
    """Maps of the residuals of one fitted model."""
    problem, scatter = baseline.problem, baseline.scatter
    residuals = [plain_residuals(problem, baseline.fit, i, scatter) for i in range(len(problem.records))]
    squares = [(r / scatter) ** 2 for r in residuals]
    everything = np.concatenate(squares)
    counts = np.isfinite(everything).sum(axis=1)
    mean = np.where(counts > 0, np.nansum(everything, axis=1) / np.maximum(counts, 1), np.nan)  # over the outputs
    compared = {n: c[np.isfinite(c)] for n, c in zip(problem.model.output_names, everything.T, strict=True)}
    missing = tuple(_missing_coefficients(problem, baseline.fit, i, r, scatter) for i, r in enumerate(residuals))
    return DisagreementView(
        stage=stage,
        gap=float(np.sqrt(np.nanmean(everything))),
        channels={n: float(np.sqrt(np.mean(column))) for n, column in compared.items() if column.size},
        times=tuple(
            (prepared.names[record.flight], *window)
            for record, segment, s in zip(problem.records, problem.coarse, squares, strict=True)
            for window in windows(segment.time, s)
        ),
        regime={name: binned(values, mean) for name, values in signals_of(baseline).items()},
        equations={n: float(np.sqrt(np.mean(np.concatenate([m[n] for m in missing]) ** 2))) for n in missing[0]},
        missing=missing,
    )


def windows(time: Array, squares: Array) -> list[tuple[float, float, float]]:
    """(from, to [s], gap) of successive windows with compared samples."""
    width = max(round(WINDOW / float(np.median(np.diff(time)))), 2)
    return [
        (float(time[k]), float(time[min(k + width, time.size) - 1]), float(np.sqrt(np.nanmean(squares[k : k + width]))))
        for k in range(0, time.size - width // 2, width)
        if np.isfinite(squares[k : k + width]).any()
    ]


def _missing_coefficients(
    problem: LikelihoodProblem, model_fit: ModelFit, index: int, residual: Array, scatter: Array
) -> dict[str, Array]:
    """Equation -> (N,) disturbance that most likely caused a residual (N, ny): a Wiener smoother over the linearised motion, with
    each disturbance of the strength that alone would double the measurement noise."""
    model, segment, states = problem.model, problem.coarse[index], force_states(problem.base)
    simulator = Simulator.build(model, (), substeps=1, hold="linear")
    linear = linear_motion(model, simulator, segment, {**problem.starts(), **model_fit.values})
    shapes = as_seen(shapes_of(model, linear, len(segment), problem.criteria, states), np.isfinite(residual))
    strength = {}
    for name in states:
        part = NoisePart(NoiseSource.RATE, name)
        power = float(np.mean(np.sum(np.abs(shapes.parts[part]) ** 2 / scatter**2, axis=1))) / scatter.size
        if power > 0.0:
            strength[part] = 1.0 / power
    S = spectral_matrix(NoiseModel(scatter**2, strength), shapes)
    weighed = np.linalg.solve(S, np.fft.rfft(np.nan_to_num(residual), axis=0)[:, :, None])[:, :, 0]
    missing = {}
    for part, v in strength.items():
        spectrum = v * np.sum(shapes.parts[part].conj() * weighed, axis=1)
        line, factor = _coefficient_per_rate(problem, part.of, index) or (f"{part.of}_dot", 1.0)
        missing[line] = np.fft.irfft(spectrum, n=len(segment)) * factor
    return missing


def _coefficient_per_rate(problem: LikelihoodProblem, state: str, index: int) -> tuple[str, float] | None:
    """The coefficient that drives a state, and its value for a unit rate at the mean dynamic pressure; None where the model
    lacks a number for it."""
    constants, record = problem.model.constants, problem.records[index]
    if state not in RATES or "V" not in record.inputs:
        return None
    line, inertia, lengths = RATES[state]
    V = float(np.mean(record.inputs["V"]))
    rho = float(np.mean(record.inputs["rho"])) if "rho" in record.inputs else constants.get("rho", 0.0)
    pressure = 0.5 * rho * V**2
    if line not in problem.model.definitions or pressure <= 0.0 or not {inertia, *lengths} <= constants.keys():
        return None
    factor = constants[inertia] / (pressure * float(np.prod([constants[n] for n in lengths])))
    return line, {"beta": V, "alpha": -V}.get(state, 1.0) * factor


def binned(values: Array, squares: Array) -> list[dict[str, float]]:
    """Root mean of `squares` (N,) in equally filled bins of a signal (N,), low to high; NaN does not count."""
    compared = np.isfinite(squares)
    if not compared.any():
        return []
    values, squares = values[compared], squares[compared]
    ends = np.unique(np.quantile(values, np.linspace(0, 1, BINS + 1)))
    rows = []
    for a, b in zip(ends[:-1], ends[1:], strict=True):
        gap = float(np.sqrt(np.mean(squares[(values >= a) & (values <= b)])))
        rows.append({"from": round(float(a), 5), "to": round(float(b), 5), "gap": round(gap, 4)})
    return rows


def equation_of(form: Form) -> str:
    """The equation a form enters: a coefficient, a rate, an instrument or a control."""
    if form.outputs or form.output_delays:
        return "measured " + ", ".join(form.outputs or form.output_delays)
    if form.transforms:
        return form.transforms[0].input
    coefficients = [line for line in form.terms if line in EQUATIONS]
    return ", ".join(coefficients or form.terms or [p.name for p in form.parameters])


def locate(parent: Baseline, child: Baseline, equation: str) -> Where:
    """Where the child explains more than the parent. equation: the one changed. Segments are times of one flight, on its own
    clock: the training flight with most of them."""
    scatter, criteria = parent.scatter, child.criteria
    gain = [
        np.nan_to_num((p / scatter) ** 2 - (c / scatter) ** 2)
        for p, c in zip(parent.fit.residuals, child.fit.residuals, strict=True)
    ]
    order = channels_that_gain(np.sum([g.sum(axis=0) for g in gain], axis=0), criteria)
    courses = [g.sum(axis=1) for g in gain]
    spans = [spans_of(s.time, course, criteria) for s, course in zip(child.problem.coarse, courses, strict=True)]
    return Where(
        equation=equation,
        channels=tuple(child.model.output_names[i] for i in order),
        segments=tuple(max(spans, key=len)[:SPANS]),
        regime=regime(signals_of(child), np.concatenate(courses), criteria),
    )


def channels_that_gain(gain: Array, criteria: Criteria) -> list[int]:
    """Indices of the outputs that show an effect, best first. gain: (ny,)."""
    limit = criteria.negligible * max(float(gain.max()), NOTHING)
    return [int(i) for i in np.argsort(-gain) if gain[i] > limit]


def spans_of(time: Array, gain: Array, criteria: Criteria) -> list[tuple[float, float]]:
    """(from, to [s]) of the stretches with most of the gain (N,), best first."""
    n = min(max(round(criteria.gust_memory / float(np.median(np.diff(time)))), 2), time.size)
    smooth = np.convolve(gain, np.ones(n) / n, mode="same")
    limit = max(criteria.negligible * float(smooth.max()), NOTHING)
    spans = [(a, b - 1) for a, b in true_runs(smooth > limit) if b - a >= n // 2]
    spans.sort(key=lambda s: -float(gain[s[0] : s[1] + 1].sum()))
    return [(float(time[a]), float(time[b])) for a, b in spans]


def regime(signals: Mapping[str, Array], gain: Array, criteria: Criteria) -> str:
    """The flight condition with most of the gain (N,): the signal whose large values coincide with it best."""
    highest, text = criteria.clearly_above, "everywhere"
    for name, values in signals.items():
        size = np.abs(values - np.median(values))
        limit = float(np.quantile(size, criteria.regime_quantile))
        large = size > limit
        if not large.any():
            continue
        ratio = float(np.sum(gain[large])) / max(float(np.sum(np.maximum(gain, 0.0))), NOTHING) / large.mean()
        if ratio > highest:
            highest = ratio
            centre = float(np.median(values))
            if name not in DEGREES:
                text = f"{name} more than {limit:.3g} from {centre:.3g}"
            elif abs(centre) > limit:
                text = f"{name} more than {np.degrees(limit):.1f} deg from {np.degrees(centre):.1f}"
            else:
                text = f"|{name}| > {np.degrees(limit):.1f} {'deg/s' if name in 'pqr' else 'deg'}"
    return text


def signals_of(child: Baseline) -> dict[str, Array]:
    """Signal -> (samples of all records,): modelled outputs, controls and flight condition, those that vary."""
    problem = child.problem
    outputs = [problem.fitted_outputs(i, child.fit) for i in range(len(problem.records))]
    signals = {n: np.concatenate([s[:, i] for s in outputs]) for i, n in enumerate(problem.model.output_names)}
    for i, s in enumerate(problem.model.inputs):
        if s.control or s.name in ("alpha", "V", "thrust"):
            signals[s.name] = np.concatenate([c.u[:, i] for c in problem.coarse])
    return {n: v for n, v in signals.items() if float(np.ptp(v)) > 0.0}
