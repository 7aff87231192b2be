"""What the rounds of the workflow share and what they leave: options, the setting, findings, the trail."""

from collections.abc import Callable
from dataclasses import dataclass

from estimation.engine.kernel import Array
from estimation.gap.baseline import Baseline, Round, fit_baseline, screen_round
from estimation.gap.bench import Bench
from estimation.gap.confirm import Candidate
from estimation.gap.effects.base import Effect
from estimation.gap.nulls import InputErrors
from estimation.gap.omnibus import Omnibus
from estimation.gap.result import Rejected
from estimation.gap.select import Choice
from estimation.models.base import Model

LOOK = Callable[[str, float], None]


@dataclass(frozen=True)
class Options:
    """seed: of every random draw. nulls: simulated baselines per round. most: effects added at the most."""

    seed: int = 1
    nulls: int = 200
    most: int = 4
    level: float = 0.975


AS_USUAL = Options()


@dataclass(frozen=True)
class Finding:
    """An effect accepted in some round: the hypothesis, its rivals, the model before and after."""

    round_: Round
    choice: Choice
    candidate: Candidate
    parent: Baseline
    child: Baseline


@dataclass(frozen=True)
class Trail:
    """All that the rounds left. unknown: what is still there, nameless; stopped: why no more was added."""

    findings: tuple[Finding, ...]
    rounds: tuple[Round, ...]
    omnibus: Omnibus
    unknown: bool
    rejected: tuple[Rejected, ...]


@dataclass(frozen=True)
class Setting:
    """What stays the same over all rounds."""

    base: Model
    clean: Model
    working: Model
    bench: Bench
    effects: tuple[Effect, ...]
    errors: tuple[InputErrors, ...]
    scatter: Array
    options: Options
    tell: LOOK

    def child(self, parent: Baseline, candidate: Candidate) -> Baseline:
        """The parent with a candidate's form, fitted afresh with its own noise."""
        at = {n: v for n, (v, _) in candidate.estimates.items()}
        clean = candidate.hypothesis.form.added_to(parent.clean, at)
        return fit_baseline(
            candidate.fit.model,
            clean,
            self.bench,
            self.scatter,
            candidate.fit.values,
            candidate.fit.locals,
            parent.noise,
        )

    def screened(self, baseline: Baseline, number: int) -> Round:
        """One round of nulls and screen about a fitted model."""
        start = 0.1 + 0.8 * number / (self.options.most + 1)

        def tick(done: int) -> None:
            if done % 10 == 0:
                self.tell(
                    f"round {number + 1}: null {done} of {self.options.nulls}", start + 0.1 * done / self.options.nulls
                )

        seed = self.options.seed + 1000 * number
        return screen_round(
            baseline, self.bench, self.effects, self.errors, self.options.nulls, seed, self.options.level, tick
        )
