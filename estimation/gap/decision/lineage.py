"""Models before and after, and as files with their lineage: the effects added to a parent, the flights and the evidence."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from daq.utilities.outputs import write_json
from estimation.gap.answer.result import GapResult
from estimation.gap.fit.baseline import Baseline
from estimation.gap.search.state import AcceptedEffect
from estimation.gap.shapes.search import CoefficientShape
from estimation.models.base import Model
from estimation.models.load import write_model
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
