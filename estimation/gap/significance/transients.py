"""Is what is left a matter of time and not of the motion: an instrument that drifts or slips, weather that bursts?

Four families: a ramp in an output (own slope on every flight), a step in an output of one flight at some instant, a disturbance
of all force equations over a stretch of one flight, and a gust that comes and goes there: what it does to the rate of an angle
or a speed of the air it takes back. They are scored by linear theory with everything the base can absorb
projected out, calibrated on the same nulls as all else, and taken one after the other.
"""

from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from scipy.special import chdtrc, ndtri

from estimation.engine.kernel import Array
from estimation.estimators.normal_equations import solved
from estimation.gap.criteria import Criteria
from estimation.gap.fit.fitting import fit
from estimation.gap.fit.problem import LikelihoodProblem, ModelFit
from estimation.gap.records.candidate_model import DISTURBANCE
from estimation.gap.significance.calibration import Round, unknown_above
from estimation.gap.significance.screen import SEEN, SMALLEST_TAIL, TINY, shared_prior
from estimation.gap.significance.tangent import Tangent, is_door, through_doors

EVERY = 0.5  # s between the instants at which a step is looked for: a twentieth of the gain is lost between two of them
STRETCHES = (1.0, 3.0)  # s, of disturbances; each begins a third of it after the one before
MOST = 6  # taken one after the other
AIR = frozenset(DISTURBANCE.format(s) for s in ("V", "alpha", "beta"))  # motion through the air, which a gust moves
FEWEST = 4  # samples to either side of a step


class EventKind(StrEnum):
    """What changes with time alone."""

    DRIFT = "drift"
    SLIP = "slip"
    BURST = "burst"


@dataclass(frozen=True)
class TransientEvent:
    """One happening. channel: the output, or "" for a disturbance of the motion. record: in which; -1 for a drift, which may be
    in all. start, end: s on the flight's clock. air: of a gust the state that it moves."""

    kind: EventKind
    channel: str
    record: int
    start: float
    end: float
    air: str = ""


@dataclass(frozen=True)
class DetectedEvent:
    """An event taken. score, threshold: as of a nameless signal. gain: twice the log-likelihood. sizes: estimates of its columns
    with bounds: of a drift the change over each record, of a slip the step, of a burst the peak rates that it adds."""

    event: TransientEvent
    score: float
    threshold: float
    gain: float
    sizes: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Transients:
    """All events taken, the one that stands out most first, and the round without what they did; None where that runs away."""

    found: tuple[DetectedEvent, ...]
    cleared: Round | None


class Course(StrEnum):
    """What one column of an event does while it lasts."""

    RAMP = "ramp"
    STEP = "step"
    SWELL = "swell"  # half a sine
    TURN = "turn"  # half a cosine, the rate of one


@dataclass(frozen=True)
class EventColumn:
    """One unknown of an event. record: the only one that shows it; place: an output, or a door of the motion."""

    record: int
    place: str
    course: Course
    start: float
    end: float

    def over(self, time: Array) -> Array:
        """(N,) the course along a record, of unit size."""
        if self.course is Course.STEP:
            return np.asarray(time >= self.start, dtype=float)
        share = np.clip((time - self.start) / (self.end - self.start), 0.0, 1.0)
        if self.course is Course.RAMP:
            return share
        if self.course is Course.SWELL:
            return np.sin(np.pi * share)
        return np.where((share > 0.0) & (share < 1.0), np.cos(np.pi * share), 0.0)


@dataclass(frozen=True)
class Asked:
    """Events with their columns. inside: of every event, which; columns: of all events."""

    events: tuple[TransientEvent, ...]
    inside: tuple[tuple[int, ...], ...]
    columns: tuple[EventColumn, ...]

    def showing_in(self, record: int) -> list[int]:
        """The columns that show in a record."""
        return [c for c, column in enumerate(self.columns) if column.record == record]


def asked_of(problem: LikelihoodProblem) -> Asked:
    """Every event that these records could show."""
    events: list[TransientEvent] = []
    members: list[tuple[int, ...]] = []
    columns: list[EventColumn] = []

    def put(event: TransientEvent, made: Sequence[EventColumn]) -> None:
        events.append(event)
        members.append(tuple(range(len(columns), len(columns) + len(made))))
        columns.extend(made)

    times = [segment.time for segment in problem.coarse]
    for name in problem.model.output_names:
        ends = [(i, float(time[0]), float(time[-1])) for i, time in enumerate(times)]
        put(
            TransientEvent(EventKind.DRIFT, name, -1, *ends[0][1:]),
            [EventColumn(i, name, Course.RAMP, a, b) for i, a, b in ends],
        )
        for i, time in enumerate(times):
            for begin in np.arange(time[FEWEST], time[-FEWEST], EVERY):
                span = (float(begin), float(time[-1]))
                put(TransientEvent(EventKind.SLIP, name, i, *span), [EventColumn(i, name, Course.STEP, *span)])
    doors = [n for n in problem.model.input_names if is_door(n)]
    for i, time in enumerate(times if doors else ()):
        for width in STRETCHES:
            for begin in np.arange(time[0], time[-1] - width, width / 3.0):
                span = (float(begin), float(begin + width))
                put(
                    TransientEvent(EventKind.BURST, "", i, *span),
                    [EventColumn(i, d, Course.SWELL, *span) for d in doors],
                )
                for d in (d for d in doors if d in AIR):
                    air = d.removeprefix(DISTURBANCE.format(""))
                    put(TransientEvent(EventKind.BURST, "", i, *span, air=air), [EventColumn(i, d, Course.TURN, *span)])
    return Asked(tuple(events), tuple(members), tuple(columns))


@dataclass(frozen=True)
class Products:
    """Inner products of [shared | columns | residuals of data and nulls], without what is never asked of them.

    n: shared unknowns. outer: (n + m, n + m) of these and the residuals, with priors; across: (columns, n + m) of every column
    with them; raw: (columns,) of each with itself; own: of every event with several columns, these with each other. A column
    shows in one record and meets no other record's: the whole matrix would grow with the square of the time flown.
    """

    tangent: Tangent
    asked: Asked
    n: int
    outer: Array
    across: Array
    raw: Array
    own: Mapping[int, Array]

    @classmethod
    def of(cls, asked: Asked, tangent: Tangent) -> "Products":
        problem, model_fit = tangent.problem, tangent.fit
        n, m, count = len(problem.free), 1 + len(tangent.nulls), len(asked.columns)
        outer, across, raw = shared_prior(problem, model_fit, n + m, 0), np.zeros((count, n + m)), np.zeros(count)
        several = {e: columns for e, columns in enumerate(asked.inside) if len(columns) > 1}
        within_events = {e: np.zeros((len(columns),) * 2) for e, columns in several.items()}
        for i in range(len(problem.records)):
            record, local_columns = tangent.record(i), asked.showing_in(i)
            columns = record.columns(list(_changes(problem, model_fit, i, asked, local_columns)))
            outer += record.gram
            across[local_columns], raw[local_columns] = record.products(columns, record.fixed), record.squares(columns)
            position = {c: j for j, c in enumerate(local_columns)}
            for e, members in several.items():
                local_members = [j for j, c in enumerate(members) if c in position]
                if local_members:
                    member_columns = columns.some([position[members[j]] for j in local_members])
                    within_events[e][np.ix_(local_members, local_members)] += record.products(
                        member_columns, member_columns
                    )
        return cls(tangent, asked, n, outer, across, raw, within_events)

    def rows(self, event: int) -> dict[int, Array]:
        """Of every column of an event its products (columns,) with all."""
        rows: dict[int, Array] = {}
        columns, problem, model_fit = self.asked.inside[event], self.tangent.problem, self.tangent.fit
        for i in dict.fromkeys(self.asked.columns[c].record for c in columns):
            record, local_columns = self.tangent.record(i), self.asked.showing_in(i)
            all_here = record.columns(list(_changes(problem, model_fit, i, self.asked, local_columns)))
            position = {c: j for j, c in enumerate(local_columns)}
            local_members = [c for c in columns if c in position]
            for c, row in zip(
                local_members,
                record.products(all_here.some([position[c] for c in local_members]), all_here),
                strict=True,
            ):
                rows[c] = np.zeros(len(self.asked.columns))
                rows[c][local_columns] = row
        return rows


def _changes(
    problem: LikelihoodProblem, found: ModelFit, index: int, asked: Asked, columns: Sequence[int]
) -> Iterator[Array]:
    """(N, ny) changes of the outputs of a record by unit size of some columns in it."""
    z, outputs, time = problem.coarse[index].z, problem.model.output_names, problem.coarse[index].time
    requested = [asked.columns[c] for c in columns]
    door_changes = through_doors(
        problem, found, index, [(c.place, c.over(time)) for c in requested if c.place not in outputs]
    )
    for column in requested:
        if column.place in outputs:
            yield _in_output(z, outputs.index(column.place), column.over(time))
        else:
            yield next(door_changes)


def _in_output(z: Array, column: int, course: Array) -> Array:
    change = np.zeros_like(z)
    change[:, column] = course
    return change


@dataclass(frozen=True)
class ProjectedColumns:
    """All columns with the shared unknowns and some events' columns projected out. square: (columns,) what is left of each;
    b: (columns, residuals); own: of every event with several columns, these with each other."""

    square: Array
    b: Array
    own: Mapping[int, Array]

    @classmethod
    def of(cls, products: Products, taken: Sequence[int], rows: Mapping[int, Array]) -> "ProjectedColumns":
        """taken: columns that are projected out; rows: their products with all."""
        n, across, removed = products.n, products.across, list(taken)
        right = np.concatenate([products.outer[:n, n:], across[removed, n:]])
        base = np.concatenate([products.outer[:n, :n], across[removed, :n]])
        cross = np.column_stack([across[:, :n], *(rows[c] for c in removed)])  # (columns, n + taken)
        square = np.column_stack([base, np.concatenate([across[removed, :n].T, cross[removed, n:]])])
        solution = solved(square, np.concatenate([cross.T, right], axis=1))
        column_part, rest = solution[:, : len(cross)], solution[:, len(cross) :]
        several = {e: list(products.asked.inside[e]) for e in products.own}
        within_events = {
            e: products.own[e] - cross[members] @ column_part[:, members] for e, members in several.items()
        }
        return cls(products.raw - np.sum(cross * column_part.T, axis=1), across[:, n:] - cross @ rest, within_events)


def find_transients(round_: Round) -> Transients:
    """Events one after the other as long as one stands out of the nulls, each projected out before the next is looked for; then
    those that the later ones have made idle are dropped."""
    events = asked_of(round_.baseline.problem)
    products, criteria = Products.of(events, round_.tangent), round_.criteria
    rows: dict[int, Array] = {}
    selected: list[int] = []
    for _ in range(MOST):
        scores, gains, limit = _scored(products, selected, rows, criteria)
        leader = int(np.argmax(scores))
        if scores[leader] <= limit:
            break
        selected.append(leader)
        rows |= products.rows(leader)
    for e in list(selected):
        remaining = [o for o in selected if o != e]
        scores, _, limit = _scored(products, remaining, rows, criteria)
        if scores[e] <= limit:
            selected = remaining
    detected = []
    members = [c for e in selected for c in events.inside[e]]
    estimates = dict(zip(members, _estimates(products, members, rows), strict=True))
    for e in selected:
        scores, gains, limit = _scored(products, [o for o in selected if o != e], rows, criteria)
        sizes = tuple(estimates[c] for c in events.inside[e])
        detected.append(DetectedEvent(events.events[e], float(scores[e]), limit, float(gains[e]), sizes))
    detected.sort(key=lambda f: -f.score)
    return Transients(
        tuple(detected), _without(round_, events, {c: v for c, (v, _) in estimates.items()}) if detected else round_
    )


def _scored(
    products: Products, taken: Sequence[int], rows: Mapping[int, Array], criteria: Criteria
) -> tuple[Array, Array, float]:
    """(events,) scores and gains of all events beside those taken, nothing for the latter; and the limit from the nulls."""
    events = products.asked
    projected = ProjectedColumns.of(products, [c for e in taken for c in events.inside[e]], rows)
    single = projected.b**2 / np.maximum(projected.square, TINY)[:, None]
    single[projected.square <= SEEN * products.raw] = 0.0
    gains = np.zeros((len(events.events), projected.b.shape[1]))
    for e, columns in enumerate(events.inside):
        if e not in taken:
            gains[e] = single[columns[0]] if len(columns) == 1 else _gains(products, projected, e)
    unknowns = np.array([len(c) for c in events.inside])
    scores, largest = standing_out(gains, unknowns, [(e.kind, e.channel, e.air) for e in events.events])
    return scores, gains[:, 0], unknown_above(largest, criteria)


def _without(round_: Round, asked: Asked, sizes: Mapping[int, float]) -> Round | None:
    """The round with the events taken out of what was measured and the base fitted again; None where that runs away."""
    problem, model_fit = round_.baseline.problem, round_.baseline.fit
    z = [r.z for r in problem.records]
    for c, size in sizes.items():
        i = asked.columns[c].record
        z[i] = z[i] - size * next(_changes(problem, model_fit, i, asked, [c]))
    records = tuple(replace(r, z=outputs) for r, outputs in zip(problem.records, z, strict=True))
    cleared = replace(problem, records=records)
    refitted = fit(cleared, model_fit.values, model_fit.locals)
    if refitted.diverged:
        return None
    baseline = replace(round_.baseline, problem=cleared, fit=refitted)
    return replace(round_, baseline=baseline, tangent=Tangent(cleared, refitted, round_.null_residuals))


def standing_out(gains: Array, unknowns: Array, groups: Sequence[Hashable]) -> tuple[Array, Array]:
    """(events,) scores of the data and (nulls,) largest score of every null, of gains (events, 1 + nulls) of events with so many
    unknowns, scattered as on the nulls or more widely.

    The scatter is that of a whole group of events: one instant's own is known from the nulls to a tenth, by which a neighbour
    would be taken for it.
    """
    scatters = gains[:, 1:].mean(axis=1) / unknowns
    pooled = {
        g: max(float(np.mean([o for o, h in zip(scatters, groups, strict=True) if h == g])), 1.0) for g in set(groups)
    }
    scaled = gains / np.array([pooled[g] for g in groups])[:, None]
    # of as many unknowns the largest gain is the largest score
    largest = [equivalent(scaled[unknowns == k, 1:].max(axis=0), np.array(k)) for k in np.unique(unknowns)]
    return equivalent(scaled[:, 0], unknowns), np.asarray(np.max(largest, axis=0))


def equivalent(gains: Array, unknowns: Array) -> Array:
    """|z| of one unknown as improbable as gains of so many."""
    return np.asarray(-ndtri(0.5 * np.maximum(chdtrc(unknowns, gains), SMALLEST_TAIL)))


def _gains(products: Products, beside: ProjectedColumns, event: int) -> Array:
    """(residual columns,) gain of an event of several columns; nothing where the base absorbs one."""
    columns, B = list(products.asked.inside[event]), beside.own[event]
    b = beside.b[columns]
    if (np.diag(B) <= SEEN * products.raw[columns]).any():
        return np.zeros(b.shape[1])
    return np.asarray(np.sum(b * solved(B, b), axis=0))


def _estimates(products: Products, inside: Sequence[int], rows: Mapping[int, Array]) -> list[tuple[float, float]]:
    """Sizes of the events taken with their bounds, fitted together."""
    if not inside:
        return []
    n, members = products.n, list(inside)
    cross, right = products.across[members, :n], products.outer[:n, n]
    solution = solved(products.outer[:n, :n], np.concatenate([cross.T, right[:, None]], axis=1))
    B = np.array([rows[c][members] for c in members]) - cross @ solution[:, :-1]
    b = products.across[members, n] - cross @ solution[:, -1]
    size, bound = solved(B, b), np.sqrt(np.diag(np.linalg.pinv(B, hermitian=True)))
    return list(zip(size.tolist(), bound.tolist(), strict=True))
