"""The gap workflow: from flights and a base model to a verdict, effects with sets and weights, and a better model.

A round fits the base to the training flights, simulates nulls (the same flights without any effect), screens all hypotheses by
score test against them, fits the leading ones in full, checks them on the held-out flights, and adds one effect. Rounds go on
until nothing is significant. `estimation.gap.search` defines these words.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from estimation.errors import DataError, EstimationError, GapError
from estimation.estimators.output_error import output_error
from estimation.gap.answer.result import GapResult, GapVerdict
from estimation.gap.answer.words import unconfirmed_in_words
from estimation.gap.decision.conclusion import concluded
from estimation.gap.effects import catalogue
from estimation.gap.effects.base import Effect
from estimation.gap.effects.catalogue import missing_derivatives
from estimation.gap.fit.baseline import Baseline, fit_baseline, stretch_that_holds
from estimation.gap.fit.closed_loop import ClosedLoop, feedback_of, only_following, without_hardware_of, words_on
from estimation.gap.fit.noise import bank_error, channel_noise, filtered_attitudes, pitch_error
from estimation.gap.fit.spikes import Spikes, spikes_about, spikes_in_words, without_spikes
from estimation.gap.records.candidate_model import (
    levels,
    rare_commands,
    stamped_attitudes,
    with_dormant,
    with_levels,
    with_nuisance,
)
from estimation.gap.records.channels import (
    as_measured,
    broken_in_words,
    compared,
    doubts_of,
    not_compared,
    refuse_twice,
    sample_notes,
    stale_channels,
    unmoved_in_words,
    without_stuck,
)
from estimation.gap.records.flight_records import FlightRecords, prepare_flights, sample_interval
from estimation.gap.records.sampling import (
    at_own_rates,
    flown_apart,
    with_attitudes_between,
    with_lost_rows,
    without_unseen_moves,
)
from estimation.gap.search.accept import is_strong
from estimation.gap.search.bases import (
    answers_an_effect,
    derivatives_off,
    explained_by_one,
    far_off,
    many,
    moved_in_words,
    others_freed_in_words,
    outstanding,
    with_free_derivatives,
)
from estimation.gap.search.rounds import run_rounds
from estimation.gap.search.state import AS_USUAL, Options, ProgressCallback, SearchState, Setting
from estimation.gap.significance.instruments import kinematic_check, late_commands, turned_signs
from estimation.gap.significance.nulls import Stream, input_errors, with_errors
from estimation.models.base import Model
from estimation.models.dependence import force_states
from groundstation.flight import Flight

LOOP_PASSES = 4  # fits about which the answers of the controls to gusts are found; two settle them in usual gusts
SPIKE_PASSES = 2  # a large spike bends the first fit, so that others hide beside it
NAMED = frozenset({GapVerdict.GAP_CLOSED, GapVerdict.GAP_REDUCED})


@dataclass(frozen=True)
class _Run:
    """What all bases of a run share.

    given: flights as measured, training ones first; sound: training flights without stuck channels; training, holdout: as fits
    take them. notes_before, notes_after: those of the records stand between. stale: outputs that repeat values. effects:
    candidates, None for the whole catalogue. stretched: in records cut where a fit grew, which is wrong about what controls
    answer.
    """

    given: tuple[Flight, ...]
    sound: tuple[Flight, ...]
    training: tuple[Flight, ...]
    holdout: tuple[Flight, ...]
    notes_before: tuple[str, ...]
    notes_after: tuple[str, ...]
    stale: tuple[str, ...]
    effects: Sequence[Effect] | None
    options: Options
    tell: ProgressCallback
    stretched: bool = False

    @classmethod
    def of(
        cls,
        model: Model,
        training: Sequence[Flight],
        holdout: Sequence[Flight],
        notes: Sequence[str],
        effects: Sequence[Effect] | None,
        options: Options,
        tell: ProgressCallback,
    ) -> "_Run":
        """Prepare flights for `model`: faults left out, attitudes between their samples, at the rate of the slowest control."""
        criteria, given = options.criteria, (*training, *holdout)
        controls = [s.source for s in model.inputs if s.control and not s.computed]
        outputs = [s.source for s in model.outputs]
        sensed = [*outputs, *(s.source for s in model.inputs if not s.computed)]
        sound = [tuple(without_stuck(f, sensed) for f in group) for group in (training, holdout)]
        prepared = []
        for group in sound:
            on_grid = [with_attitudes_between(with_lost_rows(f), criteria) for f in group]
            resampled = at_own_rates(on_grid, controls, outputs, criteria)
            prepared.append(tuple(without_unseen_moves(f, controls, outputs, criteria) for f in resampled))
        faults = sample_notes(given, [*outputs, *(s.source for s in model.inputs)], criteria)
        stale = tuple(stale_channels(prepared[0], outputs, criteria))
        return cls(
            given, sound[0], prepared[0], prepared[1], tuple(notes), tuple(faults), stale, effects, options, tell
        )

    def without_spikes(self, spikes: Spikes) -> "_Run":
        """The same with the spikes of flights left out. spikes: by index of the flight, training ones first."""
        count, flights = len(self.training), self._flights
        clean = [without_spikes(f, spikes.get(i, {})) for i, f in enumerate(flights)]
        sound = [
            without_spikes(f, spikes.get(i, {})) if len(f) == len(clean[i]) else f for i, f in enumerate(self.sound)
        ]
        notes = (*self.notes_after, *spikes_in_words(flights, spikes))
        return replace(
            self, sound=tuple(sound), training=tuple(clean[:count]), holdout=tuple(clean[count:]), notes_after=notes
        )

    def set_up(self, base: Model, loop: ClosedLoop | None = None) -> tuple[Setting, Baseline]:
        """What all rounds share and the first fit, for `base`; with the closed loop in both where a control answers gusts and no
        effect that the base lacks explains that. loop: that of an earlier fit to these flights."""
        if loop is None:
            setting, baseline = self._fitted(base)
            loop = None if self.stretched else self._loop_about(baseline)
            if loop is None or not loop.gains:
                return setting, baseline
            if answers_an_effect(setting, baseline, loop, self._flights):
                return replace(setting, loop_left_open=loop), baseline
        return self._in_loop(base, loop)

    def _in_loop(self, base: Model, loop: ClosedLoop) -> tuple[Setting, Baseline]:
        """The same with a closed loop; with controls as given where it runs away or steers by radians, as none does in flight."""
        for _ in range(LOOP_PASSES):
            try:
                setting, baseline = self._without_answers(loop)._fitted(base, loop)
            except (GapError, DataError):
                return self._fitted(base)
            renewed = ClosedLoop.of(baseline, self._flights, loop.gains)
            if renewed.is_near(loop, baseline.problem.records):
                break
            loop = renewed
        return setting, baseline

    def _loop_about(self, baseline: Baseline) -> ClosedLoop:
        """The closed loop about a fit that takes controls as given, with the gains of those that answer gusts."""
        base = baseline.prepared.base
        loop = ClosedLoop.of(baseline, self._flights, feedback_of(baseline.problem.records, base))
        if not (felt := loop.felt(baseline)):
            return replace(loop, gains={})
        # de-noising takes off part of what follows the motion, unless asked to keep it
        following = prepare_flights(base, (), self.training, (), self.options.criteria, keep_feedback=True).records
        gains = {**loop.gains, **feedback_of(following, base)}
        return replace(loop, gains={n: gains[n] for n in felt})

    def searched(self, setting: Setting, baseline: Baseline) -> tuple[Setting, SearchState]:
        """All rounds; where a control seems to answer gusts, in the closed loop or with controls as given, whichever is likelier,
        and the other way where the effects found contradict that: a pilot answers what a missing effect does too."""
        first = setting, run_rounds(setting, baseline)
        loop, is_closed = setting.loop or setting.loop_left_open, setting.loop is not None
        if loop is None or self._explains_answers(first[1], loop, is_closed) != is_closed:
            return first
        setting, baseline = self._fitted(setting.base) if is_closed else self._in_loop(setting.base, loop)
        if not is_closed and setting.loop is None:  # it runs away
            return first
        second = setting, run_rounds(setting, baseline)
        return first if not is_closed and self._explains_answers(second[1], loop, True) else second

    def _explains_answers(self, search: SearchState, loop: ClosedLoop, is_closed: bool) -> bool:
        """Whether beside the effects that were found no control answers gusts any more; False where none was found.

        With controls as given one of them has to be strong, for small ones come from gusts that a control answers. is_closed:
        whether the records of the search lack what `loop` answers.
        """
        criteria = self.options.criteria
        if not any(is_closed or is_strong(f.candidate.score, f.round_.threshold, criteria) for f in search.findings):
            return False
        child = search.findings[-1].child
        return not ClosedLoop.of(child, self._flights, loop.gains).felt(child, loop if is_closed else None)

    @property
    def _flights(self) -> tuple[Flight, ...]:
        """All flights as fits take them, training ones first."""
        return (*self.training, *self.holdout)

    def _without_answers(self, loop: ClosedLoop) -> "_Run":
        """The same with the controls of all flights as they would have been in still air."""
        count, flights = len(self.training), self._flights
        still = [loop.without_answers(i, f) for i, f in enumerate(flights)]
        return replace(self, training=tuple(still[:count]), holdout=tuple(still[count:]))

    def in_stretches(self, baseline: Baseline) -> "_Run | None":
        """The same with records over which the motion of a fit grows little; None where it does so anyway."""
        longest = stretch_that_holds(baseline)
        if longest is None:
            return None
        self.tell(f"once more in stretches of {longest:.0f} s, over which the fitted motion grows little", 0.05)
        criteria = replace(self.options.criteria, longest_record=longest)
        note = (
            f"in whole records the fitted motion grows and no name stands: fitted in stretches of up to {longest:.1f} s"
        )
        return replace(
            self,
            options=replace(self.options, criteria=criteria),
            notes_after=(*self.notes_after, note),
            stretched=True,
        )

    def _fitted(self, base: Model, loop: ClosedLoop | None = None) -> tuple[Setting, Baseline]:
        """What all rounds share and the first fit. loop: of controls that answer gusts, whose answers the flights lack."""
        options = self.options
        candidates = tuple(self.effects) if self.effects is not None else catalogue(model=base)
        candidates += missing_derivatives(base, {e.name for e in candidates})
        prepared = prepare_flights(base, candidates, self.training, self.holdout, options.criteria, loop is not None)
        notes = (*self.notes_before, *prepared.notes, *(loop.in_words() if loop else ()), *self.notes_after)
        prepared = replace(prepared, notes=notes, stale=self.stale)
        attitude_intervals, commanded = stamped_attitudes(base, self.given), rare_commands(base, self.training)
        level_std = levels(base, self.given)
        setting = _setting(prepared, candidates, level_std, attitude_intervals, commanded, options, self.tell, loop)
        self.tell("fitting the baseline", 0.05)
        return setting, fit_baseline(setting.working, setting.clean, setting.prepared, setting.scatter)


def run_gap(
    model: Model,
    training: Sequence[Flight],
    holdout: Sequence[Flight] = (),
    effects: Sequence[Effect] | None = None,
    options: Options = AS_USUAL,
    tell: ProgressCallback = lambda what, share: None,
) -> GapResult:
    """Find, name and add what `model` lacks on the training flights.

    holdout: flights that confirm effects and are in no fit. effects: candidates, by default the whole catalogue. tell: called
    with what is being done and the share of the run that is done.

    Raises MissingColumnError, DataError or GapError (one sentence each) where the flights cannot be used.
    """
    if not training:
        raise GapError("no training flight given; name at least one flight file before --holdout")
    refuse_twice(training, holdout)
    training, holdout = (
        [part for f in group for part in flown_apart(f, options.criteria)] for group in (training, holdout)
    )
    flights = [*training, *holdout]
    full_model = model
    model, comparison_notes = compared(full_model, flights)  # only in outputs that every flight measured
    tell("preparing the flights", 0.0)
    run = _Run.of(model, training, holdout, comparison_notes, effects, options, tell)
    doubts = [*broken_in_words(flights, full_model), *doubts_of(flights, model)]
    try:
        found = _find(run, model)
    except GapError as error:
        raise GapError("; ".join([str(error), *doubts[:1]])) from error
    tell("kinematic check", 0.9)
    measured = [as_measured(with_attitudes_between(f, options.criteria)) for f in found.run.sound]
    check = kinematic_check(measured, found.setting.effects, options.nulls, options.seed, options.criteria, model)
    tell("measuring what is closed", 0.95)
    answer = concluded(found.setting, found.search, check)
    if answer.verdict not in NAMED and (shorter := found.run.in_stretches(found.search.rounds[0].baseline)):
        try:
            again = _find(shorter, model)
            renewed = concluded(again.setting, again.search, check)
        except GapError:  # nothing is lost: the first answer stands
            renewed = answer
        settled = renewed.verdict in NAMED | {GapVerdict.NO_GAP}
        if settled or (answer.verdict, renewed.verdict) == (GapVerdict.CANNOT_TELL, GapVerdict.UNKNOWN):
            found, answer = again, renewed
    unmoved = unmoved_in_words(flights, model)
    remarks = (found.moved, late_commands(found.run.training, found.baseline), not_compared(full_model, model))
    # a control whose channel is dead may be the unknown effect itself, so that it stands first
    is_unknown = answer.verdict is GapVerdict.UNKNOWN
    sentences = [unmoved, answer.text, *remarks] if is_unknown else [answer.text, *remarks, unmoved]
    if answer.verdict in (GapVerdict.NO_GAP, GapVerdict.CANNOT_TELL):
        sentences.append(unconfirmed_in_words(answer.rejected))
    answer = replace(answer, text=" ".join(t for t in sentences if t))
    return _with_doubts(answer, [*doubts, *turned_signs(found.baseline)])


@dataclass(frozen=True)
class _Found:
    """A finished search. run: on whose flights; baseline: the first fit; moved: sentence on derivatives of a simulation that were
    freed before, may be empty."""

    run: _Run
    setting: Setting
    baseline: Baseline
    search: SearchState
    moved: str


def _find(run: _Run, model: Model) -> _Found:
    """The base fitted to the flights of a run, without wrong single values, and all rounds of the search. Raises GapError where
    the motion runs away."""
    try:
        setting, baseline = run.set_up(model)
    except GapError as error:
        model = _with_estimated_starts(model, run.training, error)
        setting, baseline = run.set_up(model)
    for _ in range(SPIKE_PASSES):
        if not (spikes := spikes_about(baseline)):
            break
        run = run.without_spikes(spikes)
        del baseline  # whose whiteners are large
        setting, baseline = run.set_up(model, setting.loop)
    moved, criteria = "", run.options.criteria
    off = derivatives_off(setting, baseline)
    if off and not explained_by_one(setting, baseline):
        # the one that stands out is for the search, which has to confirm it
        outlier = outstanding(setting, baseline, off) if setting.commanded else None
        others = tuple(n for n in off if n != outlier)
        freed = run.set_up(with_free_derivatives(model, others))
        if outlier or many(far_off(others, model.starts(), freed[1].fit, criteria), criteria):
            setting, baseline = freed
            if outlier:
                moved = others_freed_in_words(others)
            else:
                moved = moved_in_words(off, model.starts(), baseline, biased=bool(setting.commanded))
    setting, search = run.searched(setting, baseline)
    return _Found(run, setting, baseline, search, moved)


def _setting(
    prepared: FlightRecords,
    effects: tuple[Effect, ...],
    level_std: Mapping[str, float],
    attitude_intervals: Mapping[str, float],
    commanded: Mapping[str, float],
    options: Options,
    tell: ProgressCallback,
    loop: ClosedLoop | None = None,
) -> Setting:
    """What all rounds share: the base with nuisance parameters and all candidates dormant, and the errors of the inputs.

    level_std: signal reconstructed from the motion -> standard deviation of its level; attitude_intervals: attitude logged at
    times of its own -> interval [s]; commanded: as in `Setting`.
    """
    base, records = prepared.base, prepared.of(prepared.training)
    following = only_following(records, base, options.criteria)
    effects, excluded = without_hardware_of(effects, following)
    control_notes = [f"{prepared.names[k]}: {words_on(n)}" for n in following for k in prepared.training if excluded]
    white = channel_noise(records)
    scatter = bank_error(records, base.output_names, white, options.criteria)
    scatter = pitch_error(records, base.output_names, scatter, options.criteria)
    filtered = filtered_attitudes(records, base.output_names, white, options.criteria)
    noise = dict(zip(base.output_names, scatter, strict=True))
    levelled, interval = with_levels(base, level_std), sample_interval(records)
    clean = with_nuisance(levelled, noise, interval, options.criteria, filtered, attitude_intervals)
    if loop is not None:
        clean = loop.closed(clean)
        prepared = replace(prepared, records=tuple(loop.with_followed(r) for r in prepared.records))
    working = with_dormant(clean, effects, prepared.available, force_states(base))
    streams = (Stream.INPUT_ERRORS.generator(options.seed, i) for i in range(len(prepared.records)))
    errors = tuple(input_errors(r, clean, rng) for r, rng in zip(prepared.records, streams, strict=True))
    prepared = replace(
        prepared, records=with_errors(prepared.records, clean, errors), notes=(*prepared.notes, *control_notes)
    )
    return Setting(
        base, clean, working, prepared, effects, following, excluded, commanded, errors, scatter, options, tell, loop
    )


def _with_estimated_starts(model: Model, flights: Sequence[Flight], runs_away: GapError) -> Model:
    """A base that runs away from its start values, with those of an output-error fit instead.

    `fit_baseline` tries a regression by itself, but has none where a state is not measured. Raises `runs_away` where these
    flights cannot be estimated either.
    """
    try:
        estimate = output_error(model, flights)
    except EstimationError:
        raise runs_away from None
    starts = estimate.fitted_model.starts()
    return model.with_starts({n: starts[n] for n in model.free_names})


def _with_doubts(result: GapResult, doubts: Sequence[str]) -> GapResult:
    """The answer, beginning with the first doubt about the flights; all doubts are among the notes."""
    if not doubts:
        return result
    suffix = f" (and {len(doubts) - 1} more, in the notes)" if len(doubts) > 1 else ""
    first = f"{doubts[0]}{suffix}".removesuffix(".")
    text = f"Before any of this, look at the flights: {first}{'' if first.endswith('?') else '.'} {result.text}"
    return replace(result, text=text, notes=(*result.notes, *doubts))
