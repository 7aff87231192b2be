"""What the rounds of the search share (options, setting) and what they result in (findings, remainder)."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from estimation.engine.kernel import Array
from estimation.gap.answer.result import Rejected
from estimation.gap.criteria import AS_SET, Criteria
from estimation.gap.effects.base import Effect
from estimation.gap.fit.baseline import Baseline, fit_afresh, fit_baseline
from estimation.gap.fit.closed_loop import ClosedLoop
from estimation.gap.records.candidate_model import awakened
from estimation.gap.records.flight_records import FlightRecords
from estimation.gap.search.confirm import FittedHypothesis
from estimation.gap.search.select import Choice
from estimation.gap.significance.calibration import Round, screen_round
from estimation.gap.significance.measure import Floors, floors
from estimation.gap.significance.nulls import ROUND, InputErrors
from estimation.gap.significance.omnibus import Omnibus, examine
from estimation.models.base import Model

ProgressCallback = Callable[[str, float], None]
"""Called with what is being done and the share of the run that is done, 0 to 1."""


@dataclass(frozen=True)
class Options:
    """seed: of every random draw. nulls: sets of flights simulated without an effect, per round. most: effects added at most.
    criteria: every number that decides."""

    seed: int = 1
    nulls: int = 200
    most: int = 4
    criteria: Criteria = AS_SET

    def progress(self, rounds: int) -> float:
        """Share of the run that is done after so many rounds; preparation takes the first tenth, the conclusion the last."""
        return 0.1 + 0.8 * rounds / (self.most + 1)


AS_USUAL = Options()


@dataclass(frozen=True)
class AcceptedEffect:
    """An effect accepted in some round: the fitted hypothesis (candidate), its rivals (choice), the model before (parent) and
    after (child). doubted: whether a nameless shape explains clearly more."""

    round_: Round
    choice: Choice
    candidate: FittedHypothesis
    parent: Baseline
    child: Baseline
    doubted: bool = False


@dataclass(frozen=True)
class SearchState:
    """The result of all rounds. omnibus: test of the last residuals for anything without a name; rejected: hypotheses that were
    turned down."""

    findings: tuple[AcceptedEffect, ...]
    rounds: tuple[Round, ...]
    omnibus: Omnibus
    rejected: tuple[Rejected, ...]

    @property
    def with_enough_nulls(self) -> "SearchState":
        """The same with enough nulls in its last round."""
        last = self.rounds[-1].with_enough_nulls
        return replace(self, rounds=(*self.rounds[:-1], last), omnibus=examine(last))


@dataclass(frozen=True)
class Setting:
    """What stays the same over all rounds.

    base: the model as given. clean: the base with the nuisance parameters of every fit. working: `clean` with all effects
    dormant, which is what is fitted. following: controls that only follow the motion; excluded_effects: not tested for that
    reason. commanded: controls known from logged commands -> interval of the commands [s], from `rare_commands`. errors: per
    record, errors of its inputs. scatter: (ny,) standard deviations of the outputs' white noise. tell: reports progress. loop:
    closed by controls that answer gusts; loop_left_open: not closed, for an effect explains what they answer.
    """

    base: Model
    clean: Model
    working: Model
    prepared: FlightRecords
    effects: tuple[Effect, ...]
    following: tuple[str, ...]
    excluded_effects: tuple[Effect, ...]
    commanded: Mapping[str, float]
    errors: tuple[InputErrors, ...]
    scatter: Array
    options: Options
    tell: ProgressCallback
    loop: ClosedLoop | None = None
    loop_left_open: ClosedLoop | None = None

    @property
    def steered(self) -> bool:
        """Whether every control of the base only follows the motion. Then gusts that the pilot answers look like terms of the
        model, and a remainder without a name cannot be believed."""
        controls = {s.name for s in self.base.inputs if s.control}
        return bool(controls) and controls <= set(self.following)

    def child(self, parent: Baseline, candidate: FittedHypothesis) -> Baseline:
        """The parent with a candidate's form added, fitted with its noise estimated anew."""
        clean = candidate.hypothesis.form.added_to(parent.clean, candidate.values)
        noise, is_known = candidate.noise or parent.noise, candidate.noise is not None
        return fit_baseline(candidate.fit.model, clean, self.prepared, self.scatter, candidate.fit, noise, is_known)

    def screened(self, baseline: Baseline, number: int) -> Round:
        """Round `number`, counted from 0: nulls and screen about a fitted model. Raises GapError where its nulls run away."""
        return self.first_screened(baseline, number).with_enough_nulls

    def first_screened(self, baseline: Baseline, number: int) -> Round:
        """The same with the first nulls only, which may not be enough to decide."""
        nulls = self.options.nulls

        def tick(done: int) -> None:
            if done % 10 == 0:
                share = self.options.progress(number) + 0.1 * done / nulls
                self.tell(f"round {number + 1}: null {done} of {nulls}", share)

        seed = self.options.seed + ROUND * number
        return screen_round(baseline, self.prepared, self.effects, self.errors, nulls, seed, tick)

    def floors(self, round_: Round) -> Floors:
        """The gap on the nulls of a round, training and held-out flights."""
        holdout_errors = self.errors[len(self.prepared.of(self.prepared.training)) :]
        return floors(round_, round_.baseline.held_out, holdout_errors, self.options.seed)


def afresh_with(setting: Setting, findings: Sequence[AcceptedEffect], child: Baseline) -> Baseline | None:
    """The working model with the effects of `findings` alone, fitted with the noise of `child`, which has more effects.

    None where the motion runs away without these.
    """
    model, clean = setting.working, setting.clean
    for f in findings:
        form, values = f.candidate.hypothesis.form, f.candidate.values
        model, clean = awakened(model, form, values), form.added_to(clean, values)
    return fit_afresh(child, model, clean)
