"""Decimation of long records at high rates to the rate that the model's motion needs.

A rigid body moves with a few Hz, so a record of 200 Hz or 1 kHz is redundant. A flight with more than LONG samples passes one
linear-phase low pass, the same for every column, and every n-th sample is used. Filtered inputs of a linear system give its
filtered outputs, so the model needs no filter, and nothing above the new rate is aliased. The fastest mode of the model sets the
new rate, with derivatives from a regression on the stretch in which the controls move most.
"""

from collections.abc import Sequence

import numpy as np

from daq.utilities.errors import UserError
from estimation.engine.simulate import Simulator
from estimation.engine.trace import trace
from estimation.estimators.arithmetic import NumericalFailure, numerical_failures
from estimation.estimators.equation_error import equation_error
from estimation.models.base import Model
from estimation.prepare.conditioned import condition_columns
from estimation.prepare.flight_data import FOR_REGRESSION, without_absent_outputs
from estimation.prepare.pipeline import prepare_all
from groundstation.flight import Array, Flight
from groundstation.flight.arrays import Mask
from groundstation.flight.findings import Finding, FindingKind

LONG = 20_000  # samples up to which a flight is fitted at its full rate: 100 s at 200 Hz, a quarter of an hour at 20 Hz
LOWEST_RATE = 50.0  # Hz: steps of surfaces and gusts need it, whatever the modes are
SAMPLES_PER_TIME_CONSTANT = 2.0  # of the fastest mode: the filter then passes five times its rate
RATE_WITHOUT_MODES = 100.0  # Hz, where the regression gives no modes
REGRESSION_SAMPLES = 3_000  # of the stretch for the regression, at RATE_WITHOUT_MODES: half a minute
TAPS = 10  # of the filter on either side, times the decimation factor
CORNER = 0.8  # of the filter, over half the new rate


def thinned(model: Model, flights: Sequence[Flight], *, keep_held: bool = False) -> Sequence[Flight]:
    """The flights, the long ones decimated to the rate that the model's fastest mode needs; a note of the flight says so."""
    if all(len(f) <= LONG for f in flights):
        return flights
    fastest = _fastest_mode(model, max(flights, key=len))
    rate = RATE_WITHOUT_MODES if fastest is None else max(LOWEST_RATE, SAMPLES_PER_TIME_CONSTANT * fastest)
    return [_thinned(model, f, rate, fastest, keep_held) if len(f) > LONG else f for f in flights]


def _thinned(model: Model, flight: Flight, rate: float, fastest: float | None, keep_held: bool) -> Flight:
    before = 1.0 / flight.sample_interval
    factor = int(before / rate + 1e-6)  # rounding must not lose a whole factor
    if factor < 2:
        return flight
    why = "the model's modes are not known" if fastest is None else f"the model's fastest mode has {fastest:.3g} rad/s"
    text = (
        f"{before:.4g} Hz are more than {len(flight)} samples need: low-passed at {0.5 * CORNER * before / factor:.3g} Hz, every"
        f" column alike, and thinned to {before / factor:.4g} Hz ({why}); give --segments to fit a part at the full rate"
    )
    return low_passed(flight, factor, _columns(model), keep_held=keep_held).with_notes(Finding(FindingKind.OTHER, text))


def _columns(model: Model) -> list[str]:
    starts = [s.start for s in model.states if isinstance(s.start, str)]
    return [*(s.source for s in (*model.inputs, *model.outputs, *model.states)), *starts]


def low_passed(flight: Flight, factor: int, conditioned_columns: Sequence[str], *, keep_held: bool = False) -> Flight:
    """The flight at every `factor`-th sample of each segment, low-passed.

    conditioned_columns: columns whose wild, repeated and stuck values are removed first. A new sample counts as measured where at
    least one of the samples that it replaces is. Commands that hold between their records are not filtered.
    """
    conditioned = condition_columns(flight, conditioned_columns, keep_held=keep_held)
    notes = list(conditioned.notes)
    rows = np.concatenate([np.arange(s.start, s.stop, factor) for s in flight.segments])
    selected = np.zeros(len(flight), bool)
    selected[rows] = True
    columns = {}
    for name in (n for n in flight.columns if flight.measured(n) and flight.held(n) is None):
        values = conditioned.flight[name]
        measured = np.isfinite(values)
        if name in conditioned_columns:
            measured = conditioned.fresh(name) & ~conditioned.stuck(name)
            notes += conditioned.slow_notes(name, "filtered on straight lines between new values")
            notes += conditioned.stuck_notes(name, "left out there")
        if measured.any():
            columns[name] = _filtered(flight, values, measured, factor)[rows]
    return flight.part(selected).with_columns(**columns).with_notes(*notes)


def _filtered(flight: Flight, values: Array, measured: Mask, factor: int) -> Array:
    """(N,) low-passed values, NaN where none of the samples around one is measured."""
    reach = TAPS * factor
    kernel = np.sinc(CORNER / factor * np.arange(-reach, reach + 1)) * np.hamming(2 * reach + 1)
    kernel /= kernel.sum()
    result = np.full(values.size, np.nan)
    for part in flight.segments:
        known = measured[part]
        if not known.any():
            continue
        filled = values[part]
        if not known.all():
            positions = np.arange(known.size)
            filled = np.interp(positions, positions[known], filled[known])
        pad = min(reach, known.size - 1)
        extended = np.pad(np.pad(filled, pad, mode="reflect", reflect_type="odd"), reach - pad, mode="edge")
        smooth = _convolved(extended, kernel)
        if not known.all():
            measured_nearby = _convolved(np.pad(known.astype(float), factor // 2), np.ones(2 * (factor // 2) + 1))
            smooth[measured_nearby <= 0.5] = np.nan  # a count, but for rounding
        result[part] = smooth
    return result


def _convolved(values: Array, kernel: Array) -> Array:
    """(N - M + 1,) convolution of values (N,) with a kernel (M,) where they overlap completely, by Fourier transforms.

    Importing scipy.signal would take longer than filtering ten minutes of flight.
    """
    size = 1 << int(values.size - 1).bit_length()
    product = np.fft.rfft(values, size) * np.fft.rfft(kernel, size)
    return np.asarray(np.fft.irfft(product, size)[kernel.size - 1 : values.size])


def _fastest_mode(model: Model, flight: Flight) -> float | None:
    """Largest eigenvalue [rad/s] of the motion linearised about the flown mean; None where the regression fails."""
    from estimation.estimators.frequency_domain.transformed import state_matrices  # with scipy

    factor = max(1, int(1.0 / flight.sample_interval / RATE_WITHOUT_MODES))
    part = _most_excited(model, flight, REGRESSION_SAMPLES * factor)
    try:
        with numerical_failures():
            thin = low_passed(part, factor, _columns(model)) if factor > 1 else part
            slim, data = without_absent_outputs(model, prepare_all(model, thin, FOR_REGRESSION))
            values = {**model.starts(), **equation_error(slim, data).values}
            states = np.concatenate([data[0].states[s.rows] for s in data[0].segments])
            inputs = np.concatenate([s.u for s in data[0].segments])
            mean_state = np.nan_to_num(np.nanmean(states, axis=0))
            mean_inputs = np.nan_to_num(np.nanmean(inputs, axis=0))
            parameters = Simulator.build(slim, compile_="never").vector(values)
            A, _ = state_matrices(trace(slim.structure), mean_state, mean_inputs, parameters)
            fastest = float(np.abs(np.linalg.eigvals(A)).max(initial=0.0))
    except (UserError, NumericalFailure):
        return None
    return fastest if np.isfinite(fastest) else None


def _most_excited(model: Model, flight: Flight, count: int) -> Flight:
    """The stretch of `count` samples in which the controls move most."""
    controls = [s.source for s in model.inputs if s.control and flight.measured(s.source)]
    if len(flight) <= count or not controls:
        return flight.part(slice(0, count))
    starts = np.arange(0, len(flight) - count + 1, count)
    moves = [sum(float(np.nanstd(flight[c][a : a + count])) for c in controls) for a in starts]
    first = int(starts[int(np.argmax(moves))])
    return flight.part(slice(first, first + count))
