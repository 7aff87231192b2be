"""Score tests of the candidates of a fit, and by how much leaving them out moves the estimates.

The score of a candidate is the product of the residuals with its sensitivity, all parameters projected out, over the standard
deviation that output noise and input errors give it. Its variance is one where the model lacks nothing (C. R. Rao, 1948; V. Klein
and E. A. Morelli, Aircraft System Identification, 2nd ed., section 5.4, test regressors likewise). Significant candidates are
selected one after the other, the strongest first; a candidate that would explain the residuals as well is its rival.
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
"""Share of the strongest score from which another candidate is a rival, if it is no longer significant once that one is in."""
TIED = 0.97
"""Share of the strongest score from which the likelier kind is selected instead (`LIKELIEST_FIRST`)."""
MOST_SELECTED = 4  # candidates selected: a model that lacks more is another model
ADVERSE = 0.25
"""Largest yaw by aileron over roll by aileron (Roskam, Airplane Flight Dynamics I, 4.1: -5 to -15 %; spoilers as much with the
other sign): more indicates a wrong product of inertia in the aircraft file."""
FACTORS = {"alpha": (0.5, 2.0), "beta": (0.5, 2.0)}
"""Scales that a vane in the upwash of an airframe can have (Gracey, NASA RP-1046: 1.1 to 1.8 ahead of a fuselage)."""
FACTORS_ELSE = (0.75, 1.33)  # of any other channel: more is no calibration error
LONGEST_LAG = 0.5  # s, either sign: vanes, servos and telemetry lag by 0.02 to 0.2
FARTHEST = 0.75  # distance of an accelerometer from the CG over the span: a nose boom of a slender aeroplane
STEEP, MOST_FORCE, MOST_MOMENT = 0.35, 5.0, 1.0
"""Angle [rad] (20 deg), and the most that a nonlinear term may add there to a force or moment coefficient: more than any wing."""
NOTABLE = 1.0  # bounds by which a printed value has to move before it counts
BORNE = 3.0
"""Bounds up to which the effect of a lack widens the bounds instead of forbidding a recommendation. Its size is known to a fifth
(a score of 5), so the wider bound covers the truth. Beyond, the model is so different that its estimates are not believable."""

MOMENTS = ("Cl", "Cm", "Cn")

LIKELIEST_FIRST = (
    CandidateKind.LINEAR, CandidateKind.LATE_CONTROL, CandidateKind.SCALE, CandidateKind.LATE_SENSOR, CandidateKind.INERTIA,
    CandidateKind.NONLINEAR, CandidateKind.DAMPER, CandidateKind.PLACE,
)  # fmt: skip


@dataclass(frozen=True)
class Tested:
    """One tested candidate. score: signed, in standard deviations; value: its estimate; moves: parameter -> by how many of its
    corrected bounds leaving the candidate out moves its estimate."""

    candidate: Candidate
    score: float
    value: float
    moves: Mapping[str, float]
    threshold: float = THRESHOLD

    @property
    def significant(self) -> bool:
        """Whether its score exceeds the threshold and its value is beyond what the model itself leaves uncertain."""
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
    """Something the model lacks, and its rivals. differs: parameter -> by how much its estimate differs with a rival instead;
    largest_difference: the largest of these in bounds. holdout: gain in twice the log likelihood on each flight by a fit to all
    the others, summed; None with one flight. possible: whether a candidate of the leading one's kind can have that size."""

    leading: Tested
    rivals: tuple[Tested, ...] = ()
    differs: Mapping[str, float] = field(default_factory=dict)
    largest_difference: float = 0.0
    holdout: float | None = None
    possible: bool = True

    @property
    def holds(self) -> bool:
        """Whether held-out flights confirm it; True where there are none."""
        return self.holdout is None or self.holdout > 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the leading candidate and its rivals."""
        return (self.leading.candidate.name, *(r.candidate.name for r in self.rivals))

    def matters(self, bounds: float) -> bool:
        """Whether leaving it out moves a printed value by more than so many of its bounds."""
        return any(t.worst[1] > bounds for t in (self.leading, *self.rivals))


@dataclass(frozen=True)
class StructureTest:
    """The structure test of a fit. added: names of candidates that were added to the model; ambiguous: lacks among these that a
    rival explains as well with other estimates. why_not: why no test was made. follows: filter method -> why it is no gusts."""

    tested: tuple[Tested, ...]
    lacks: tuple[Lack, ...]
    added: tuple[str, ...] = ()
    ambiguous: tuple[Lack, ...] = ()
    why_not: str = ""
    follows: Mapping[str, str] = field(default_factory=dict)

    @property
    def bears(self) -> float:
        """Bounds by which a lack may move a value: BORNE once the strongest lacks were added, before that NOTABLE, because a
        better model is available."""
        return BORNE if self.added else NOTABLE

    def with_added(self, names: Sequence[str], ambiguous: Sequence[Lack]) -> "StructureTest":
        """The test with the candidates that were added to the model before it."""
        return replace(self, added=tuple(names), ambiguous=tuple(ambiguous))

    def to_json(self) -> dict[str, Any]:
        """As `structure` in `estimate --json`."""
        tested = [t.to_json() for t in sorted(self.tested, key=lambda t: -abs(t.score))]
        data: dict[str, Any] = {"tested": tested, "added": list(self.added)}
        return {**data, "why_not": self.why_not} if self.why_not else data


def structure_of(linear: LinearisedFit, result: Result, *, filtered: bool = False) -> StructureTest:
    """Test every candidate and select the significant ones, one after the other.

    result: its bounds count the moves. filtered: its estimates weigh residuals as a filter does, not as output error does.
    """
    first = _scores(linear, (), result, filtered)
    selected: list[int] = []
    lacks: list[Lack] = []
    scores = first
    while len(selected) < MOST_SELECTED:
        strongest = _strongest(scores, selected, result)
        if strongest is None:
            break
        next_scores = _scores(linear, (*selected, strongest), result, filtered)
        rivals = _rivals(scores, next_scores, selected, strongest, result)
        if (derivative := derivative_instead(scores, strongest, rivals, result)) is not None:
            strongest = derivative
            next_scores = _scores(linear, (*selected, strongest), result, filtered)
            rivals = _rivals(scores, next_scores, selected, strongest, result)
        differs = _differences(linear, strongest, rivals, scores)
        largest_difference = max(
            (d / result.parameters[n].std_coloured for n, d in differs.items() if _has_bound(result, n)), default=0.0
        )
        holdout = _holdout_gain(linear, selected, strongest)
        can_be = _possible(scores[strongest], result)
        lacks.append(
            Lack(scores[strongest], tuple(scores[k] for k in rivals), differs, largest_difference, holdout, can_be)
        )
        selected.append(strongest)
        scores = next_scores
    return StructureTest(tuple(first), tuple(lacks))


def _rivals(
    scores: Sequence[Tested], next_scores: Sequence[Tested], selected: Sequence[int], strongest: int, result: Result
) -> list[int]:
    """Candidates with nearly as high a score as the strongest that are no longer significant once that one is selected."""
    return [
        k
        for k, t in enumerate(scores)
        if k not in (*selected, strongest)
        and abs(t.score) > RIVAL * abs(scores[strongest].score)
        and abs(next_scores[k].score) < THRESHOLD
        and _possible(t, result, as_rival=True)
    ]


def derivative_instead(scores: Sequence[Tested], strongest: int, rivals: Sequence[int], result: Result) -> int | None:
    """The strongest derivative among the rivals of a product of inertia, or None. It is preferred because flights determine
    derivatives, while inertia belongs to the aircraft file; the bounds span the estimates with either."""
    if scores[strongest].candidate.kind is not CandidateKind.INERTIA:
        return None
    linear = [k for k in rivals if scores[k].candidate.kind is CandidateKind.LINEAR]
    derivatives = [k for k in linear if _possible(scores[k], result)]
    return max(derivatives, key=lambda k: abs(scores[k].score), default=None)


def _holdout_gain(linear: LinearisedFit, selected: Sequence[int], candidate: int) -> float | None:
    """Gain in twice the log likelihood that a candidate gives on each flight by a fit to all the others, summed; None with one
    flight. selected: candidates that are in both fits."""
    if len(linear.flights) < 2:
        return None
    base_columns = np.array([*range(linear.n), *(linear.n + k for k in selected)], np.intp)
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


def _strongest(scores: Sequence[Tested], selected: Sequence[int], result: Result) -> int | None:
    """The next candidate to select; None where no other is significant."""
    significant = [k for k, t in enumerate(scores) if k not in selected and t.significant]
    if not significant:
        return None
    possible = [k for k in significant if _possible(scores[k], result)] or significant
    highest = max(abs(scores[k].score) for k in possible)
    tied = [k for k in possible if abs(scores[k].score) >= TIED * highest]
    return min(tied, key=lambda k: (LIKELIEST_FIRST.index(scores[k].candidate.kind), -abs(scores[k].score)))


def _possible(tested: Tested, result: Result, *, as_rival: bool = False) -> bool:
    """Whether a candidate of its kind can have that size. as_rival: beside a likelier candidate, where a large `Cn_da` is
    allowed, since a rolling tail or long ailerons near the stall yaw more than usual."""
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


def _scores(linear: LinearisedFit, selected: Sequence[int], result: Result, filtered: bool) -> list[Tested]:
    """Every candidate tested with the parameters and the selected candidates projected out; zero scores for the selected."""
    n, k = linear.n, len(linear.tested)
    gram = linear.total()
    projected_out = np.concatenate([np.arange(n), n + np.array(selected, int)]).astype(int)
    inverse = pseudo_inverse(gram[np.ix_(projected_out, projected_out)])[0]
    lever = gram[n : n + k][:, projected_out] @ inverse
    combine = np.zeros((k, len(gram)))
    combine[:, n : n + k] = np.eye(k)
    combine[:, projected_out] -= lever
    rest = gram[n : n + k, -1] - lever @ gram[projected_out, -1]
    information = np.einsum("ij,ij->i", gram[n : n + k] - lever @ gram[projected_out], combine)
    spread = np.diag(linear.input_error_covariance(combine))
    bounds = _bounds(linear, result)
    weigh = gram if filtered else linear.output_error_gram()
    shift = pseudo_inverse(weigh[:n, :n])[0] @ weigh[:n, n : n + k]
    tests = []
    for a, candidate in enumerate(linear.tested):
        usable = a not in selected and information[a] > 0.0
        score = float(rest[a] / np.sqrt(information[a] + spread[a])) if usable else 0.0
        size = float(rest[a] / information[a]) if usable else 0.0
        if candidate.kind is CandidateKind.DAMPER and size <= 0.0:
            score = size = 0.0  # a damper opposes its rate, which is a positive size with these signs of surfaces
        moves = dict(zip(linear.shared, np.abs(shift[:, a] * size) / bounds, strict=True))
        tests.append(Tested(candidate, score, candidate.null + size, _printed(moves, result)))
    return tests


def _bounds(linear: LinearisedFit, result: Result) -> Array:
    """(n,) corrected bounds of the shared parameters."""
    bounds = np.array([result.parameters[n].std_coloured for n in linear.shared])
    return np.where(np.isfinite(bounds) & (bounds > 0.0), bounds, np.inf)


def _printed(moves: Mapping[str, float], result: Result) -> dict[str, float]:
    """Moves of identifiable parameters, whose values are printed."""
    return {n: float(m) for n, m in moves.items() if result.parameters[n].identifiable}


def _differences(
    linear: LinearisedFit, leading: int, rivals: Sequence[int], scores: Sequence[Tested]
) -> dict[str, float]:
    """Parameter -> the largest difference between its estimates with `leading` in the model and with a rival instead."""
    n, weigh = linear.n, linear.output_error_gram()
    inverse = pseudo_inverse(weigh[:n, :n])[0]
    change = {k: inverse @ weigh[:n, n + k] * (scores[k].value - scores[k].candidate.null) for k in (leading, *rivals)}
    differences = np.array([np.abs(change[leading] - change[k]) for k in rivals]).reshape(-1, n)
    return dict(zip(linear.shared, differences.max(axis=0, initial=0.0).tolist(), strict=True))


def _has_bound(result: Result, name: str) -> bool:
    estimate = result.parameters[name]
    return estimate.identifiable and 0.0 < estimate.std_coloured < np.inf
