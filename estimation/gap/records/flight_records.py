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
from scipy.fft import prev_fast_len
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from estimation.engine.kernel import Array
from estimation.engine.simulate import Segment
from estimation.gap.criteria import Criteria
from estimation.gap.effects.base import Effect, symbols_of
from estimation.gap.records.candidate_model import RATE_OF
from estimation.gap.records.sampling import unseen_moves
from estimation.models.base import Model, Signal
from estimation.prepare.flight_data import AS_USUAL, FlightData
from estimation.prepare.inputs import has_pitch_rate
from estimation.prepare.pipeline import prepare
from estimation.signals.controls import noise_between_steps, with_raw_steps
from estimation.signals.denoise import noise_level
from estimation.signals.rounding import Grid, near_edges
from groundstation.flight import Flight
from groundstation.flight.arrays import Mask, true_runs

NEAR = 0.1  # of a stretch, to either side of an even cut, in which the best cut is sought
ROUNDING = 1e-6
AROUND = 0.5  # s, to either side of a cut, in which the controls should rest
PATHS = 20  # seed of the paths across samples that a control lacks
QUIETEST = 1e-4  # of the scatter of a rate: a coarsely rounded rate shows no noise
TINY = 1e-12  # rad/s, noise of a rate that stands still
LOST = 0.005  # of the samples of a record may go unused


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
    raw: Mapping[str, Mask] = field(default_factory=dict)
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


def sample_interval(records: Sequence[FlightRecord]) -> float:
    """Median over the records of their sample interval [s]."""
    return float(np.median([r.interval for r in records]))


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
    prepared = [prepare(probe, flight) for flight in flights]
    pitches, trained = has_pitch_rate(base), prepared[: len(training)]
    restless = frozenset[str]().union(*(data.restless for data in trained))
    exact = keep_feedback or pitches or controls_outdo_gyros(probe, trained, criteria)
    if exact and not pitches:
        prepared = [prepare(probe, flight, replace(AS_USUAL, every_axis=True)) for flight in flights]
    records: list[FlightRecord] = []
    notes: list[str] = []
    for index, (flight, data) in enumerate(zip(flights, prepared, strict=True)):
        notes += [f"{flight.name}: {note}" for note in data.notes]
        parts = _in_stretches(probe, data, criteria)
        if len(parts) > len(data.segments):
            notes.append(f"{flight.name}: long records are fitted in stretches, {len(parts)} in all")
        for part in parts:
            record = _record(index, flight, data, part, base, probe, exact, criteria)
            records.append(replace(record, restless=restless))
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


def _record(
    index: int,
    flight: Flight,
    data: FlightData,
    segment: Segment,
    base: Model,
    probe: Model,
    exact: bool,
    criteria: Criteria,
) -> FlightRecord:
    """The record of one segment of a flight. index: of the flight; probe: `base` with all inputs of candidates; exact: whether
    controls have their measured values near steps."""
    rows = segment.rows
    inputs = {n: np.ascontiguousarray(segment.u[:, i]) for i, n in enumerate(probe.input_names)}
    noise = {name: level for name, (level, _) in data.noise.items()}
    raw: dict[str, Mask] = {}
    for signal in (s for s in base.inputs if exact and s.control and s.name not in data.restless):
        name, level, interval = signal.name, noise.get(signal.name, 0.0), flight.sample_interval
        if level > 0.0 and flight.measured(signal.source):
            measured = flight[signal.source][rows]
            near = near_edges(measured, data.grids.get(name), interval)
            inputs[name], raw[name] = with_raw_steps(inputs[name], near, level, criteria.surface_step, interval)
            noise[name] = noise_between_steps(measured, raw[name], level)
    follows = data.follows[rows].T if data.follows is not None else ()
    return FlightRecord(
        index,
        segment.first,
        segment.time,
        inputs,
        segment.z,
        segment.x0,
        noise,
        raw=raw,
        errors=_input_errors(probe, flight, data, rows, noise, criteria),
        uncompared=_not_compared(base, flight, segment),
        states=data.states[rows],
        follows={s.name: f for s, f in zip(probe.inputs, follows, strict=False) if f.any()},
        filtered=data.restless,
        grids=data.grids,
    )


def controls_outdo_gyros(model: Model, flights: Sequence[FlightData], criteria: Criteria) -> bool:
    """Whether the noise on a control, taken as a deflection, would turn the aircraft fast enough in one sample for the gyros to
    show.

    The gyros then also show what de-noising takes off a control that steers against the motion, and it looks like a late servo.
    From the change of each rate per sample, regressed on motion and controls; median over the flights.
    """
    ratios = [_loudest(model, part, flight) for flight in flights for part in flight.segments]
    return bool(ratios) and float(np.median(ratios)) > criteria.far_above


def _loudest(model: Model, part: Segment, flight: FlightData) -> float:
    """Largest change of a rate by one standard deviation of a control's noise, over the noise of that rate."""
    rates = [i for i, s in enumerate(model.outputs) if s.name in RATE_OF.values()]
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


def _in_stretches(model: Model, data: FlightData, criteria: Criteria) -> list[Segment]:
    """The segments of a flight, long ones in stretches, each of a length with a quick Fourier transform."""
    controls = [i for i, s in enumerate(model.inputs) if s.control]
    segments = []
    for segment in data.segments:
        for part in stretches(segment, controls, criteria):
            state = data.states[segment.first + part.start]
            x0 = segment.x0 if part.start == 0 else np.where(np.isfinite(state), state, segment.x0)
            segments.append(segment.part(part.start, part.start + quick_length(part.stop - part.start), x0))
    return segments


def stretches(segment: Segment, controls: list[int], criteria: Criteria) -> list[slice]:
    """Samples of a segment in stretches of about equal length, cut where the controls rest. controls: their columns in `u`."""
    count = len(segment)
    step = float(np.median(np.diff(segment.time)))
    parts = int(np.ceil((count - 1) * step / criteria.longest_record - ROUNDING))
    if parts < 2:
        return [slice(0, count)]
    window = 2 * max(round(AROUND / step), 1) + 1
    motion = np.zeros(count)  # ranges of the controls about each sample, over their ranges in all
    for course in (u for u in segment.u[:, controls].T if np.ptp(u) > 0.0):
        local = maximum_filter1d(course, window, mode="nearest") - minimum_filter1d(course, window, mode="nearest")
        motion += np.round(local / np.ptp(course), 2)
    length = count / parts
    cuts = [0]
    for k in range(1, parts):
        target = round(k * length)
        candidates = np.arange(max(target - int(NEAR * length), 1), min(target + int(NEAR * length), count - 1) + 1)
        cuts.append(int(min(candidates, key=lambda i: (motion[i], abs(i - target)))))
    return [slice(a, b) for a, b in zip(cuts, [*cuts[1:], count], strict=True)]


def quick_length(count: int) -> int:
    """Samples of a record that are used: the largest product of small primes within one in two hundred of `count`.

    The Fourier transform of a prime number of samples takes five times as long.
    """
    quick = int(prev_fast_len(count))
    return quick if quick >= count - int(LOST * count) else count


def _not_compared(base: Model, flight: Flight, segment: Segment) -> Array:
    """(N, ny) measured outputs where the segment has none to compare; NaN elsewhere."""
    values = np.full(segment.z.shape, np.nan)
    for i, signal in enumerate(base.outputs):
        if flight.measured(signal.source):
            values[:, i] = np.where(np.isnan(segment.z[:, i]), flight[signal.source][segment.rows], np.nan)
    return values


def _input_errors(
    model: Model, flight: Flight, data: FlightData, rows: slice, noise: Mapping[str, float], criteria: Criteria
) -> dict[str, NDArray[np.float32]]:
    """(draws, N) possible errors of each input after its preparation, scaled to its `noise`; of controls also by their unknown
    paths across samples that they lack, and by the unknown times of commands."""
    if data.errors is None:
        return {}
    errors = {}
    for i, signal in enumerate(model.inputs):
        usual = data.noise.get(signal.name, (0.0, 0.0))[0]
        share = np.float32(noise[signal.name] / usual) if usual > 0.0 else np.float32(1.0)
        errors[signal.name] = data.errors[rows][:, i].T * share
        if signal.control and flight.measured(signal.source):
            course, draws = flight[signal.source][rows], len(errors[signal.name])
            rng = np.random.default_rng([PATHS, rows.start])
            paths, interval = unseen_paths(course, draws, rng, criteria), flight.held(signal.source)
            if interval is not None and np.isfinite(course).all():
                paths = paths + command_times(course, flight.sample_interval, interval, draws, rng)
            if paths.any():
                errors[signal.name] = errors[signal.name] + paths.astype(np.float32)
    return errors


def command_times(control: Array, step: float, interval: float, draws: int, rng: np.random.Generator) -> Array:
    """(draws, N) possible errors of a command (N,) recorded every `interval` [s], in samples `step` [s] apart: each move began
    anywhere within one interval, and is early or late by the same time until the next move begins."""
    change = np.abs(np.diff(control, prepend=control[:1]))
    begins = np.zeros(control.size, bool)  # a sample before the change grows: its slope belongs to the move
    begins[1:-1] = (change[2:] > change[1:-1]) & (change[1:-1] <= change[:-2])
    move = np.cumsum(begins)
    delay = rng.uniform(-0.5 * interval, 0.5 * interval, (draws, int(move[-1]) + 1))
    return np.asarray(-delay[:, move] * np.gradient(control, step))


def unseen_paths(control: Array, draws: int, rng: np.random.Generator, criteria: Criteria) -> Array:
    """(draws, N) possible errors of straight lines across unseen moves: the step was anywhere between the samples on either
    side."""
    errors = np.zeros((draws, control.size))
    for a, b in true_runs(unseen_moves(control, criteria)):
        samples = np.arange(a, b)
        share = (samples - (a - 1.0)) / (b - (a - 1.0))
        instant = rng.uniform(a - 1.0, b, (draws, 1))
        errors[:, a:b] = ((samples > instant) - share) * (control[b] - control[a - 1])
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
        louder = np.where(ratio > criteria.clearly_above, ratio, 1.0) ** 2
        marked.append(replace(record, louder=louder) if (louder > 1.0).any() else record)
    return tuple(marked)
