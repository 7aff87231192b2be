"""State of the search: what its rounds share (options, the setting) and what they leave (findings, the rest)."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from estimation.engine.kernel import Array
from estimation.gap.answer.result import Rejected
from estimation.gap.criteria import AS_SET, Criteria
from estimation.gap.effects.base import Effect
from estimation.gap.fit.baseline import Baseline, fit_afresh, fit_baseline
from estimation.gap.random_streams import ROUND
from estimation.gap.records.candidate_model import awakened
from estimation.gap.records.flight_records import FlightRecords
from estimation.gap.search.confirm import FittedHypothesis
from estimation.gap.search.select import Choice
from estimation.gap.significance.calibration import Round, screen_round
from estimation.gap.significance.nulls import InputErrors
from estimation.gap.significance.omnibus import Omnibus
from estimation.models.base import Model

LOOK = Callable[[str, float], None]


@dataclass(frozen=True)
class Options:
    """seed: of every random draw. nulls: simulated baselines per round. most: effects added at the most. criteria: every
    number that decides."""

    seed: int = 1
    nulls: int = 200
    most: int = 4
    criteria: Criteria = AS_SET


AS_USUAL = Options()


@dataclass(frozen=True)
class AcceptedEffect:
    """An effect accepted in some round: the hypothesis, its rivals, the model before and after. doubted: whether a shape
    without a name explains clearly more."""

    round_: Round
    choice: Choice
    candidate: FittedHypothesis
    parent: Baseline
    child: Baseline
    doubted: bool = False


@dataclass(frozen=True)
class SearchState:
    """All that the rounds left. omnibus: what is still there without a name; rejected: hypotheses that were turned down."""

    findings: tuple[AcceptedEffect, ...]
    rounds: tuple[Round, ...]
    omnibus: Omnibus
    rejected: tuple[Rejected, ...]


@dataclass(frozen=True)
class Setting:
    """What stays the same over all rounds. following: controls that only follow the motion; untold: effects not asked for that
    reason. commanded: controls of which a log has commands -> their interval [s], as of `rare_commands`."""

    base: Model
    clean: Model
    working: Model
    prepared: FlightRecords
    effects: tuple[Effect, ...]
    following: tuple[str, ...]
    untold: tuple[Effect, ...]
    commanded: Mapping[str, float]
    errors: tuple[InputErrors, ...]
    scatter: Array
    options: Options
    tell: LOOK

    @property
    def steered(self) -> bool:
        """Whether every control of the base only follows the motion: gusts that a hand answers look like terms of the model then,
        and nothing that is left without a name can be believed."""
        controls = {s.name for s in self.base.inputs if s.control}
        return bool(controls) and controls <= set(self.following)

    def child(self, parent: Baseline, candidate: FittedHypothesis) -> Baseline:
        """The parent with a candidate's form, fitted afresh with its own noise."""
        values = {n: v for n, (v, _) in candidate.estimates.items()}
        clean = candidate.hypothesis.form.added_to(parent.clean, values)
        noise, has_noise = candidate.noise or parent.noise, candidate.noise is not None
        return fit_baseline(candidate.fit.model, clean, self.prepared, self.scatter, candidate.fit, noise, has_noise)

    def screened(self, baseline: Baseline, number: int) -> Round:
        """One round of nulls and screen about a fitted model."""
        start = 0.1 + 0.8 * number / (self.options.most + 1)

        def tick(done: int) -> None:
            if done % 10 == 0:
                self.tell(
                    f"round {number + 1}: null {done} of {self.options.nulls}", start + 0.1 * done / self.options.nulls
                )

        seed = self.options.seed + ROUND * number
        return screen_round(
            baseline,
            self.prepared,
            self.effects,
            self.errors,
            self.options.nulls,
            seed,
            tick,
        )


def afresh_with(setting: Setting, findings: Sequence[AcceptedEffect], child: Baseline) -> Baseline | None:
    """The working model with the effects of some findings, fitted afresh with the noise of `child`, which has more in it; None
    where the motion runs away without that."""
    model, clean = setting.working, setting.clean
    for f in findings:
        values = {n: v for n, (v, _) in f.candidate.estimates.items()}
        form = f.candidate.hypothesis.form
        model, clean = awakened(model, form, values), form.added_to(clean, values)
    return fit_afresh(child, model, clean)
