"""Events in time, which no term of the motion explains: an instrument that drifts or slips, a burst, a gust.

Four families: a ramp in an output (with its own slope on every flight), a step in an output of one flight, a disturbance of all
force equations over a stretch of one flight, and a gust there: its effect on the rate of a flow angle or of airspeed reverses as
it goes. They are scored by linear theory with everything the base can absorb projected out, calibrated on the same nulls as
everything else, and selected one after the other.
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
from estimation.gap.significance.screen import SEEN, SMALLEST_TAIL, shared_prior
from estimation.gap.significance.tangent import (
    AT_ONCE,
    RecordTangent,
    Tangent,
    TangentColumns,
    is_door,
    output_changes,
)

SPACING = 0.5  # s between trial instants of a step: between two of them a twentieth of the gain is lost
STRETCHES = (1.0, 3.0)  # s, lengths of disturbances; they start at every third of their length
MOST = 6  # events
AIR = frozenset(DISTURBANCE.format(s) for s in ("V", "alpha", "beta"))  # of motion relative to the air
FEWEST = 4  # samples to either side of a step


class EventKind(StrEnum):
    """Kinds of events."""

    DRIFT = "drift"
    SLIP = "slip"
    BURST = "burst"


@dataclass(frozen=True)
class TransientEvent:
    """An event. channel: the output, or "" for a disturbance of the motion. record: its index; -1 for a drift, which may be in
    all. start, end: s on the flight's clock. air: the state that a gust changes."""

    kind: EventKind
    channel: str
    record: int
    start: float
    end: float
    air: str = ""


@dataclass(frozen=True)
class DetectedEvent:
    """A significant event. score, threshold: as of a nameless signal. sizes: (estimate, bound) of its columns: the change over
    each record by a drift, the step of a slip, the peak rates added by a burst."""

    event: TransientEvent
    score: float
    threshold: float
    sizes: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Transients:
    """The significant events, highest score first, and the round without them; None where its fit runs away."""

    events: tuple[DetectedEvent, ...]
    cleared: Round | None


class Course(StrEnum):
    """Time histories of the columns of events."""

    RAMP = "ramp"
    STEP = "step"
    SWELL = "swell"  # half a sine
    REVERSAL = "reversal"  # half a cosine: the rate of a swell


@dataclass(frozen=True)
class EventColumn:
    """One unknown of an event. record: the only record with it; place: an output, or a door of the motion."""

    record: int
    place: str
    course: Course
    start: float
    end: float

    def over(self, time: Array) -> Array:
        """(N,) the course of unit size along a record."""
        if self.course is Course.STEP:
            return np.asarray(time >= self.start, dtype=float)
        share = np.clip((time - self.start) / (self.end - self.start), 0.0, 1.0)
        if self.course is Course.RAMP:
            return share
        if self.course is Course.SWELL:
            return np.sin(np.pi * share)
        return np.where((share > 0.0) & (share < 1.0), np.cos(np.pi * share), 0.0)


@dataclass(frozen=True)
class PossibleEvents:
    """Events with their columns. members: of every event, indices of its columns; columns: of all events."""

    events: tuple[TransientEvent, ...]
    members: tuple[tuple[int, ...], ...]
    columns: tuple[EventColumn, ...]

    def in_record(self, members: Sequence[int], index: int) -> list[int]:
        """Those of some columns that belong to a record."""
        return [c for c in members if self.columns[c].record == index]


def possible_events(problem: LikelihoodProblem) -> PossibleEvents:
    """Every event that these records could show."""
    events: list[TransientEvent] = []
    members: list[tuple[int, ...]] = []
    columns: list[EventColumn] = []

    def add_event(event: TransientEvent, event_columns: Sequence[EventColumn]) -> None:
        events.append(event)
        members.append(tuple(range(len(columns), len(columns) + len(event_columns))))
        columns.extend(event_columns)

    times = [segment.time for segment in problem.coarse]
    for name in problem.model.output_names:
        ends = [(i, float(time[0]), float(time[-1])) for i, time in enumerate(times)]
        ramps = [EventColumn(i, name, Course.RAMP, a, b) for i, a, b in ends]
        add_event(TransientEvent(EventKind.DRIFT, name, -1, *ends[0][1:]), ramps)
        for i, time in enumerate(times):
            for start in np.arange(time[FEWEST], time[-FEWEST], SPACING):
                span = (float(start), float(time[-1]))
                add_event(TransientEvent(EventKind.SLIP, name, i, *span), [EventColumn(i, name, Course.STEP, *span)])
    doors = [n for n in problem.model.input_names if is_door(n)]
    for i, time in enumerate(times if doors else ()):
        for width in STRETCHES:
            for start in np.arange(time[0], time[-1] - width, width / 3.0):
                span = (float(start), float(start + width))
                swells = [EventColumn(i, d, Course.SWELL, *span) for d in doors]
                add_event(TransientEvent(EventKind.BURST, "", i, *span), swells)
                for d in (d for d in doors if d in AIR):
                    gust = TransientEvent(EventKind.BURST, "", i, *span, air=d.removeprefix(DISTURBANCE.format("")))
                    add_event(gust, [EventColumn(i, d, Course.REVERSAL, *span)])
    return PossibleEvents(tuple(events), tuple(members), tuple(columns))


@dataclass(frozen=True)
class Products:
    """Inner products of [shared unknowns | columns of events | residuals of data and nulls], without those never needed.

    n: shared unknowns. outer: (n + m, n + m) of these and the residuals, with priors; across: (columns, n + m) of every column
    with them; raw: (columns,) of each with itself; within: of every event with several columns, these with each other. A column
    is zero in all records but one: the complete matrix would grow with the square of the flight time.
    """

    tangent: Tangent
    possible: PossibleEvents
    n: int
    outer: Array
    across: Array
    raw: Array
    within: Mapping[int, Array]

    @classmethod
    def of(cls, possible: PossibleEvents, tangent: Tangent) -> "Products":
        problem = tangent.problem
        n, m, count = len(problem.free), 1 + len(tangent.nulls), len(possible.columns)
        outer, across, raw = shared_prior(problem, tangent.fit, n + m, 0), np.zeros((count, n + m)), np.zeros(count)
        several = {e: members for e, members in enumerate(possible.members) if len(members) > 1}
        within = {e: np.zeros((len(members),) * 2) for e, members in several.items()}
        for i in range(len(problem.records)):
            record = tangent.record(i)
            outer += record.gram
            for here, columns in _columns_in(record, tangent.fit, possible):
                across[here], raw[here] = record.products(columns, record.fixed), record.squares(columns)
                position = {c: j for j, c in enumerate(here)}
                for e, members in several.items():
                    present = [j for j, c in enumerate(members) if c in position]
                    if present:
                        event_columns = columns.some([position[members[j]] for j in present])
                        within[e][np.ix_(present, present)] += record.products(event_columns, event_columns)
        return cls(tangent, possible, n, outer, across, raw, within)

    def rows(self, event: int) -> dict[int, Array]:
        """Column of an event -> (columns,) its products with all columns."""
        rows: dict[int, Array] = {}
        members = self.possible.members[event]
        for i in dict.fromkeys(self.possible.columns[c].record for c in members):
            present, record = self.possible.in_record(members, i), self.tangent.record(i)
            event_columns = _whitened(record, self.tangent.fit, self.possible, present)
            rows |= {c: np.zeros(len(self.possible.columns)) for c in present}
            for here, columns in _columns_in(record, self.tangent.fit, self.possible):
                for c, row in zip(present, record.products(event_columns, columns), strict=True):
                    rows[c][here] = row
        return rows


def _columns_in(
    record: RecordTangent, model_fit: ModelFit, possible: PossibleEvents
) -> Iterator[tuple[list[int], TangentColumns]]:
    """Indices of the columns of events in a record, and these whitened: so many events at a time as fit in a small memory."""
    here: list[int] = []
    for members in possible.members:
        here += possible.in_record(members, record.index)
        if len(here) >= AT_ONCE:
            yield here, _whitened(record, model_fit, possible, here)
            here = []
    yield here, _whitened(record, model_fit, possible, here)


def _whitened(
    record: RecordTangent, model_fit: ModelFit, possible: PossibleEvents, columns: Sequence[int]
) -> TangentColumns:
    """Some of the columns of events, whitened; columns: their indices, all of this record."""
    return record.columns(_changes(record.problem, model_fit, record.index, [possible.columns[c] for c in columns]))


def _changes(
    problem: LikelihoodProblem, model_fit: ModelFit, index: int, columns: Sequence[EventColumn]
) -> Iterator[Array]:
    """(N, ny) changes of the outputs of a record by unit size of each of its columns."""
    time = problem.coarse[index].time
    return output_changes(problem, model_fit, index, [(c.place, c.over(time)) for c in columns])


@dataclass(frozen=True)
class ProjectedColumns:
    """All columns with the shared unknowns and the columns of some events projected out. square: (columns,) squared length of
    each; b: (columns, residuals) products; within: of every event with several columns, these with each other."""

    square: Array
    b: Array
    within: Mapping[int, Array]

    @classmethod
    def of(cls, products: Products, removed: list[int], rows: Mapping[int, Array]) -> "ProjectedColumns":
        """removed: columns that are projected out; rows: their products with all."""
        n, across = products.n, products.across
        right = np.concatenate([products.outer[:n, n:], across[removed, n:]])
        base = np.concatenate([products.outer[:n, :n], across[removed, :n]])
        cross = np.column_stack([across[:, :n], *(rows[c] for c in removed)])  # (columns, n + removed)
        square = np.column_stack([base, np.concatenate([across[removed, :n].T, cross[removed, n:]])])
        solution = solved(square, np.concatenate([cross.T, right], axis=1))
        column_part, residual_part = solution[:, : len(cross)], solution[:, len(cross) :]
        within = {}
        for e, gram in products.within.items():
            members = list(products.possible.members[e])
            within[e] = gram - cross[members] @ column_part[:, members]
        return cls(products.raw - np.sum(cross * column_part.T, axis=1), across[:, n:] - cross @ residual_part, within)


def find_transients(round_: Round) -> Transients:
    """Events selected one after the other while one is significant, each projected out before the next search; events that are no
    longer significant beside the later ones are dropped in the end."""
    possible = possible_events(round_.baseline.problem)
    products, criteria = Products.of(possible, round_.tangent), round_.criteria
    rows: dict[int, Array] = {}
    selected: list[int] = []
    for _ in range(MOST):
        scores, limit = _scored(products, selected, rows, criteria)
        leader = int(np.argmax(scores))
        if scores[leader] <= limit:
            break
        selected.append(leader)
        rows |= products.rows(leader)
    for e in list(selected):
        remaining = [o for o in selected if o != e]
        scores, limit = _scored(products, remaining, rows, criteria)
        if scores[e] <= limit:
            selected = remaining
    detected = []
    members = [c for e in selected for c in possible.members[e]]
    estimates = dict(zip(members, _estimates(products, members, rows), strict=True))
    for e in selected:
        scores, limit = _scored(products, [o for o in selected if o != e], rows, criteria)
        sizes = tuple(estimates[c] for c in possible.members[e])
        detected.append(DetectedEvent(possible.events[e], float(scores[e]), limit, sizes))
    detected.sort(key=lambda f: -f.score)
    cleared = _without(round_, possible, {c: v for c, (v, _) in estimates.items()}) if detected else round_
    return Transients(tuple(detected), cleared)


def _scored(
    products: Products, selected: Sequence[int], rows: Mapping[int, Array], criteria: Criteria
) -> tuple[Array, float]:
    """(events,) scores of all events beside those selected, zero for these; and the limit from the nulls."""
    possible = products.possible
    projected = ProjectedColumns.of(products, [c for e in selected for c in possible.members[e]], rows)
    visible = projected.square > SEEN * products.raw
    single = np.where(visible[:, None], projected.b**2 / np.where(visible, projected.square, 1.0)[:, None], 0.0)
    gains = np.zeros((len(possible.events), projected.b.shape[1]))
    for e, members in enumerate(possible.members):
        if e not in selected:
            gains[e] = single[members[0]] if len(members) == 1 else _gains(products, projected, e)
    unknowns = np.array([len(c) for c in possible.members])
    scores, largest = standing_out(gains, unknowns, [(e.kind, e.channel, e.air) for e in possible.events])
    return scores, unknown_above(largest, criteria)


def _without(round_: Round, possible: PossibleEvents, sizes: Mapping[int, float]) -> Round | None:
    """The round with columns of events subtracted from the measurements and the base refitted; None where that runs away."""
    problem, model_fit = round_.baseline.problem, round_.baseline.fit
    z = [r.z for r in problem.records]
    for c, size in sizes.items():
        i = possible.columns[c].record
        z[i] = z[i] - size * next(_changes(problem, model_fit, i, [possible.columns[c]]))
    records = tuple(replace(r, z=outputs) for r, outputs in zip(problem.records, z, strict=True))
    cleared = replace(problem, records=records)
    refitted = fit(cleared, model_fit.values, model_fit.locals)
    if refitted.diverged:
        return None
    baseline = replace(round_.baseline, problem=cleared, fit=refitted)
    return replace(round_, baseline=baseline, tangent=Tangent(cleared, refitted, round_.null_residuals))


def standing_out(gains: Array, unknowns: Array, groups: Sequence[Hashable]) -> tuple[Array, Array]:
    """(events,) scores of the data and (nulls,) largest score of every null, from gains (events, 1 + nulls) of events with so
    many unknowns, in units of their scatter on the nulls, at least 1.

    The scatter is that of a group of events: for a single instant the nulls give it to a tenth only, which would prefer a
    neighbour of the true instant.
    """
    scatters = gains[:, 1:].mean(axis=1) / unknowns
    pooled = {
        g: max(float(np.mean([o for o, h in zip(scatters, groups, strict=True) if h == g])), 1.0) for g in set(groups)
    }
    scaled = gains / np.array([pooled[g] for g in groups])[:, None]
    # with equal unknowns the largest gain is the largest score
    largest = [equivalent(scaled[unknowns == k, 1:].max(axis=0), np.array(k)) for k in np.unique(unknowns)]
    return equivalent(scaled[:, 0], unknowns), np.asarray(np.max(largest, axis=0))


def equivalent(gains: Array, unknowns: Array) -> Array:
    """|z| of one unknown that is as improbable as gains of so many unknowns."""
    return np.asarray(-ndtri(0.5 * np.maximum(chdtrc(unknowns, gains), SMALLEST_TAIL)))


def _gains(products: Products, projected: ProjectedColumns, event: int) -> Array:
    """(residual columns,) gain of an event with several columns; zero where the base absorbs one."""
    members, B = list(products.possible.members[event]), projected.within[event]
    b = projected.b[members]
    if (np.diag(B) <= SEEN * products.raw[members]).any():
        return np.zeros(b.shape[1])
    return np.asarray(np.sum(b * solved(B, b), axis=0))


def _estimates(products: Products, members: list[int], rows: Mapping[int, Array]) -> list[tuple[float, float]]:
    """(size, bound) of these columns, fitted together."""
    if not members:
        return []
    n = products.n
    cross, right = products.across[members, :n], products.outer[:n, n]
    solution = solved(products.outer[:n, :n], np.concatenate([cross.T, right[:, None]], axis=1))
    B = np.array([rows[c][members] for c in members]) - cross @ solution[:, :-1]
    b = products.across[members, n] - cross @ solution[:, -1]
    size, bound = solved(B, b), np.sqrt(np.diag(np.linalg.pinv(B, hermitian=True)))
    return list(zip(size.tolist(), bound.tolist(), strict=True))
