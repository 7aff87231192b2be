"""From facts to the verdict: which names stand, whether a nameless rest matters, and one table for the word.

Nothing here looks at flights or models. The facts are numbers that the search and the nulls left; `decide` turns them into
a decision, and the words are written from that.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from estimation.gap.answer.result import Gap, GapVerdict
from estimation.gap.criteria import Criteria

ANY = None
TABLE: tuple[tuple[bool | None, bool | None, bool | None, bool | None, GapVerdict], ...] = (
    # a rest matters, names stand, closed, blind -> verdict; the first row that fits
    (True, ANY, ANY, ANY, GapVerdict.UNKNOWN),
    (False, True, True, ANY, GapVerdict.GAP_CLOSED),
    (False, True, False, ANY, GapVerdict.GAP_REDUCED),
    (False, False, ANY, True, GapVerdict.CANNOT_TELL),
    (False, False, ANY, False, GapVerdict.NO_GAP),
)


@dataclass(frozen=True)
class Named:
    """One accepted effect. score: of its full fit. gap, held: before and after it, on training and held-out flights (None
    without any). instruments: outputs whose very instrument it blames."""

    effect: str
    score: float
    gap: Gap
    held: Gap | None
    instruments: frozenset[str] = frozenset()


@dataclass(frozen=True)
class VerdictFacts:
    """What is known when all rounds are over.

    named: accepted effects in the order found. rest, rest_threshold, rest_place: score of the strongest nameless signal, its
    threshold from nulls and the output or equation it lives in. covered: whether the plain gap is one the nulls show.
    blind, asked: effects that could not have been seen, and that were asked about.
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
    """The verdict; the first `kept` names stand, each of the others is withdrawn for a reason. doubted: what is left, or was
    withdrawn, may be what errors of the inputs leave."""

    verdict: GapVerdict
    kept: int
    withdrawn: tuple[tuple[str, str], ...]
    doubted: bool = False


OF_INPUTS = "no larger than what the unknown times of recorded commands leave"


def decide(facts: VerdictFacts, criteria: Criteria, commanded: bool = False) -> Decision:
    """The verdict that the facts give. commanded: surfaces are known by recorded commands, whose unknown times leave a nameless
    rest that is no effect, and names of a gap that nothing hidden leaves too; where no other name stands nobody can tell."""
    rest = rest_matters(facts, criteria)
    count, withdrawn = standing(facts, criteria) if rest else (len(facts.named), ())
    if commanded:
        seen = next((k for k, name in enumerate(facts.named[:count]) if unseen(name)), count)
        withdrawn = (*withdrawn, *((n.effect, OF_INPUTS) for n in facts.named[seen:count]))
        count = seen
    closed = count > 0 and closed_by(facts.named[:count]) >= criteria.closed_share
    doubted = commanded and (rest or bool(withdrawn))
    blind = facts.blind > criteria.blind_share * max(facts.asked, 1) or doubted
    answers = (rest and not commanded, count > 0, closed, blind)
    verdict = next(row[-1] for row in TABLE if all(w is ANY or w == f for w, f in zip(row[:-1], answers, strict=True)))
    return Decision(verdict, count, withdrawn, doubted)


def unseen(name: Named) -> bool:
    """Whether no share of a gap can be told of a name, on the training or the held-out flights: its course alone stands out."""
    return name.gap.says_nothing and (name.held is None or name.held.says_nothing)


def only_steered(facts: VerdictFacts) -> VerdictFacts:
    """The facts of flights on which every control only follows the motion: no rest without a name counts, and what has no name
    could not have been seen."""
    return replace(facts, rest=0.0, blind=facts.asked)


def with_shape(decision: Decision) -> Decision:
    """The decision where a nameless shape was found for the rest: the gap is smaller, and it still has no name."""
    return replace(decision, verdict=GapVerdict.GAP_REDUCED)


def with_names(decision: Decision, names: Sequence[str]) -> Decision:
    """The decision where these names stand in the end, beside a shape, some of which may have been withdrawn without it."""
    withdrawn = tuple((effect, reason) for effect, reason in decision.withdrawn if effect not in names)
    return replace(decision, kept=len(names), withdrawn=withdrawn)


def as_unknown(decision: Decision) -> Decision:
    """The decision where something stands out that is no term with a name: a fault of an instrument, what happened at one time, a
    coefficient that follows late or swings."""
    return replace(decision, verdict=GapVerdict.UNKNOWN)


def rest_matters(facts: VerdictFacts, criteria: Criteria) -> bool:
    """Whether a nameless rest is an unknown effect, and not restless scatter beside names that close the gap.

    In the very instrument that a name blames it is never mere scatter: it says that something else is wrong with it.
    """
    elsewhere = all(facts.rest_place not in n.instruments for n in facts.named)
    small = facts.rest < criteria.strong * facts.rest_threshold
    restless = bool(facts.named) and facts.covered and small and elsewhere
    return facts.rest > facts.rest_threshold and not restless


def standing(facts: VerdictFacts, criteria: Criteria) -> tuple[int, tuple[tuple[str, str], ...]]:
    """How many names stand beside a nameless rest that matters, and why the others do not.

    The last name falls where it closes little and the rest outweighs it. Then the first falls that blames the very instrument
    in which the rest lives without outweighing it (a vane that sticks is late too, but what is wrong with it is not that it is
    late), and with it all that were found on top of it.
    """
    names = list(facts.named)
    withdrawn: list[tuple[str, str]] = []
    if names and not facts.covered and few(names[-1], facts.rest, criteria):
        last = names.pop()
        withdrawn.append((last.effect, f"closes only {last.gap.closed:.0%} of the gap"))
    for k, name in enumerate(names):
        if facts.rest_place in name.instruments and not outweighs(name.score, facts.rest, criteria.own_weight):
            reason = (
                f"the nameless rest in {facts.rest_place} is too large beside it: "
                "the instrument does something else than this"
            )
            return k, (*withdrawn, *((n.effect, reason) for n in names[k:]))
    return len(names), tuple(withdrawn)


def few(name: Named, rest: float, criteria: Criteria) -> bool:
    """Whether a name closes little of the gap, on training and on held-out flights, and a nameless rest outweighs it."""
    closed = max(name.gap.closed, name.held.closed if name.held is not None else 0.0)
    return closed < criteria.closed_share and not outweighs(name.score, rest, criteria.named_weight)


def outweighs(named: float, rest: float, share: float) -> bool:
    """Whether a named effect holds most of what is significant, whatever the plain gap says.

    named, rest: scores of the effect and of the strongest nameless term after it, both on whitened residuals. share: of
    the sum of their squares. The plain gap also counts slow errors of an attitude filter and the gusts of the day, beside
    which a certain effect can look small.
    """
    return named**2 >= share * (named**2 + rest**2)


def closed_by(named: Sequence[Named]) -> float:
    """Share of the gap that names close together: on the held-out flights; where these show no gap, the training flights may say
    less."""
    first, last = named[0], named[-1]
    training = replace(first.gap, after=last.gap.after, floor=last.gap.floor, highest=last.gap.highest)
    if first.held is None or last.held is None:
        return training.counted
    held = replace(first.held, after=last.held.after, floor=last.held.floor)
    return min(held.counted, training.counted) if held.says_nothing else held.closed
