"""Models before and after as files with their lineage: the effects added to a parent, the flights and the evidence; and columns
of the wrong sign, unit or time that show in the fit of the first model."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from daq.utilities.outputs import write_json
from estimation.estimators.normal_equations import pseudo_inverse
from estimation.estimators.result import Estimate
from estimation.gap.answer.result import GapResult
from estimation.gap.fit.baseline import Baseline
from estimation.gap.records.candidate_model import GYROS, TIMING, TOGETHER, rare_commands, timing_of
from estimation.gap.search.state import AcceptedEffect
from estimation.gap.shapes.search import CoefficientShape
from estimation.models.base import Model
from estimation.models.load import write_model
from estimation.session.sanity_checks import (
    controls_of_another_unit,
    turned_controls,
    turned_outputs,
    turned_side_force,
)
from groundstation.flight import Flight


def models(
    base: Model, first: Baseline, findings: Sequence[AcceptedEffect], shape: CoefficientShape | None = None
) -> tuple[Model, Model]:
    """The fitted base, and the child with the standing effects and a nameless shape (the base where there is neither)."""
    child, fitted, names = base, first, [base.name]
    for f in findings:
        child, fitted = f.candidate.hypothesis.form.added_to(child), f.child
        names.append(f.candidate.hypothesis.effect.name)
    if shape is not None:
        fitted = shape.measured.child
        child = shape.fitted.increment.written_into(child, fitted.fit.values)
        names.append("nameless")
    child = replace(_with_values(child, fitted.fit.values), name="+".join(names))
    return _with_values(base, first.fit.values), child


def _with_values(model: Model, values: Mapping[str, float]) -> Model:
    """`model` with its parameters starting at the fitted `values`."""
    parameters = []
    for p in model.parameters:
        start = float(values.get(p.name, p.start))
        parameters.append(replace(p, start=start, lower=min(p.lower, start), upper=max(p.upper, start)))
    return replace(model, parameters=tuple(parameters))


def with_models(result: GapResult, flights: Sequence[Flight], seed: int, folder: Path) -> GapResult:
    """Write the models before and after as TOML to `folder`, with the record of the effects added; returns the result with these
    file names."""
    parent, child = result.model_before, result.model_after
    parent_file, child_file = folder / f"{parent.name}.toml", folder / f"{child.name}.toml"
    if parent_file == child_file:
        child_file = folder / f"{child.name}-refitted.toml"
    folder.mkdir(parents=True, exist_ok=True)
    write_model(parent, parent_file)
    write_model(child, child_file)
    record = {
        "parent": {"file": parent_file.name, "digest": parent.digest},
        "child": {"file": child_file.name, "digest": child.digest},
        "added": [
            {"effect": s.effect, "form": s.form, "score": s.score, "threshold": s.threshold, "confidence": s.confidence,
             "set": {m.effect: m.weight for m in s.members}, "parameters": {n: v for n, (v, _) in s.estimates.items()},
             "gap": s.gap.to_json(), "holdout": s.holdout.to_json() if s.holdout else None}
            for s in result.steps
        ],
        "flights": [{"name": f.name, "sha256": _flight_digest(f)} for f in flights],
        "seed": seed,
        "software": _software(),
    }  # fmt: skip
    write_json(record, folder / f"{child_file.stem}.lineage.json")
    return replace(result, files=(str(parent_file), str(child_file)))


def _flight_digest(flight: Flight) -> str:
    """Hash of the file a flight came from, or of its samples where it came from no file."""
    if flight.provenance.sha256:
        return flight.provenance.sha256
    digest = hashlib.sha256(flight.time.tobytes())
    for name in sorted(flight.columns):
        digest.update(name.encode() + flight.columns[name].tobytes())
    return digest.hexdigest()


def _software() -> str:
    """Name and version of this program."""
    try:
        return f"sideslip {version('sideslip')}"
    except PackageNotFoundError:
        return "sideslip (not installed)"


def turned_signs(baseline: Baseline) -> list[str]:
    """One sentence for each column that contradicts the base model or its reference values in sign or unit."""
    problem, fit = baseline.problem, baseline.fit
    base, bounds = problem.base, fit.std()
    pairs = [(record.z, record.z - e) for record, e in zip(problem.coarse, fit.residuals, strict=True)]
    estimates = {
        n: Estimate(n, fit.values[n], bounds[n], bounds[n], reference=base.parameter(n).reference)
        for n in base.starts()
        if n in bounds
    }
    return [
        *turned_outputs(base, pairs),
        *turned_side_force(base, estimates),
        *turned_controls(base, estimates),
        *controls_of_another_unit(base, estimates),
    ]


def late_commands(flights: Sequence[Flight], baseline: Baseline) -> str:
    """A sentence on controls recorded as commands no more often than the motion: how long before their record they moved, as the
    gyros show it; empty without such controls."""
    fit, intervals = baseline.fit, rare_commands(baseline.clean, flights)
    signals = [s for s in baseline.clean.inputs if s.name in intervals]
    if not signals:
        return ""
    back = [float(np.mean([f.dated_back(s.source) for f in flights])) for s in signals]
    shifts = [timing_of(s.name, fit.values) for s in signals]
    weight = {TOGETHER: -1.0, GYROS: 1.0} | {f"{TIMING}{s.name}": -1.0 / len(signals) for s in signals}
    share = np.array([weight.get(n, 0.0) for n in fit.free])
    before = np.mean(back) - np.mean(shifts) + fit.values.get(GYROS, 0.0)
    bound = np.sqrt(max(share @ pseudo_inverse(fit.hessian)[0] @ share, 0.0))
    are, they = ("are commands", "they") if len(signals) > 1 else ("is a command", "it")
    return (
        f"{' and '.join(s.name for s in signals)} {are} that the log has every {1e3 * max(intervals.values()):.0f} ms, recorded "
        f"{1e3 * before:.0f} +- {1e3 * bound:.0f} ms after {they} moved by what the gyros show, each move by another time "
        "within that interval: counted."
    )
