"""The gap workflow: from flights and a base model to a verdict, effects with sets and weights, and a better model.

Rounds of: baseline fit, nulls flown through the whole chain, score-test screen, full fits of the leading hypotheses,
held-out check, one effect added; until nothing is significant. Then the earlier effects are questioned again.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimation.gap.admissible import sample_notes
from estimation.gap.baseline import bank_error, channel_noise, filtered_attitudes, fit_baseline
from estimation.gap.bench import build_bench
from estimation.gap.conclusion import conclude_trail
from estimation.gap.dormant import with_dormant
from estimation.gap.effects import catalogue
from estimation.gap.effects.base import Effect
from estimation.gap.effects.missing import missing_derivatives
from estimation.gap.errors import GapError
from estimation.gap.gate import kinematic_gate
from estimation.gap.nuisance import with_nuisance
from estimation.gap.nulls import input_errors
from estimation.gap.result import GapResult
from estimation.gap.rounds import run_rounds
from estimation.gap.trail import AS_USUAL, LOOK, Options, Setting
from estimation.gap.whitening import force_states
from estimation.models.base import Model
from groundstation.flight import Flight


def run_gap(
    model: Model,
    training: Sequence[Flight],
    holdout: Sequence[Flight] = (),
    effects: Sequence[Effect] | None = None,
    options: Options = AS_USUAL,
    tell: LOOK = lambda what, share: None,
) -> GapResult:
    """Find, name and add what `model` lacks on the training flights.

    Raises MissingColumnError, DataError or GapError (one sentence each) where the flights cannot be used.
    """
    if not training:
        raise GapError("no training flight given; name at least one flight file before --holdout")
    chosen = tuple(effects) if effects is not None else catalogue()
    chosen += missing_derivatives(model, {e.name for e in chosen})
    tell("preparing the flights", 0.0)
    bench = build_bench(model, chosen, training, holdout)
    told = sample_notes([*training, *holdout], [s.source for s in (*model.outputs, *model.inputs)])
    bench = replace(bench, notes=(*bench.notes, *told))
    records = bench.of(bench.training)
    white = channel_noise(records)
    scatter = bank_error(records, bench.base.output_names, white)
    filtered = filtered_attitudes(records, bench.base.output_names, white)
    interval = float(np.median([np.median(np.diff(r.time)) for r in records]))
    clean = with_nuisance(model, dict(zip(model.output_names, scatter, strict=True)), interval, filtered)
    working = with_dormant(clean, chosen, bench.available, force_states(model))
    errors = tuple(
        input_errors(r, clean, np.random.default_rng([options.seed, 104729, i])) for i, r in enumerate(bench.records)
    )
    setting = Setting(model, clean, working, bench, chosen, errors, scatter, options, tell)
    tell("fitting the baseline", 0.05)
    trail = run_rounds(setting, fit_baseline(working, clean, bench, scatter))
    tell("kinematic gate", 0.9)
    gate = kinematic_gate(training, chosen, min(options.nulls, 100), options.seed)
    tell("measuring what is closed", 0.95)
    return conclude_trail(setting, trail, gate)
