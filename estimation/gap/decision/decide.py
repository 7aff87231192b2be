"""From facts to the verdict: which names stand, whether a nameless rest matters, and a table of verdicts.

This module sees no flights or models. The facts are numbers from the search and the nulls; `decide` turns them into a decision,
from which the words are written.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from estimation.gap.answer.result import Gap, GapVerdict
from estimation.gap.criteria import Criteria

OF_INPUTS = "no larger than what the unknown times of recorded commands leave"
NOTHING_CLOSED = "closes nothing of the gap, and no flight is held out that might confirm it"
ANY = None
TABLE: tuple[tuple[bool | None, bool | None, bool | None, bool | None, GapVerdict], ...] = (
    # a rest matters, names stand, closed, blind -> verdict; the first row that matches
    (True, ANY, ANY, ANY, GapVerdict.UNKNOWN),
    (False, True, True, ANY, GapVerdict.GAP_CLOSED),
    (False, True, False, ANY, GapVerdict.GAP_REDUCED),
    (False, False, ANY, True, GapVerdict.CANNOT_TELL),
    (False, False, ANY, False, GapVerdict.NO_GAP),
)


@dataclass(frozen=True)
class Named:
    """One accepted effect. score: of its full fit. gap, held: before and after it, on training and held-out flights (None
    without any). instruments: outputs of the instruments that it blames."""

    effect: str
    score: float
    gap: Gap
    held: Gap | None
    instruments: frozenset[str] = frozenset()

    @property
    def unseen(self) -> bool:
        """Whether the gap says nothing about it, neither on the training nor on the held-out flights."""
        return self.gap.says_nothing and (self.held is None or self.held.says_nothing)


@dataclass(frozen=True)
class VerdictFacts:
    """The facts after all rounds.

    named: accepted effects in the order found. rest, rest_threshold, rest_place: score of the strongest nameless signal, its
    threshold from nulls, and its output or equation. covered: whether nulls have such a plain gap too. blind, asked: numbers of
    effects that could not have been seen, and of all that were searched.
    """

    named: tuple[Named, ...]
    rest: float
    rest_threshold: float
    rest_place: str
    covered: bool
    blind: int
    asked: int


@dataclass(frozen=True)
class Decision:
    """The verdict. The first `kept` names stand; withdrawn: (name, reason) of the others. doubted: the rest, or a withdrawn name,
    may come from errors of the inputs."""

    verdict: GapVerdict
    kept: int
    withdrawn: tuple[tuple[str, str], ...]
    doubted: bool = False


def decide(facts: VerdictFacts, criteria: Criteria, commanded: bool = False) -> Decision:
    """The verdict from the facts. commanded: surfaces are recorded as commands. Their unknown times cause a nameless rest that
    is no effect, and names that close no more than a gap of nulls; without another name the flights cannot tell."""
    idle = closing_nothing(facts.named)
    facts = replace(facts, named=facts.named[: len(facts.named) - len(idle)])
    rest = bool(idle) or rest_matters(facts, criteria)
    count, fallen = standing(facts, criteria) if rest else (len(facts.named), ())
    withdrawn = (*fallen, *idle)
    if commanded:
        first_unseen = next((k for k, name in enumerate(facts.named[:count]) if name.unseen), count)
        withdrawn = (*withdrawn, *((n.effect, OF_INPUTS) for n in facts.named[first_unseen:count]))
        count = first_unseen
    closed = count > 0 and closed_by(facts.named[:count]) >= criteria.closed_share
    doubted = commanded and (rest or bool(withdrawn))
    blind = facts.blind > criteria.negligible * max(facts.asked, 1) or doubted
    answers = (rest and not commanded, count > 0, closed, blind)
    verdict = next(row[-1] for row in TABLE if all(w is ANY or w == f for w, f in zip(row[:-1], answers, strict=True)))
    return Decision(verdict, count, withdrawn, doubted)


def closing_nothing(named: Sequence[Named]) -> tuple[tuple[str, str], ...]:
    """The last names with which the gap grows beyond those of nulls, where no flight is held out that might confirm them. They
    are significant, so that something is left without a name."""
    count = len(named)
    while count and named[count - 1].held is None and named[count - 1].gap.grows_beyond_nulls:
        count -= 1
    return tuple((n.effect, NOTHING_CLOSED) for n in named[count:])


def only_steered(facts: VerdictFacts) -> VerdictFacts:
    """The facts of flights on which every control only follows the motion: no nameless rest counts, and no effect could have been
    seen."""
    return replace(facts, rest=0.0, blind=facts.asked)


def with_names(decision: Decision, names: Sequence[str]) -> Decision:
    """The decision in which these names stand beside a shape; some may have been withdrawn without it."""
    withdrawn = tuple((effect, reason) for effect, reason in decision.withdrawn if effect not in names)
    return replace(decision, kept=len(names), withdrawn=withdrawn)


def as_unknown(decision: Decision) -> Decision:
    """The decision with a significant effect that has no name: a faulty instrument, an event in time, a lag or a swing."""
    return replace(decision, verdict=GapVerdict.UNKNOWN)


def rest_matters(facts: VerdictFacts, criteria: Criteria) -> bool:
    """Whether a nameless rest is an unknown effect, and not ordinary scatter beside names that close the gap.

    In the instrument that a name blames it is never scatter: something else is wrong with that instrument.
    """
    elsewhere = all(facts.rest_place not in n.instruments for n in facts.named)
    small = facts.rest < criteria.clearly_above * facts.rest_threshold
    restless = bool(facts.named) and facts.covered and small and elsewhere
    return facts.rest > facts.rest_threshold and not restless


def standing(facts: VerdictFacts, criteria: Criteria) -> tuple[int, tuple[tuple[str, str], ...]]:
    """How many names stand beside a nameless rest that matters, and why the others do not.

    The last name falls where it closes little and the rest outweighs it. Then the first name falls that blames the instrument of
    the rest without outweighing the rest (a vane that sticks is late too, but a lag is not its fault), and with it all later
    ones."""
    names = list(facts.named)
    withdrawn: list[tuple[str, str]] = []
    if names and not facts.covered:
        last = names[-1]
        closed = max(last.gap.closed, last.held.closed if last.held is not None else 0.0)
        if closed < criteria.closed_share and not outweighs(last.score, facts.rest, criteria.named_share):
            withdrawn.append((last.effect, f"closes only {last.gap.closed:.0%} of the gap"))
            names.pop()
    place = facts.rest_place
    reason = f"the nameless rest in {place} is too large beside it: the instrument does something else than this"
    for k, name in enumerate(names):
        if place in name.instruments and not outweighs(name.score, facts.rest, criteria.nearly_all):
            return k, (*withdrawn, *((n.effect, reason) for n in names[k:]))
    return len(names), tuple(withdrawn)


def outweighs(named: float, rest: float, share: float) -> bool:
    """Whether a named effect has at least `share` of the sum of the squared scores `named` and `rest`.

    named, rest: scores of the effect and of the strongest nameless term after it, both on whitened residuals. The plain gap also
    counts slow errors of an attitude filter and the gusts of the day, beside which a certain effect can look small.
    """
    return named**2 >= share * (named**2 + rest**2)


def closed_by(named: Sequence[Named]) -> float:
    """Share of the gap that names close together on the held-out flights.

    Where the gap of these says nothing, it is the least that they confirm of a name, and what stands open on the training flights
    counts too.
    """
    first, last = named[0], named[-1]
    training = replace(first.gap, after=last.gap.after, floor=last.gap.floor, highest=last.gap.highest)
    if first.held is None or last.held is None:
        return training.counted
    confirmed = [n.held.confirmed for n in named if n.held is not None and n.held.confirmed is not None]
    held = replace(first.held, after=last.held.after, floor=last.held.floor, confirmed=min(confirmed, default=None))
    if not held.says_nothing:
        return held.closed
    return held.counted if training.says_nothing else min(held.counted, training.closed)
