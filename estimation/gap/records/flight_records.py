"""Flight records: flights prepared once for every model the workflow tries.

De-noising the inputs is slow and does not depend on the hypothesis. So all inputs that any candidate could need are prepared
once, and a model then takes the columns it needs.

Long records are cut into stretches, each with its own initial state. Simulated from a single one, a slow mode that grows, or that
gusts drive, leaves the record after a minute or two even with the right model; and the work for a record (slow errors, events in
time) grows with the square of its length. The cuts are made where the controls rest, so that no step is cut.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from estimation.engine.kernel import Array
from estimation.engine.simulate import Segment
from estimation.gap.criteria import Criteria
from estimation.gap.effects.base import Effect, symbols_of
from estimation.gap.records.candidate_model import RATE_OF
from estimation.gap.records.sampling import command_times, unseen_paths
from estimation.models.base import Model, Signal
from estimation.prepare.flight_data import AS_USUAL, FlightData
from estimation.prepare.inputs import has_pitch_rate
from estimation.prepare.pipeline import prepare
from estimation.signals.controls import noise_between_steps, with_raw_steps
from estimation.signals.denoise import noise_level
from estimation.signals.rounding import Grid, near_edges
from groundstation.flight import Flight

NEAR = 0.1  # of a stretch, to either side of an even cut, in which the best cut is sought
ROUNDING = 1e-6
AROUND = 0.5  # s, to either side of a cut, in which the controls should rest
PATHS = 20  # seed of the paths across samples that a control lacks
QUIETEST = 1e-4  # of the scatter of a rate: a coarsely rounded rate shows no noise
TINY = 1e-12  # rad/s, noise of a rate that stands still
LOST = 0.005  # of the samples of a record may go unused
SMALL_PRIMES = (2, 3, 5, 7, 11)  # with fast steps in a Fourier transform


def stretches(segment: Segment, controls: list[int], criteria: Criteria) -> list[slice]:
    """Samples of a segment in stretches of about equal length, cut where the controls rest. controls: their columns in `u`."""
    count = len(segment)
    step = float(np.median(np.diff(segment.time)))
    parts = int(np.ceil((count - 1) * step / criteria.longest_record - ROUNDING))
    if parts < 2:
        return [slice(0, count)]
    motion = movement(segment.u[:, controls], max(round(AROUND / step), 1))
    length = count / parts
    cuts = [0]
    for k in range(1, parts):
        target = round(k * length)
        candidates = np.arange(max(target - int(NEAR * length), 1), min(target + int(NEAR * length), count - 1) + 1)
        cuts.append(int(min(candidates, key=lambda i: (motion[i], abs(i - target)))))
    return [slice(a, b) for a, b in zip(cuts, [*cuts[1:], count], strict=True)]


def movement(controls: Array, reach: int) -> Array:
    """(N,) range of the controls (N, controls) within `reach` samples of each sample, over their range in all, summed."""
    motion = np.zeros(len(controls))
    for course in controls.T:
        span = float(np.ptp(course))
        if span > 0.0:
            padded = np.pad(course, reach, mode="edge")
            windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1)
            motion += np.round(np.ptp(windows, axis=1) / span, 2)
    return motion


@dataclass(frozen=True)
class FlightRecord:
    """One unbroken stretch of one flight.

    flight: index of the flight. first: index of the first sample in it. inputs: name -> (N,) de-noised; z: (N, ny)
    measured outputs, NaN where not measured; x0: (nx,) guess of the initial state; both in the base model's order.
    input_noise: name -> standard deviation of the noise found on an input. louder: (ny,) variance of the outputs' white
    noise over the usual one, where this flight's is larger. raw: control -> (N,) whether its measured value is used unchanged.
    errors: input -> (draws, N) possible errors after its preparation; error_spectra: control -> (frequencies,) their variance per
    sample, once known. uncompared: (N, ny) measured outputs that are not compared, such as the repeats of a slow sensor; NaN
    elsewhere. states: (N, nx) measured states without their noise. follows: control -> (N,) the part of it that follows the
    motion, which de-noising keeps. restless: controls that never rest on some training flight; of all records alike.
    filtered: controls that never rest on this flight. grids: coarsely rounded control -> its levels.
    """

    flight: int
    first: int
    time: Array
    inputs: Mapping[str, Array]
    z: Array
    x0: Array
    input_noise: Mapping[str, float]
    louder: Array | None = None
    raw: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)
    errors: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)
    error_spectra: Mapping[str, Array] = field(default_factory=dict)
    uncompared: Array | None = None
    states: Array | None = None
    follows: Mapping[str, Array] = field(default_factory=dict)
    restless: frozenset[str] = frozenset()
    filtered: frozenset[str] = frozenset()
    grids: Mapping[str, Grid] = field(default_factory=dict)

    def __len__(self) -> int:
        return int(self.time.size)

    @property
    def interval(self) -> float:
        """Median interval of its samples [s]."""
        return float(np.median(np.diff(self.time)))

    @property
    def rows(self) -> slice:
        """Its samples in the flight."""
        return slice(self.first, self.first + len(self))

    def segment(self, model: Model, base: Model) -> Segment:
        """This record for `model`, a descendant of `base`; inputs that the record lacks are zero."""
        zeros = np.zeros(len(self))
        columns = [self.inputs.get(n, zeros) for n in model.input_names]
        u = np.column_stack(columns) if columns else np.zeros((len(self), 0))
        x0 = starting_state(model, dict(zip(base.state_names, self.x0, strict=True)))
        return Segment(self.first, self.time, np.ascontiguousarray(u), self.z, x0)


def starting_state(model: Model, known: Mapping[str, float]) -> Array:
    """(nx,) initial state of `model` from `known` states; the others start as their signal says, which may be at another
    state."""
    values = dict(known)
    for signal in model.states:
        start = values.get(signal.start, 0.0) if isinstance(signal.start, str) else float(signal.start or 0.0)
        values.setdefault(signal.name, start)
    return np.array([values[n] for n in model.state_names])


@dataclass(frozen=True)
class FlightRecords:
    """Records of all flights for one base model. names: of the flights; training, holdout: flight indices; available:
    symbols that a form may use; stale: outputs that repeat their last value in many samples; keeps_feedback: whether controls
    keep what follows the motion."""

    base: Model
    names: tuple[str, ...]
    records: tuple[FlightRecord, ...]
    training: tuple[int, ...]
    holdout: tuple[int, ...]
    available: frozenset[str]
    notes: tuple[str, ...]
    criteria: Criteria
    stale: tuple[str, ...] = ()
    keeps_feedback: bool = False

    def of(self, flights: Iterable[int]) -> tuple[FlightRecord, ...]:
        """Records of the named flights."""
        indices = set(flights)
        return tuple(r for r in self.records if r.flight in indices)


def prepare_flights(
    base: Model,
    effects: Sequence[Effect],
    training: Sequence[Flight],
    holdout: Sequence[Flight],
    criteria: Criteria,
    keep_feedback: bool = False,
) -> FlightRecords:
    """Prepare all flights for `base` and the inputs that `effects` may add to it.

    keep_feedback: controls keep what follows the motion and their measured steps, as those of a model that pitches always do.
    Raises MissingColumnError or DataError (one sentence) where a flight lacks what the base model needs.
    """
    flights = [*training, *holdout]
    extra: dict[str, Signal] = {}
    for signal in (s for effect in effects for form in effect.forms for s in form.inputs):
        extra.setdefault(signal.name, signal)
    symbols = symbols_of(base)
    usable = [s for s in extra.values() if s.name not in symbols and all(f.measured(s.source) for f in flights)]
    probe = base.plus(inputs=[replace(s, optional=False) for s in usable])
    controls = [i for i, s in enumerate(probe.inputs) if s.control]
    records: list[FlightRecord] = []
    notes: list[str] = []
    prepared = [prepare(probe, flight) for flight in flights]
    pitches = has_pitch_rate(base)
    restless = frozenset[str]().union(*(data.restless for data in prepared[: len(training)]))
    exact = keep_feedback or pitches or controls_outdo_gyros(probe, prepared[: len(training)], criteria)
    if exact and not pitches:
        prepared = [prepare(probe, flight, replace(AS_USUAL, every_axis=True)) for flight in flights]
    for index, (flight, data) in enumerate(zip(flights, prepared, strict=True)):
        notes += [f"{flight.name}: {note}" for note in data.notes]
        noise = {name: level for name, (level, _) in data.noise.items()}
        parts = [p for part in data.segments for p in _stretches(part, data.states, controls, criteria)]
        if len(parts) > len(data.segments):
            notes.append(f"{flight.name}: long records are fitted in stretches, {len(parts)} in all")
        for part in parts:
            length = quick_length(len(part))
            segment = replace(part, time=part.time[:length], u=part.u[:length], z=part.z[:length])
            inputs = {n: np.ascontiguousarray(segment.u[:, i]) for i, n in enumerate(probe.input_names)}
            controls_read = [s for s in base.inputs if s.name not in data.restless] if exact else ()
            raw, step_noise = _raw_steps(controls_read, flight, segment.first, inputs, noise, criteria, data.grids)
            level = {**noise, **step_noise}
            errors = _with_unseen_paths(probe, flight, segment, _draws(probe, data, segment, level), criteria)
            span = slice(segment.first, segment.first + length)
            follows = data.follows[span].T if data.follows is not None else ()
            records.append(
                FlightRecord(
                    index,
                    segment.first,
                    segment.time,
                    inputs,
                    segment.z,
                    segment.x0,
                    level,
                    raw=raw,
                    errors=errors,
                    uncompared=_not_compared(base, flight, segment),
                    states=data.states[span],
                    follows={s.name: f for s, f in zip(probe.inputs, follows, strict=False) if f.any()},
                    restless=restless,
                    filtered=data.restless,
                    grids=data.grids,
                )
            )
    return FlightRecords(
        base=base,
        names=tuple(f.name for f in flights),
        records=with_own_noise(records, len(training), criteria),
        training=tuple(range(len(training))),
        holdout=tuple(range(len(training), len(flights))),
        available=frozenset(symbols | {s.name for s in usable}),
        notes=tuple(notes),
        criteria=criteria,
        keeps_feedback=exact,
    )


def controls_outdo_gyros(model: Model, flights: Sequence[FlightData], criteria: Criteria) -> bool:
    """Whether the noise on a control, taken as a deflection, would turn the aircraft fast enough in one sample for the gyros to
    show.

    The gyros then also show what de-noising takes off a control that steers against the motion, and it looks like a late servo.
    From the change of each rate per sample, regressed on motion and controls; median over the flights.
    """
    rates = [i for i, s in enumerate(model.outputs) if s.name in RATE_OF.values()]
    ratios = [_loudest(model, part, flight, rates) for flight in flights for part in flight.segments]
    return are_loud(ratios, criteria)


def are_loud(ratios: Sequence[float], criteria: Criteria) -> bool:
    """Whether the median of the changes of a rate by a control's noise, over the noise of that rate, is large."""
    return bool(ratios) and float(np.median(ratios)) > criteria.loud_control


def _loudest(model: Model, part: Segment, flight: FlightData, rates: Sequence[int]) -> float:
    """Largest change of a rate by one standard deviation of a control's noise, over the noise of that rate."""
    controls = [i for i, s in enumerate(model.inputs) if s.control]
    levels = np.array([flight.noise.get(model.inputs[i].name, (0.0, 0.0))[0] for i in controls])
    motion = np.column_stack([part.u[:, controls], flight.states[part.rows], np.ones(len(part))])[:-1]
    change = np.diff(part.z[:, rates], axis=0)
    complete = np.isfinite(motion).all(axis=1) & np.isfinite(change).all(axis=1)
    if not rates or not controls or np.count_nonzero(complete) <= motion.shape[1]:
        return 0.0
    by_control = np.linalg.lstsq(motion[complete], change[complete], rcond=None)[0][: len(controls)]
    noise = np.array([noise_level(part.z[:, i]) for i in rates])
    quiet = np.maximum(noise, QUIETEST * np.nanstd(part.z[:, rates], axis=0))
    return float(np.max(levels[:, None] * np.abs(by_control) / np.maximum(quiet, TINY)))


def _stretches(segment: Segment, states: Array, controls: list[int], criteria: Criteria) -> list[Segment]:
    """The segment, or the stretches of a long one. states: (samples, nx) of the flight, from which a stretch starts."""
    segments = []
    for part in stretches(segment, controls, criteria):
        first = segment.first + part.start
        x0 = segment.x0 if part.start == 0 else np.where(np.isfinite(states[first]), states[first], segment.x0)
        segments.append(Segment(first, segment.time[part], segment.u[part], segment.z[part], x0))
    return segments


def quick_length(count: int) -> int:
    """Samples of a record that are used: the largest product of small primes within one in two hundred of `count`.

    The Fourier transform of a prime number of samples takes five times as long.
    """
    for length in range(count, count - int(LOST * count) - 1, -1):
        factor = length
        for prime in SMALL_PRIMES:
            while factor % prime == 0:
                factor //= prime
        if factor == 1:
            return length
    return count


def _raw_steps(
    signals: Sequence[Signal],
    flight: Flight,
    first: int,
    inputs: dict[str, Array],
    noise: Mapping[str, float],
    criteria: Criteria,
    grids: Mapping[str, Grid],
) -> tuple[dict[str, NDArray[np.bool_]], dict[str, float]]:
    """Put the measured values of the controls among `signals` near their steps into `inputs`. Returns for each control (N,)
    where, and the noise between the steps. grids: of the coarsely rounded controls."""
    masks, levels = {}, {}
    for signal in signals:
        level = noise.get(signal.name, 0.0)
        if signal.control and level > 0.0 and flight.measured(signal.source):
            measured = flight.columns[signal.source][first : first + inputs[signal.name].size]
            interval = flight.sample_interval
            near = near_edges(measured, grids.get(signal.name), interval)
            inputs[signal.name], masks[signal.name] = with_raw_steps(
                inputs[signal.name], near, level, criteria.surface_step, interval
            )
            levels[signal.name] = noise_between_steps(measured, masks[signal.name], level)
    return masks, levels


def _not_compared(base: Model, flight: Flight, segment: Segment) -> Array:
    """(N, ny) measured outputs where the segment has none to compare; NaN elsewhere."""
    values = np.full(segment.z.shape, np.nan)
    for i, signal in enumerate(base.outputs):
        if flight.measured(signal.source):
            measured = flight.columns[signal.source][segment.first : segment.first + len(segment)]
            values[:, i] = np.where(np.isnan(segment.z[:, i]), measured, np.nan)
    return values


def _draws(
    model: Model, data: FlightData, segment: Segment, level: Mapping[str, float]
) -> dict[str, NDArray[np.float32]]:
    """(draws, N) possible errors of each input of a segment, scaled to its noise `level`."""
    if data.errors is None:
        return {}
    errors = data.errors[segment.first : segment.first + len(segment)]
    share = {n: np.float32(level[n] / noise) for n, (noise, _) in data.noise.items() if noise > 0.0}
    return {s.name: errors[:, i].T * share.get(s.name, np.float32(1.0)) for i, s in enumerate(model.inputs)}


def _with_unseen_paths(
    model: Model, flight: Flight, segment: Segment, errors: dict[str, NDArray[np.float32]], criteria: Criteria
) -> dict[str, NDArray[np.float32]]:
    """The draws of errors, with the unknown paths of controls across samples that they lack and the unknown times of commands."""
    span = slice(segment.first, segment.first + len(segment))
    for signal in (s for s in model.inputs if s.control and s.name in errors and flight.measured(s.source)):
        rng = np.random.default_rng([PATHS, segment.first])
        course, draws = flight.columns[signal.source][span], len(errors[signal.name])
        paths, interval = unseen_paths(course, draws, rng, criteria), flight.held(signal.source)
        if interval is not None and np.isfinite(course).all():
            paths = paths + command_times(course, flight.sample_interval, interval, draws, rng)
        if paths.any():
            errors[signal.name] = errors[signal.name] + paths.astype(np.float32)
    return errors


def with_own_noise(records: Sequence[FlightRecord], training: int, criteria: Criteria) -> tuple[FlightRecord, ...]:
    """The records with `louder` where an output is clearly noisier than usual on the training flights.

    A quieter output counts as usual: few samples may scatter little by chance, and too much trust in them names effects.
    """
    levels = np.array([[noise_level(r.z[:, c]) for c in range(r.z.shape[1])] for r in records])
    reference = np.median([row for row, r in zip(levels, records, strict=True) if r.flight < training], axis=0)
    marked = []
    for record, row in zip(records, levels, strict=True):
        ratio = np.divide(row, reference, out=np.ones_like(row), where=reference > 0.0)
        louder = np.where(ratio > criteria.louder_channel, ratio, 1.0) ** 2
        marked.append(replace(record, louder=louder) if (louder > 1.0).any() else record)
    return tuple(marked)
