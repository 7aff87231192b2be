"""The workflow with its files, as the verb writes them."""

from collections.abc import Callable, Sequence
from pathlib import Path

from daq.utilities.outputs import write_json
from estimation.gap.answer.result import GapResult
from estimation.gap.decision.lineage import with_models
from estimation.gap.effects import Effect
from estimation.gap.workflow import Options, run_gap
from estimation.models.base import Model
from groundstation.flight import Flight


def analyse(
    model: Model,
    training: Sequence[Flight],
    holdout: Sequence[Flight],
    effects: Sequence[Effect],
    options: Options,
    tell: Callable[[str, float], None],
    models: Path,
    json_path: Path,
) -> GapResult:
    """Run the workflow; models and lineage go to a folder, the answer to a JSON file."""
    result = run_gap(model, training, holdout, effects, options, tell)
    result = with_models(result, [*training, *holdout], options.seed, models)
    write_json(result.to_json(), json_path)
    tell("done", 1.0)
    return result
