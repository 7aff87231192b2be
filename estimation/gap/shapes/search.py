"""The search for a shape: screen, fit, ask the flights left out, measure what is closed, look for a plain formula."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from estimation.gap.answer.result import Gap
from estimation.gap.answer.shape import LaggedTerm, SwingingTerm
from estimation.gap.criteria import Criteria
from estimation.gap.errors import GapError
from estimation.gap.fit.baseline import Baseline, fit_baseline
from estimation.gap.records.flight_records import FlightRecords
from estimation.gap.shapes.formulas import Plain, plain_formulas
from estimation.gap.shapes.increment import (
    FittedIncrement,
    HoldoutPrediction,
    Increment,
    closed,
    fit_increment,
    floor_energy,
    holdout_energy,
    holdout_predictions,
    predicts_every_flight,
    refitted_with,
)
from estimation.gap.shapes.lag_swing import find_memory, find_swing
from estimation.gap.shapes.places import ModelMotion, Place, Ranked, places_of, products_of, rank
from estimation.gap.significance.calibration import Round
from estimation.gap.significance.measure import Floors, gaps
from estimation.gap.significance.measured_again import MeasuredAgain
from estimation.gap.significance.nulls import InputErrors
from estimation.gap.significance.omnibus import examine

FITTED = 3  # places that get a fit


@dataclass(frozen=True)
class SearchTask:
    """What a search needs of the run. errors: of the inputs of every record; screened: nulls and screen about a fitted model;
    floors: what the plain gap measures on them."""

    prepared: FlightRecords
    errors: Sequence[InputErrors]
    seed: int
    screened: Callable[[Baseline], Round]
    floors: Callable[[Round], Floors]


@dataclass(frozen=True)
class Tried:
    """A place that was fitted and why it was not taken."""

    place: Place
    gain: float
    why: str


@dataclass(frozen=True)
class Measured:
    """A model with an increment, fitted with its own noise, on its own nulls.

    gap, holdout: plain, before and after. before, after, floor: whitened energy on the held-out flights, where there are any.
    highest: plain gap there that nothing hidden would leave.
    """

    child: Baseline
    round_: Round
    gap: Gap
    holdout: Gap | None
    before: float
    after: float
    floor: float
    highest: float

    @property
    def energy_closed(self) -> float:
        """Share of the whitened energy above the floor that is gone."""
        return closed(self.before, self.after, self.floor)

    @property
    def closed(self) -> float:
        """Share of the gap that is gone, of what nothing hidden would leave; by the plain gap or by whitened energy, whichever
        sees it better: the one counts the gusts of the day, the other every small error of the base."""
        gap = self.holdout or self.gap
        return max(self.energy_closed, closed(gap.before**2, gap.after**2, self.highest**2))

    def by(self, plain: Plain, task: SearchTask) -> float:
        """The same for a formula in place of the increment."""
        problem, model_fit = refitted_with(plain.problem, plain.fit, self.child)
        if model_fit.diverged:
            return 0.0
        return closed(self.before, holdout_energy(problem, model_fit, self.child, self.child.noise), self.floor)


@dataclass(frozen=True)
class CoefficientShape:
    """A part of a coefficient that closes the gap. others: every training flight left out. rivals: other places that do nearly as
    well on the training flights. plain, refused: formulas that close no less than it does, and the others, with what they close.
    score, threshold: of the place by linear theory."""

    fitted: FittedIncrement
    measured: Measured
    others: tuple[HoldoutPrediction, ...]
    rivals: tuple[FittedIncrement, ...]
    plain: tuple[tuple[Plain, float], ...]
    refused: tuple[tuple[Plain, float], ...]
    score: float
    threshold: float


@dataclass(frozen=True)
class ShapeSearch:
    """What was found, what was tried; follower: a lag or a swing that gains where no shape was found."""

    shape: CoefficientShape | None
    tried: tuple[Tried, ...]
    follower: LaggedTerm | SwingingTerm | None = None


def find_shape(round_: Round, task: SearchTask, at_length: bool) -> ShapeSearch:
    """A function of one variable, or something that swings; at length also a function of two, and, where none closes the gap,
    whether a memory gains."""
    baseline = round_.baseline
    motion = ModelMotion.of(baseline.problem, baseline.fit)
    singles = places_of(task.prepared.base)
    ranking = rank(motion, round_, singles)
    swing = find_swing(motion, round_)
    minimum = swing.gain if swing is not None else 0.0
    shape, attempts = _best(round_, task, motion, ranking, minimum)
    if shape is not None:
        return ShapeSearch(shape, tuple(attempts))
    if not at_length:  # nothing else stands out
        stands_alone = swing is not None and alone(swing, round_.criteria)
        return ShapeSearch(None, tuple(attempts), swing if stands_alone else None)
    if ranking.order:
        line = ranking.places[ranking.order[0]].line
        products = [p for p in products_of(task.prepared.base) if p.line == line]
        shape, product_attempts = _best(round_, task, motion, rank(motion, round_, products), minimum)
        attempts += product_attempts
    memory = find_memory(motion, round_, singles) if shape is None else None
    followers = [f for f in (memory, swing) if f is not None and shape is None]
    return ShapeSearch(shape, tuple(attempts), max(followers, key=lambda f: f.gain, default=None))


def alone(swing: SwingingTerm, criteria: Criteria) -> bool:
    """Whether a swing is an unknown effect by itself, as a nameless term is."""
    return swing.score > criteria.strong * swing.threshold


def _best(
    round_: Round, task: SearchTask, flown: ModelMotion, ranking: Ranked[Place], least: float = 0.0
) -> tuple[CoefficientShape | None, list[Tried]]:
    """The first of the leading places that holds on flights left out and closes the gap. least: what something else without a
    name gains, as a nameless term does."""
    baseline, criteria = round_.baseline, round_.criteria
    fits: dict[int, FittedIncrement] = {}
    attempts: list[Tried] = []
    for i in ranking.order[:FITTED]:
        fitted = fit_increment(baseline, Increment.of(ranking.places[i], flown))
        if fitted is None:
            attempts.append(Tried(ranking.places[i], float(ranking.gains[i]), "the fit runs away"))
        else:
            fits[i] = fitted
    term = max(best_term(round_), least) if fits else 0.0
    remeasured = MeasuredAgain(baseline, task.seed)
    for i in sorted(fits, key=lambda k: -fits[k].gain):
        fitted = fits[i]
        if fitted.gain < criteria.named_share * term:
            reason = f"explains only {fitted.gain / term:.0%} of what a nameless term or swing does"
            attempts.append(Tried(ranking.places[i], fitted.gain, reason))
            continue
        if float(ranking.scores[i]) * math.sqrt(remeasured.share(fitted.gain, fitted.fit)) < ranking.threshold:
            reason = "gains nearly as much where only the controls are measured again"
            attempts.append(Tried(ranking.places[i], fitted.gain, reason))
            continue
        predictions = holdout_predictions(baseline, fitted, flown)
        if not predicts_every_flight(predictions, criteria):
            reason = "does not predict every training flight better than the base where that is left out"
            attempts.append(Tried(ranking.places[i], fitted.gain, reason))
            continue
        measured = _measured(task, baseline, fitted)
        if measured is None:
            attempts.append(Tried(ranking.places[i], fitted.gain, "the model with it runs away"))
            continue
        if measured.closed < criteria.closed_share:
            attempts.append(Tried(ranking.places[i], fitted.gain, f"closes only {measured.closed:.0%} of the gap"))
            continue
        rivals = runners_up(fitted, [f for k, f in fits.items() if k != i], criteria)
        formulas = [(p, measured.by(p, task)) for p in plain_formulas(baseline, fitted, flown)]
        accepted, rejected = as_good(formulas, measured.energy_closed, criteria)
        score = float(ranking.scores[i])
        shape = CoefficientShape(
            fitted,
            measured,
            tuple(predictions),
            tuple(rivals),
            tuple(accepted),
            tuple(rejected),
            score,
            ranking.threshold,
        )
        return shape, attempts
    return None, attempts


def best_term(round_: Round) -> float:
    """What the best nameless term in an output or a force equation gains (twice a log-likelihood). Where that is clearly more
    than a shape does, the shape is not what is wrong: an instrument that adds what it should not is no coefficient."""
    return max((s.gain for s in examine(round_).leading if s.kind == "term"), default=0.0)


def runners_up(best: FittedIncrement, others: Sequence[FittedIncrement], criteria: Criteria) -> list[FittedIncrement]:
    """Other places that gain nearly as much, most first."""
    rivals = [f for f in others if f.gain >= criteria.named_share * best.gain]
    return sorted(rivals, key=lambda f: -f.gain)


def as_good(
    plain: Sequence[tuple[Plain, float]], closed: float, criteria: Criteria
) -> tuple[list[tuple[Plain, float]], list[tuple[Plain, float]]]:
    """Formulas that close no less than the spline does, but for a little, best first; and the others."""
    ordered = sorted(plain, key=lambda p: (-p[1], -p[0].gain))
    equal = [p for p in ordered if p[1] >= closed - (1.0 - criteria.shape_share)]
    return equal, [p for p in ordered if p not in equal]


def _measured(task: SearchTask, baseline: Baseline, fitted: FittedIncrement) -> Measured | None:
    """None where the model with the increment runs away, in the fit, on a null or on a held-out flight."""
    try:
        return _measure(task, baseline, fitted)
    except GapError:
        return None


def _measure(task: SearchTask, baseline: Baseline, fitted: FittedIncrement) -> Measured | None:
    child = fit_baseline(
        fitted.problem.model, baseline.clean, task.prepared, baseline.scatter, fitted.fit, baseline.noise
    )
    child_round = task.screened(child)
    reweighted = refitted_with(baseline.problem, baseline.fit, child)
    if reweighted[1].diverged:
        return None
    floor = task.floors(child_round)
    return Measured(
        child,
        child_round,
        *gaps(baseline, child, floor),
        holdout_energy(*reweighted, baseline, child.noise),
        holdout_energy(child.problem, child.fit, child, child.noise),
        floor_energy(child, task.errors, task.seed),
        floor.highest,
    )
