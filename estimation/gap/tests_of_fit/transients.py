"""Is what is left a matter of time and not of the motion: an instrument that drifts or slips, weather that bursts?

Four families: a ramp in an output (own slope on every flight), a step in an output of one flight at some instant, a disturbance
of all force equations over a stretch of one flight, and a gust that comes and goes there: what it does to the rate of an angle
or a speed of the air it takes back. They are scored by linear theory with everything the base can absorb
projected out, calibrated on the same nulls as all else, and taken one after the other.
"""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from scipy.stats import chi2, norm

from estimation.engine.kernel import Array
from estimation.estimators.arrow import solved
from estimation.gap.criteria import Criteria
from estimation.gap.likelihood.fitting import Fit, Problem, fit
from estimation.gap.records.candidate_model import DISTURBANCE
from estimation.gap.tests_of_fit.calibration import Round, upper_quantile
from estimation.gap.tests_of_fit.doors import is_door, through_doors
from estimation.gap.tests_of_fit.screen import Projected, reduce_record, shared_prior

EVERY = 0.5  # s between the instants at which a step is looked for: a twentieth of the gain is lost between two of them
STRETCHES = (1.0, 3.0)  # s, of disturbances; each begins a third of it after the one before
MOST = 6  # taken one after the other
SMALLEST_TAIL = -700.0  # of a logarithm of a probability that still has one
AIR = frozenset(DISTURBANCE.format(s) for s in ("V", "alpha", "beta"))  # motion through the air, which a gust moves
SEEN = 1e-6  # of a column's length: one of which the base leaves less says nothing
FEWEST = 4  # samples to either side of a step


class Happening(StrEnum):
    """What changes with time alone."""

    DRIFT = "drift"
    SLIP = "slip"
    BURST = "burst"


@dataclass(frozen=True)
class Event:
    """One happening. channel: the output, or "" for a disturbance of the motion. record: in which; -1 for a drift, which may be
    in all. start, end: s on the flight's clock. air: of a gust the state that it moves."""

    kind: Happening
    channel: str
    record: int
    start: float
    end: float
    air: str = ""


@dataclass(frozen=True)
class Found:
    """An event taken. score, threshold: as of a nameless signal. gain: twice the log-likelihood. sizes: estimates of its columns
    with bounds: of a drift the change over each record, of a slip the step, of a burst the peak rates that it adds."""

    event: Event
    score: float
    threshold: float
    gain: float
    sizes: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Transients:
    """All events taken, the one that stands out most first, and the round without what they did; None where that runs away."""

    found: tuple[Found, ...]
    cleared: Round | None


@dataclass(frozen=True)
class Asked:
    """Events with their columns. columns: of every event; owners: the record of each column; changes: (N, ny) of each column."""

    events: tuple[Event, ...]
    columns: tuple[tuple[int, ...], ...]
    owners: tuple[int, ...]
    changes: tuple[Array, ...]


def asked_of(problem: Problem, found: Fit) -> Asked:
    """Every event that these records could show."""
    events: list[Event] = []
    columns: list[tuple[int, ...]] = []
    owners: list[int] = []
    changes: list[Array] = []

    def put(event: Event, made: Sequence[tuple[int, Array]]) -> None:
        columns.append(tuple(range(len(changes), len(changes) + len(made))))
        events.append(event)
        owners.extend(i for i, _ in made)
        changes.extend(c for _, c in made)

    for c, name in enumerate(problem.model.output_names):
        ramps = []
        for i, segment in enumerate(problem.coarse):
            share = (segment.time - segment.time[0]) / float(np.ptp(segment.time))
            ramps.append((i, _in_output(segment.z, c, share)))
        whole = problem.coarse[0].time
        put(Event(Happening.DRIFT, name, -1, float(whole[0]), float(whole[-1])), ramps)
        for i, segment in enumerate(problem.coarse):
            for at in np.arange(segment.time[FEWEST], segment.time[-FEWEST], EVERY):
                step = (segment.time >= at).astype(float)
                put(
                    Event(Happening.SLIP, name, i, float(at), float(segment.time[-1])),
                    [(i, _in_output(segment.z, c, step))],
                )
    doors = [n for n in problem.model.input_names if is_door(n)]
    for i, segment in enumerate(problem.coarse if doors else ()):
        bursts: list[tuple[Event, tuple[tuple[str, Array], ...]]] = []
        for width in STRETCHES:
            for at in np.arange(segment.time[0], segment.time[-1] - width, width / 3.0):
                phase = np.pi * np.clip((segment.time - at) / width, 0.0, 1.0)
                span, course = (float(at), float(at + width)), np.sin(phase)
                bursts.append((Event(Happening.BURST, "", i, *span), tuple((d, course) for d in doors)))
                # the rate of an air that moves like the sine
                turn = np.where((phase > 0.0) & (phase < np.pi), np.cos(phase), 0.0)
                for d in (d for d in doors if d in AIR):
                    air = d.removeprefix(DISTURBANCE.format(""))
                    bursts.append((Event(Happening.BURST, "", i, *span, air=air), ((d, turn),)))
        through = iter(through_doors(problem, found, i, [ask for _, asks in bursts for ask in asks]))
        for event, asks in bursts:
            put(event, [(i, next(through)) for _ in asks])
    return Asked(tuple(events), tuple(columns), tuple(owners), tuple(changes))


def _in_output(z: Array, column: int, course: Array) -> Array:
    change = np.zeros_like(z)
    change[:, column] = course
    return change


def gram_of(asked: Asked, round_: Round) -> Array:
    """Gram matrix of [shared | columns | residuals of data and nulls], each column in its own record only."""
    problem, found = round_.baseline.problem, round_.baseline.fit
    n, k, m = len(problem.free), len(asked.changes), 1 + len(round_.null_residuals)
    total = np.zeros((n + k + m, n + k + m))
    for i in range(len(problem.records)):
        own = [c for c, owner in enumerate(asked.owners) if owner == i]
        nulls = [null[i] for null in round_.null_residuals]
        gram = reduce_record(problem, found, i, [asked.changes[c] for c in own], nulls).gram
        at = np.concatenate([np.arange(n), n + np.array(own, dtype=int), np.arange(n + k, n + k + m)])
        total[np.ix_(at, at)] += gram
    return total + shared_prior(problem, found, n + k + m, k)


def find_transients(round_: Round) -> Transients:
    """Events one after the other as long as one stands out of the nulls, each projected out before the next is looked for; then
    those that the later ones have made idle are dropped."""
    problem, found = round_.baseline.problem, round_.baseline.fit
    asked = asked_of(problem, found)
    gram, n, k = gram_of(asked, round_), len(problem.free), len(asked.changes)
    taken: list[int] = []
    for _ in range(MOST):
        scores, gains, limit = _scored(gram, n, k, asked, taken, round_.criteria)
        best = int(np.argmax(scores))
        if scores[best] <= limit:
            break
        taken.append(best)
    for e in list(taken):
        others = [o for o in taken if o != e]
        scores, _, limit = _scored(gram, n, k, asked, others, round_.criteria)
        if scores[e] <= limit:
            taken = others
    made = []
    inside = [c for e in taken for c in asked.columns[e]]
    at = dict(zip(inside, _estimates(gram, n, k, inside), strict=True))
    for e in taken:
        scores, gains, limit = _scored(gram, n, k, asked, [o for o in taken if o != e], round_.criteria)
        sizes = tuple(at[c] for c in asked.columns[e])
        made.append(Found(asked.events[e], float(scores[e]), limit, float(gains[e]), sizes))
    made.sort(key=lambda f: -f.score)
    return Transients(tuple(made), _without(round_, asked, {c: v for c, (v, _) in at.items()}) if made else round_)


def _scored(
    gram: Array, n: int, k: int, asked: Asked, taken: Sequence[int], criteria: Criteria
) -> tuple[Array, Array, float]:
    """(events,) scores and gains of all events beside those taken, nothing for the latter; and the limit from the nulls."""
    inside = [c for e in taken for c in asked.columns[e]]
    projected, rest = _beside(gram, n, k, inside)
    single = projected.scores() ** 2
    single[np.diag(projected.B) <= SEEN * projected.raw] = 0.0
    gains = np.zeros((len(asked.events), projected.b.shape[1]))
    for e, columns in enumerate(asked.columns):
        if e not in taken:
            at = [rest[c] for c in columns]
            gains[e] = single[at[0]] if len(at) == 1 else _gains(projected, at)
    scores = equivalent(
        gains, np.array([len(c) for c in asked.columns]), [(e.kind, e.channel, e.air) for e in asked.events]
    )
    return scores[:, 0], gains[:, 0], event_limit(scores[:, 1:].max(axis=0), criteria)


def _without(round_: Round, asked: Asked, sizes: Mapping[int, float]) -> Round | None:
    """The round with the events taken out of what was measured and the base fitted again; None where that runs away."""
    problem, found = round_.baseline.problem, round_.baseline.fit
    z = [r.z for r in problem.records]
    for c, size in sizes.items():
        z[asked.owners[c]] = z[asked.owners[c]] - size * asked.changes[c]
    records = tuple(replace(r, z=own) for r, own in zip(problem.records, z, strict=True))
    cleared = replace(problem, records=records)
    again = fit(cleared, found.values, found.locals)
    return None if again.diverged else replace(round_, baseline=replace(round_.baseline, problem=cleared, fit=again))


def event_limit(largest: Array, criteria: Criteria) -> float:
    """Score from which something happened, from the largest score of every null: as for any nameless rest."""
    return criteria.unknown_margin * upper_quantile(largest, criteria.nameless_level)


def equivalent(gains: Array, unknowns: Array, groups: Sequence[Hashable]) -> Array:
    """(events, 1 + nulls) |z| of one unknown as improbable as gains of so many, scattered as on the nulls or more widely.

    The scatter is that of a whole group of events: one instant's own is known from the nulls to a tenth, by which a neighbour
    would be taken for it.
    """
    own = gains[:, 1:].mean(axis=1) / unknowns
    pooled = {g: max(float(np.mean([o for o, h in zip(own, groups, strict=True) if h == g])), 1.0) for g in set(groups)}
    inflation = np.array([pooled[g] for g in groups])
    tail = chi2.logsf(gains / inflation[:, None], unknowns[:, None])
    return np.asarray(norm.isf(0.5 * np.exp(np.maximum(tail, SMALLEST_TAIL))))


def _beside(gram: Array, n: int, k: int, inside: Sequence[int]) -> tuple[Projected, dict[int, int]]:
    """Columns and residuals with the shared parameters and the events already taken projected out; column -> where it is now."""
    out = [c for c in range(k) if c not in set(inside)]
    order = np.array([*range(n), *(n + c for c in inside), *(n + c for c in out), *range(n + k, len(gram))])
    return Projected.of(gram[np.ix_(order, order)], n + len(inside), len(out)), {c: j for j, c in enumerate(out)}


def _gains(projected: Projected, columns: Sequence[int]) -> Array:
    """(residual columns,) gain of an event; nothing where the base absorbs it."""
    B = projected.B[np.ix_(columns, columns)]
    if (np.diag(B) <= SEEN * projected.raw[columns]).any():
        return np.zeros(projected.b.shape[1])
    return projected.gains(columns, slice(0, projected.b.shape[1]))


def _estimates(gram: Array, n: int, k: int, inside: Sequence[int]) -> list[tuple[float, float]]:
    """Sizes of the events taken with their bounds, fitted together."""
    if not inside:
        return []
    projected, _ = _beside(gram, n, k, [])
    B = projected.B[np.ix_(inside, inside)]
    size, bound = solved(B, projected.b[inside, 0]), np.sqrt(np.diag(np.linalg.pinv(B, hermitian=True)))
    return list(zip(size.tolist(), bound.tolist(), strict=True))
