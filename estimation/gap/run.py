"""One run of the gap workflow with its files: models, lineage and JSON."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from daq.contract.outputs import write_json
from estimation.gap.answer.result import GapResult
from estimation.gap.effects.base import Effect
from estimation.gap.verdict.lineage import write_lineage
from estimation.gap.workflow import LOOK, Options, run_gap
from estimation.models.base import Model
from groundstation.flight import Flight


def analyse(
    model: Model,
    training: Sequence[Flight],
    holdout: Sequence[Flight],
    effects: Sequence[Effect],
    options: Options,
    tell: LOOK,
    report_folder: Path | None = None,
    json_path: Path | None = None,
) -> GapResult:
    """Run the workflow; models and lineage go to `report_folder`/models, or beside the JSON file where only that is given."""
    result = run_gap(model, training, holdout, effects, options, tell)
    folder = (
        report_folder / "models"
        if report_folder is not None
        else json_path.parent / f"{json_path.stem}-models"
        if json_path
        else None
    )
    if folder is not None:
        result = with_models(result, [*training, *holdout], options.seed, folder)
    if json_path is not None:
        write_json(result.to_json(), json_path)
    tell("done", 1.0)
    return result


def with_models(result: GapResult, flights: Sequence[Flight], seed: int, folder: Path) -> GapResult:
    """Write the models before and after, with their lineage, to `folder`; the result that names these files."""
    before, after = write_lineage(folder, result.model_before, result.model_after, result.steps, flights, seed)
    return replace(result, files=(str(before), str(after)))
