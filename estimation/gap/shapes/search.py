"""The search for a shape: screen, fit, predict flights left out, measure the closed share, look for a plain formula."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from estimation.errors import GapError
from estimation.gap.answer.result import Gap, Rejected
from estimation.gap.answer.shape import Follower, SwingingTerm
from estimation.gap.criteria import Criteria
from estimation.gap.fit.baseline import Baseline, fit_baseline
from estimation.gap.records.flight_records import FlightRecords
from estimation.gap.shapes.increment import (
    FittedIncrement,
    HoldoutPrediction,
    Increment,
    Plain,
    closed,
    fit_increment,
    floor_energy,
    holdout_energy,
    holdout_predictions,
    plain_formulas,
    predicts_every_flight,
    refitted_with,
)
from estimation.gap.shapes.lag_swing import find_memory, find_swing
from estimation.gap.shapes.places import ModelMotion, Place, Ranked, places_of, products_of, rank
from estimation.gap.significance.calibration import Round
from estimation.gap.significance.measure import Floors, gaps
from estimation.gap.significance.measured_again import NOT_ITS_OWN, MeasuredAgain
from estimation.gap.significance.nulls import InputErrors
from estimation.gap.significance.omnibus import examine

FITTED = 3  # leading places that get a fit


@dataclass(frozen=True)
class SearchTask:
    """The run as a search needs it. errors: of the inputs of every record; screened: gives nulls and screen of a fitted model;
    floors: gives the plain gap of these nulls."""

    prepared: FlightRecords
    errors: Sequence[InputErrors]
    seed: int
    screened: Callable[[Baseline], Round]
    floors: Callable[[Round], Floors]


@dataclass(frozen=True)
class Measured:
    """A model with an increment, fitted with its own noise, on its own nulls.

    gap, holdout: plain, before and after. before, after, floor: whitened energy on the held-out flights, where there are any.
    highest: upper end of the plain gap there with nothing hidden.
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
        """Closed share of the whitened energy above the floor."""
        return closed(self.before, self.after, self.floor)

    @property
    def closed(self) -> float:
        """Closed share of the gap above that of nulls, by the plain gap or by whitened energy, whichever is larger: the plain gap
        also counts the gusts of the day, whitened energy every small error of the base."""
        gap = self.holdout or self.gap
        return max(self.energy_closed, closed(gap.before**2, gap.after**2, self.highest**2))

    def by(self, plain: Plain) -> float:
        """Closed share of the whitened energy with a formula in place of the increment."""
        problem, model_fit = refitted_with(plain.problem, plain.fit, self.child)
        if model_fit.diverged:
            return 0.0
        return closed(self.before, holdout_energy(problem, model_fit, self.child, self.child.noise), self.floor)


@dataclass(frozen=True)
class CoefficientShape:
    """A part of a coefficient that closes the gap. predictions: of every training flight left out. rivals: other places that gain
    nearly as much on the training flights. plain, refused: formulas that close as much, and the others, with their closed share.
    score, threshold: of the place by linear theory."""

    fitted: FittedIncrement
    measured: Measured
    predictions: Sequence[HoldoutPrediction]
    rivals: Sequence[FittedIncrement]
    plain: Sequence[tuple[Plain, float]]
    refused: Sequence[tuple[Plain, float]]
    score: float
    threshold: float


@dataclass(frozen=True)
class ShapeSearch:
    """The shape, if any, and places that were fitted and are none; follower: a lag or a swing that gains where there is no
    shape."""

    shape: CoefficientShape | None
    rejected: tuple[Rejected, ...]
    follower: Follower | None = None

    @property
    def found(self) -> bool:
        """Whether there is a shape, a lag or a swing."""
        return self.shape is not None or self.follower is not None


def find_shape(round_: Round, task: SearchTask, at_length: bool) -> ShapeSearch:
    """A function of one variable, or a swing. at_length: also a function of two variables, and a lag where no function closes the
    gap."""
    baseline = round_.baseline
    motion = ModelMotion.of(baseline.problem, baseline.fit)
    base = task.prepared.base
    singles = places_of(base)
    ranking = rank(motion, round_, singles)
    swing = find_swing(motion, round_)
    minimum = swing.gain if swing is not None else 0.0
    shape, rejected = _best(round_, task, motion, ranking, minimum)
    if shape is not None:
        return ShapeSearch(shape, tuple(rejected))
    if not at_length:
        stands_alone = swing is not None and alone(swing, round_.criteria)
        return ShapeSearch(None, tuple(rejected), swing if stands_alone else None)
    if ranking.order:
        line = ranking.places[ranking.order[0]].line
        products = [p for p in products_of(base) if p.line == line]
        shape, rejected_products = _best(round_, task, motion, rank(motion, round_, products), minimum)
        rejected += rejected_products
    memory = find_memory(motion, round_, singles) if shape is None else None
    followers = [f for f in (memory, swing) if f is not None and shape is None]
    return ShapeSearch(shape, tuple(rejected), max(followers, key=lambda f: f.gain, default=None))


def alone(swing: SwingingTerm, criteria: Criteria) -> bool:
    """Whether a swing is an unknown effect by itself, as a nameless term is: against the nulls, and against plain chance, because
    one among many that hardly gain on the nulls need not gain much."""
    return swing.gain > criteria.certain**2 and swing.score > criteria.clearly_above * swing.threshold


def _best(
    round_: Round, task: SearchTask, motion: ModelMotion, ranking: Ranked[Place], least: float
) -> tuple[CoefficientShape | None, list[Rejected]]:
    """The first of the leading places that holds on flights left out and closes the gap, and the places that failed. least: gain
    of another nameless candidate, to compare with like that of a nameless term."""
    baseline, criteria = round_.baseline, round_.criteria
    fits: dict[int, FittedIncrement] = {}
    rejected: list[Rejected] = []
    for i in ranking.order[:FITTED]:
        fitted = fit_increment(baseline, Increment.of(ranking.places[i], motion))
        if fitted is None:
            rejected.append(_rejected(ranking.places[i], "the fit runs away"))
        else:
            fits[i] = fitted
    term = max(best_term(round_), least) if fits else 0.0
    remeasured = MeasuredAgain(baseline, task.seed)
    for i in sorted(fits, key=lambda k: -fits[k].gain):
        fitted, score = fits[i], float(ranking.scores[i])
        predictions: list[HoldoutPrediction] = []
        measured: Measured | None = None
        if fitted.gain < criteria.named_share * term:
            reason = f"explains only {fitted.gain / term:.0%} of what a nameless term or swing does"
        elif score * math.sqrt(remeasured.share(fitted.gain, fitted.fit)) < ranking.threshold:
            reason = NOT_ITS_OWN
        elif not predicts_every_flight(predictions := holdout_predictions(baseline, fitted, motion), criteria):
            reason = "does not predict every training flight better than the base where that is left out"
        elif (measured := _measured(task, baseline, fitted)) is None:
            reason = "the model with it runs away"
        elif measured.closed < criteria.closed_share:
            reason = f"closes only {measured.closed:.0%} of the gap"
        else:
            rivals = runners_up(fitted, [f for k, f in fits.items() if k != i], criteria)
            formulas = [(p, measured.by(p)) for p in plain_formulas(baseline, fitted, motion)]
            accepted, refused = as_good(formulas, measured.energy_closed, criteria)
            shape = CoefficientShape(fitted, measured, predictions, rivals, accepted, refused, score, ranking.threshold)
            return shape, rejected
        rejected.append(_rejected(ranking.places[i], reason))
    return None, rejected


def _rejected(place: Place, reason: str) -> Rejected:
    return Rejected(place.words, f"as a shape without a name: {reason}")


def best_term(round_: Round) -> float:
    """Gain of the best nameless term in an output or a force equation (twice a log-likelihood). Where a shape gains clearly less,
    it is not the cause: an error of an instrument is no coefficient."""
    return max((s.gain for s in examine(round_).leading if s.kind == "term"), default=0.0)


def runners_up(best: FittedIncrement, others: Sequence[FittedIncrement], criteria: Criteria) -> list[FittedIncrement]:
    """Other places that gain nearly as much, most first."""
    rivals = [f for f in others if f.gain >= criteria.named_share * best.gain]
    return sorted(rivals, key=lambda f: -f.gain)


def as_good(
    plain: Sequence[tuple[Plain, float]], closed: float, criteria: Criteria
) -> tuple[list[tuple[Plain, float]], list[tuple[Plain, float]]]:
    """Formulas that close nearly as much as the spline or more, best first; and the others."""
    ordered = sorted(plain, key=lambda p: (-p[1], -p[0].gain))
    equal = [p for p in ordered if p[1] >= closed - (1.0 - criteria.shape_share)]
    return equal, [p for p in ordered if p not in equal]


def _measured(task: SearchTask, baseline: Baseline, fitted: FittedIncrement) -> Measured | None:
    """The model with an increment; None where it runs away, in the fit, on a null or on a held-out flight."""
    try:
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
    except GapError:
        return None
