"""The gap workflow: from flights and a base model to a verdict, effects with sets and weights, and a better model.

Rounds of: baseline fit, nulls flown through the whole chain, score-test screen, full fits of the leading hypotheses,
held-out check, one effect added; until nothing is significant. Then the earlier effects are questioned again.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from estimation.errors import EstimationError
from estimation.estimators.output_error import output_error
from estimation.gap.answer.result import GapResult, GapVerdict
from estimation.gap.decision.conclusion import concluded
from estimation.gap.decision.lineage import late_commands, turned_signs
from estimation.gap.effects import catalogue
from estimation.gap.effects.base import Effect
from estimation.gap.effects.missing import missing_derivatives
from estimation.gap.errors import GapError
from estimation.gap.fit.baseline import Baseline, fit_baseline
from estimation.gap.fit.channel_noise import (
    bank_error,
    channel_noise,
    filtered_attitudes,
    pitch_error,
    sample_interval,
)
from estimation.gap.random_streams import Stream
from estimation.gap.records.attitudes import with_attitudes_between
from estimation.gap.records.broken import broken_in_words, unmoved_in_words, without_stuck
from estimation.gap.records.candidate_model import rare_commands, stamped_attitudes, with_dormant, with_nuisance
from estimation.gap.records.doubts import doubts_of, refuse_twice, sample_notes, stale_channels
from estimation.gap.records.flight_records import FlightRecords, prepare_flights
from estimation.gap.records.own_motion import only_following, without_hardware_of, words_on
from estimation.gap.records.reconstructed import as_measured, compared, levels, not_compared, with_levels
from estimation.gap.records.sampling import at_own_rates, flown_apart, with_lost_rows, without_unseen_moves
from estimation.gap.search.free_base import (
    derivatives_off,
    far_off,
    many,
    moved_in_words,
    others_freed_in_words,
    outstanding,
    with_free_derivatives,
)
from estimation.gap.search.rounds import run_rounds
from estimation.gap.search.state import AS_USUAL, Options, ProgressCallback, Setting
from estimation.gap.significance.kinematic_check import kinematic_check
from estimation.gap.significance.nulls import input_errors, with_errors
from estimation.models.base import Model
from estimation.models.dependence import force_states
from groundstation.flight import Flight


def run_gap(
    model: Model,
    training: Sequence[Flight],
    holdout: Sequence[Flight] = (),
    effects: Sequence[Effect] | None = None,
    options: Options = AS_USUAL,
    tell: ProgressCallback = lambda what, share: None,
) -> GapResult:
    """Find, name and add what `model` lacks on the training flights.

    Raises MissingColumnError, DataError or GapError (one sentence each) where the flights cannot be used.
    """
    if not training:
        raise GapError("no training flight given; name at least one flight file before --holdout")
    refuse_twice(training, holdout)
    training, holdout = (
        [part for f in group for part in flown_apart(f, options.criteria)] for group in (training, holdout)
    )
    flights = [*training, *holdout]
    full_model, (model, comparison_notes) = model, compared(model, flights)
    tell("preparing the flights", 0.0)
    controls = [s.source for s in model.inputs if s.control and not s.computed]
    outputs = [s.source for s in model.outputs]
    sensed = [*outputs, *(s.source for s in model.inputs if not s.computed)]
    training, holdout = ([without_stuck(f, sensed) for f in group] for group in (training, holdout))
    gridded = (
        [with_attitudes_between(with_lost_rows(f), options.criteria) for f in group] for group in (training, holdout)
    )
    read = (at_own_rates(group, controls, outputs, options.criteria) for group in gridded)
    training_flights, holdout_flights = (
        [without_unseen_moves(f, controls, outputs, options.criteria) for f in group] for group in read
    )
    fault_notes = sample_notes(flights, [*outputs, *(s.source for s in model.inputs)], options.criteria)
    stale = stale_channels(training_flights, outputs, options.criteria)

    def begun(base: Model) -> tuple[Setting, Baseline]:
        candidates = tuple(effects) if effects is not None else catalogue(model=base)
        candidates += missing_derivatives(base, {e.name for e in candidates})
        prepared = prepare_flights(base, candidates, training_flights, holdout_flights, options.criteria)
        prepared = replace(prepared, notes=(*comparison_notes, *prepared.notes, *fault_notes), stale=stale)
        stamped, commanded = stamped_attitudes(base, flights), rare_commands(base, training_flights)
        setting = _setting(prepared, candidates, levels(base, flights), stamped, commanded, options, tell)
        tell("fitting the baseline", 0.05)
        return setting, fit_baseline(setting.working, setting.clean, setting.prepared, setting.scatter)

    doubts, moved = [*broken_in_words(flights, full_model), *doubts_of(flights, model)], ""
    try:
        try:
            setting, baseline = begun(model)
        except GapError as error:
            model = _estimated(model, training_flights, error)
            setting, baseline = begun(model)
        if off := derivatives_off(setting, baseline):
            # the one that stands out is for the search, which has to confirm it
            asked = outstanding(setting, baseline, off) if setting.commanded else None
            freely = tuple(n for n in off if n != asked)
            freed = begun(with_free_derivatives(model, freely))
            if asked or many(far_off(freely, model.starts(), freed[1].fit, options.criteria), options.criteria):
                setting, baseline = freed
                bent = bool(setting.commanded)
                moved = others_freed_in_words(freely) if asked else moved_in_words(off, model.starts(), baseline, bent)
        doubts += turned_signs(baseline)
        search = run_rounds(setting, baseline)
    except GapError as error:
        raise GapError("; ".join([str(error), *doubts[:1]])) from error
    tell("kinematic check", 0.9)
    measured = [as_measured(with_attitudes_between(f, options.criteria)) for f in training]
    check = kinematic_check(measured, setting.effects, options.nulls, options.seed, options.criteria, model)
    tell("measuring what is closed", 0.95)
    answer = concluded(setting, search, check)
    unmoved = unmoved_in_words(flights, model)
    further = (moved, late_commands(training_flights, baseline), not_compared(full_model, model))
    # a control whose channel is dead may be the unknown itself: then it is the first to look at
    unknown = answer.verdict is GapVerdict.UNKNOWN
    sentences = (unmoved, answer.text, *further) if unknown else (answer.text, *further, unmoved)
    answer = replace(answer, text=" ".join(t for t in sentences if t))
    return _with_doubts(answer, doubts)


def _setting(
    prepared: FlightRecords,
    effects: tuple[Effect, ...],
    wide: Mapping[str, float],
    stamped: Mapping[str, float],
    commanded: Mapping[str, float],
    options: Options,
    tell: ProgressCallback,
) -> Setting:
    """The base model with what every fit carries along and all candidates dormant, and what is wrong with the inputs. wide: how
    uncertain the level of a signal is that was found from the motion; stamped: attitude -> interval of its own times;
    commanded: as `Setting` has it."""
    base, records = prepared.base, prepared.of(prepared.training)
    following = only_following(records, base, options.criteria)
    effects, unasked = without_hardware_of(effects, following)
    control_notes = [f"{prepared.names[k]}: {words_on(n)}" for n in following for k in prepared.training if unasked]
    white = channel_noise(records)
    scatter = bank_error(records, base.output_names, white, options.criteria)
    scatter = pitch_error(records, base.output_names, scatter, options.criteria)
    filtered = filtered_attitudes(records, base.output_names, white, options.criteria)
    noise = dict(zip(base.output_names, scatter, strict=True))
    levelled, interval = with_levels(base, wide), sample_interval(records)
    clean = with_nuisance(levelled, noise, interval, options.criteria, filtered, stamped)
    working = with_dormant(clean, effects, prepared.available, force_states(base))
    streams = (Stream.INPUT_ERRORS.generator(options.seed, i) for i in range(len(prepared.records)))
    errors = tuple(input_errors(r, clean, rng) for r, rng in zip(prepared.records, streams, strict=True))
    prepared = replace(
        prepared, records=with_errors(prepared.records, clean, errors), notes=(*prepared.notes, *control_notes)
    )
    return Setting(
        base, clean, working, prepared, effects, following, unasked, commanded, errors, scatter, options, tell
    )


def _estimated(model: Model, flights: Sequence[Flight], runs_away: GapError) -> Model:
    """A base that runs away from its own starts, begun where maximum likelihood ends: with a state that nobody measured there is
    no regression to begin with. Raises the error itself where these flights cannot be estimated either."""
    try:
        found = output_error(model, flights)
    except EstimationError:
        raise runs_away from None
    return model.with_starts({n: found.fitted_model.starts()[n] for n in model.free_names})


def _with_doubts(result: GapResult, doubts: Sequence[str]) -> GapResult:
    """The answer, told to be of flights that are to be looked at first."""
    if not doubts:
        return result
    suffix = f" (and {len(doubts) - 1} more, in the notes)" if len(doubts) > 1 else ""
    first = f"{doubts[0]}{suffix}".removesuffix(".")
    text = f"Before any of this, look at the flights: {first}{'' if first.endswith('?') else '.'} {result.text}"
    return replace(result, text=text, notes=(*result.notes, *doubts))
