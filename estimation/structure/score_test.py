"""Which of the things that a model may lack the residuals ask for, and what leaving them out does to the estimates.

The score of one candidate is what the residuals have in common with its effect once all parameters have taken what they can,
over its standard deviation from the outputs' noise and the inputs' errors: of unit variance where nothing is lacking (C. R.
Rao, 1948; V. Klein and E. A. Morelli, Aircraft System Identification, 2nd ed., section 5.4, does the same for regressions).
Candidates that are significant are taken one after the other, the strongest first, until none is left; what would have served
as well is its rival.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.estimators.normal_equations import pseudo_inverse
from estimation.estimators.result import Result, finite_or_none
from estimation.structure.candidates import Candidate, CandidateKind
from estimation.structure.linearised import LinearisedFit

Array = NDArray[np.float64]

THRESHOLD = 5.0
"""Score from which a candidate is significant. In ten joint fits of plain, noisy, thin and gusty flights of random aeroplanes
the largest of 25 scores was 1.4 to 3.4, with edges on the sampling clock 3.2 and 4.7; what was hidden scored 9 to 140
(docs/validation.md)."""
RIVAL = 0.85
"""Share of the strongest score from which another candidate would serve as well, if it is no more needed once that is in."""
TIED = 0.97
"""Share of the strongest score within which the likelier cause is taken: a derivative before a product of inertia, before an
instrument."""
MOST = 4  # candidates taken one after the other: a model that lacks more is another model
ADVERSE = 0.25
"""Of the roll by aileron, the largest yaw by aileron (Roskam, Airplane Flight Dynamics I, 4.1: -5 to -15 %; spoilers the same
the other way): more is a product of inertia that is not what the file says."""
FACTORS = {"alpha": (0.5, 2.0), "beta": (0.5, 2.0)}
"""Scales that a vane in the upwash of an airframe can have (Gracey, NASA RP-1046: 1.1 to 1.8 ahead of a fuselage)."""
FACTORS_ELSE = (0.75, 1.33)  # of any other channel: a calibration, not another instrument
LONGEST_LAG = 0.5  # s either way: vanes, servos and telemetry lag by 0.02 to 0.2
FARTHEST = 0.75  # of the span, from the CG: a nose boom of a slender aeroplane
STEEP, MOST_FORCE, MOST_MOMENT = 0.35, 5.0, 1.0
"""What a nonlinear term may make of a force and of a moment coefficient at an angle of 20 deg [rad]: more than all wings do."""
NOTABLE = 1.0  # bounds by which a printed value has to move
BORNE = 3.0
"""Bounds up to which what leaving something out moves is counted in the bounds instead of forbidding a recommendation: its
size is known to a fifth there (a score of 5), so the wider bound holds the truth; beyond, the model is another one and its
estimates are not to be believed."""

MOMENTS = ("Cl", "Cm", "Cn")

LIKELIEST_FIRST = (
    CandidateKind.LINEAR, CandidateKind.LATE_CONTROL, CandidateKind.SCALE, CandidateKind.LATE_SENSOR, CandidateKind.INERTIA,
    CandidateKind.NONLINEAR, CandidateKind.DAMPER, CandidateKind.PLACE,
)  # fmt: skip


@dataclass(frozen=True)
class Tested:
    """One candidate. score: signed, in standard deviations; value: what it would be; moves: parameter -> by how many of its
    corrected bounds the estimate is moved by leaving it out."""

    candidate: Candidate
    score: float
    value: float
    moves: Mapping[str, float]
    threshold: float = THRESHOLD

    @property
    def significant(self) -> bool:
        """Whether the residuals ask for it, and it is no less than what the model itself can be off."""
        return abs(self.score) > self.threshold and abs(self.value - self.candidate.null) > self.candidate.least

    @property
    def worst(self) -> tuple[str, float]:
        """The parameter that leaving it out moves most, and by how many bounds."""
        return max(self.moves.items(), key=lambda item: item[1], default=("", 0.0))

    def to_json(self) -> dict[str, Any]:
        """An entry of `structure.tested` in `estimate --json`."""
        notable = {n: round(m, 2) for n, m in sorted(self.moves.items(), key=lambda i: -i[1]) if m >= NOTABLE}
        return {
            "term": self.candidate.name,
            "score": finite_or_none(round(self.score, 3)),
            "threshold": self.threshold,
            "significant": self.significant,
            "value": finite_or_none(self.value),
            "moves": notable,
        }


@dataclass(frozen=True)
class Lack:
    """Something the model lacks, and what would serve as well. differs: parameter -> by how much its estimate
    differs with a rival in its place; apart: the most of that in bounds. holdout: twice the log likelihood that it gains on each
    flight when fitted to all the others, summed; None with one flight. possible: whether the leading one can have that size."""

    leading: Tested
    rivals: tuple[Tested, ...] = ()
    differs: Mapping[str, float] = field(default_factory=dict)
    apart: float = 0.0
    holdout: float | None = None
    possible: bool = True

    @property
    def holds(self) -> bool:
        """Whether flights that it was not fitted to confirm it, as far as there are any."""
        return self.holdout is None or self.holdout > 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """Of the leading candidate and its rivals."""
        return (self.leading.candidate.name, *(r.candidate.name for r in self.rivals))

    def matters(self, bounds: float) -> bool:
        """Whether leaving it out moves a printed value by more than so many of its bounds."""
        return any(t.worst[1] > bounds for t in (self.leading, *self.rivals))


@dataclass(frozen=True)
class StructureTest:
    """What was tested beside a fit. added: candidates that have been put into the model; ambiguous: of these, those that a
    rival outside the model explains as well, though it gives other values. follows: filter method -> why its process noise is
    no gusts."""

    tested: tuple[Tested, ...]
    lacks: tuple[Lack, ...]
    added: tuple[str, ...] = ()
    ambiguous: tuple[Lack, ...] = ()
    why_not: str = ""
    follows: Mapping[str, str] = field(default_factory=dict)

    @property
    def bears(self) -> float:
        """Bounds by which what is left out may move a value: BORNE once that has been added which the model lacked most, and
        before that, where a better model is to be had, NOTABLE."""
        return BORNE if self.added else NOTABLE

    def with_added(self, names: Sequence[str], ambiguous: Sequence[Lack]) -> "StructureTest":
        """The same with what had been put into the model before."""
        return replace(self, added=tuple(names), ambiguous=tuple(ambiguous))

    def to_json(self) -> dict[str, Any]:
        """As `structure` in `estimate --json`."""
        tested = [t.to_json() for t in sorted(self.tested, key=lambda t: -abs(t.score))]
        data: dict[str, Any] = {"tested": tested, "added": list(self.added)}
        return {**data, "why_not": self.why_not} if self.why_not else data


def structure_of(linear: LinearisedFit, result: Result, *, filtered: bool = False) -> StructureTest:
    """Test every candidate, and take the significant ones one after the other.

    result: whose bounds the moves are counted in. filtered: its estimates weigh residuals as a filter does, not as output
    error does.
    """
    first = _scores(linear, (), result, filtered)
    taken_up: list[int] = []
    lacks: list[Lack] = []
    scores = first
    while len(taken_up) < MOST:
        strongest = _strongest(scores, taken_up, result)
        if strongest is None:
            break
        next_scores = _scores(linear, (*taken_up, strongest), result, filtered)
        rivals = _rivals(scores, next_scores, taken_up, strongest, result)
        if (derivative := derivative_instead(scores, strongest, rivals, result)) is not None:
            strongest = derivative
            next_scores = _scores(linear, (*taken_up, strongest), result, filtered)
            rivals = _rivals(scores, next_scores, taken_up, strongest, result)
        differs = _differences(linear, strongest, rivals, scores)
        apart = max(
            (d / result.parameters[n].std_coloured for n, d in differs.items() if _has_bound(result, n)), default=0.0
        )
        holdout = held_out(linear, taken_up, strongest)
        can_be = _possible(scores[strongest], result)
        lacks.append(Lack(scores[strongest], tuple(scores[k] for k in rivals), differs, apart, holdout, can_be))
        taken_up.append(strongest)
        scores = next_scores
    return StructureTest(tuple(first), tuple(lacks))


def _rivals(
    scores: Sequence[Tested], next_scores: Sequence[Tested], taken_up: Sequence[int], strongest: int, result: Result
) -> list[int]:
    """What would have served as well as the strongest: nearly as high a score, and no more needed once that is in."""
    return [
        k
        for k, t in enumerate(scores)
        if k not in (*taken_up, strongest)
        and abs(t.score) > RIVAL * abs(scores[strongest].score)
        and abs(next_scores[k].score) < THRESHOLD
        and _possible(t, result, as_rival=True)
    ]


def derivative_instead(scores: Sequence[Tested], strongest: int, rivals: Sequence[int], result: Result) -> int | None:
    """A derivative that serves as well as a product of inertia: one that flights tell belongs to the model, an inertia to the
    aircraft file; the bounds span what the other would make of the estimates."""
    if scores[strongest].candidate.kind is not CandidateKind.INERTIA:
        return None
    linear = [k for k in rivals if scores[k].candidate.kind is CandidateKind.LINEAR]
    derivatives = [k for k in linear if _possible(scores[k], result)]
    return max(derivatives, key=lambda k: abs(scores[k].score), default=None)


def held_out(linear: LinearisedFit, taken_up: Sequence[int], candidate: int) -> float | None:
    """What a candidate gains on each flight when it, the parameters and those already chosen are fitted to all the others."""
    if len(linear.flights) < 2:
        return None
    base_columns = np.array([*range(linear.n), *(linear.n + k for k in taken_up)], np.intp)
    all_columns = np.append(base_columns, linear.n + candidate)
    gain = 0.0
    for i, flight in enumerate(linear.flights):
        rest = linear.total([j for j in range(len(linear.flights)) if j != i])
        costs = []
        for columns in (base_columns, all_columns):
            x = pseudo_inverse(rest[np.ix_(columns, columns)])[0] @ rest[columns, -1]
            costs.append(float(x @ flight.gram[np.ix_(columns, columns)] @ x - 2.0 * x @ flight.gram[columns, -1]))
        gain += costs[0] - costs[1]
    return gain


def _strongest(scores: Sequence[Tested], taken_up: Sequence[int], result: Result) -> int | None:
    """The next candidate to take; None where no other is significant."""
    significant = [k for k, t in enumerate(scores) if k not in taken_up and t.significant]
    if not significant:
        return None
    possible = [k for k in significant if _possible(scores[k], result)] or significant
    highest = max(abs(scores[k].score) for k in possible)
    tied = [k for k in possible if abs(scores[k].score) >= TIED * highest]
    return min(tied, key=lambda k: (LIKELIEST_FIRST.index(scores[k].candidate.kind), -abs(scores[k].score)))


def _possible(tested: Tested, result: Result, *, as_rival: bool = False) -> bool:
    """Whether a candidate of that size can be what it is called. as_rival: beside a likelier one, for a rolling tail or long
    ailerons near the stall yaw by more than usual."""
    c = tested.candidate
    if c.kind is CandidateKind.SCALE:
        low, high = FACTORS.get(c.channel, FACTORS_ELSE)
        return low <= tested.value <= high
    roll = result.parameters.get("Cl_da")
    if c.name == "Cn_da" and roll is not None and not as_rival:
        return abs(tested.value) <= ADVERSE * abs(roll.estimate)
    if c.kind in (CandidateKind.LATE_CONTROL, CandidateKind.LATE_SENSOR):
        return abs(tested.value) <= LONGEST_LAG
    if c.kind is CandidateKind.PLACE:
        return not abs(tested.value) > FARTHEST * result.model.constants.get("b", np.inf)
    if c.kind is CandidateKind.NONLINEAR:
        return abs(tested.value) * STEEP**c.power <= (MOST_MOMENT if c.line in MOMENTS else MOST_FORCE)
    if c.kind is CandidateKind.INERTIA:
        Ixx, Izz = (result.model.constants.get(n, np.nan) for n in ("Ixx", "Izz"))
        return not tested.value**2 >= Ixx * Izz
    return True


def _scores(linear: LinearisedFit, taken_up: Sequence[int], result: Result, filtered: bool) -> list[Tested]:
    """Every candidate with the parameters, and the candidates already taken, projected out."""
    n, k = linear.n, len(linear.tested)
    gram = linear.total()
    projected_out = np.concatenate([np.arange(n), n + np.array(taken_up, int)]).astype(int)
    inverse = pseudo_inverse(gram[np.ix_(projected_out, projected_out)])[0]
    lever = gram[n : n + k][:, projected_out] @ inverse
    combine = np.zeros((k, len(gram)))
    combine[:, n : n + k] = np.eye(k)
    combine[:, projected_out] -= lever
    rest = gram[n : n + k, -1] - lever @ gram[projected_out, -1]
    information = np.einsum("ij,ij->i", gram[n : n + k] - lever @ gram[projected_out], combine)
    spread = np.diag(linear.by_inputs(combine))
    bounds = _bounds(linear, result)
    weigh = gram if filtered else linear.plain()
    shift = pseudo_inverse(weigh[:n, :n])[0] @ weigh[:n, n : n + k]
    tests = []
    for a, candidate in enumerate(linear.tested):
        usable = a not in taken_up and information[a] > 0.0
        score = float(rest[a] / np.sqrt(information[a] + spread[a])) if usable else 0.0
        size = float(rest[a] / information[a]) if usable else 0.0
        if candidate.kind is CandidateKind.DAMPER and size <= 0.0:
            score = size = 0.0  # it acts against its rate, as signs of surfaces are here
        moves = dict(zip(linear.shared, np.abs(shift[:, a] * size) / bounds, strict=True))
        tests.append(Tested(candidate, score, candidate.null + size, _printed(moves, result)))
    return tests


def _bounds(linear: LinearisedFit, result: Result) -> Array:
    """(n,) corrected bounds of the shared parameters."""
    bounds = np.array([result.parameters[n].std_coloured for n in linear.shared])
    return np.where(np.isfinite(bounds) & (bounds > 0.0), bounds, np.inf)


def _printed(moves: Mapping[str, float], result: Result) -> dict[str, float]:
    """Moves of the values that are printed as told."""
    return {n: float(m) for n, m in moves.items() if result.parameters[n].identifiable}


def _differences(
    linear: LinearisedFit, leading: int, rivals: Sequence[int], scores: Sequence[Tested]
) -> dict[str, float]:
    """By how much the estimates with `leading` in the model differ, at most, from those with a rival in its place."""
    n, weigh = linear.n, linear.plain()
    inverse = pseudo_inverse(weigh[:n, :n])[0]
    change = {k: inverse @ weigh[:n, n + k] * (scores[k].value - scores[k].candidate.null) for k in (leading, *rivals)}
    differences = np.array([np.abs(change[leading] - change[k]) for k in rivals]).reshape(-1, n)
    return dict(zip(linear.shared, differences.max(axis=0, initial=0.0).tolist(), strict=True))


def _has_bound(result: Result, name: str) -> bool:
    estimate = result.parameters[name]
    return estimate.identifiable and 0.0 < estimate.std_coloured < np.inf
