"""Long records at high rates, thinned to what the model's motion needs.

A rigid body moves by a few Hz; a record of 200 Hz or 1 kHz says the same of it many times over. Where a flight has more than
LONG samples, all its columns go through one linear-phase low pass and every n-th sample is taken: a linear motion driven by
filtered inputs is the filtered motion, so that the filter is no part of the model, and nothing folds back from above the new
rate. The rate is chosen by the fastest mode of the model with the derivatives that a regression finds in the liveliest part.
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

LONG = 20_000  # samples of a flight up to which it is fitted as it is: 100 s at 200 Hz, a quarter of an hour at 20 Hz
SLOWEST = 50.0  # Hz that are left at least: edges of surfaces and gusts, whatever the modes are
EACH_TIME_CONSTANT = 2.0  # samples in the time constant of the fastest mode: the filter then passes five times its rate
UNKNOWN = 100.0  # Hz where no regression tells the modes
LOOKED_AT = 3_000  # samples of the liveliest part
TAPS = 10  # of the filter on either side, times the factor of thinning
CORNER = 0.8  # of half the new rate


def thinned(model: Model, flights: Sequence[Flight], *, keep_held: bool = False) -> Sequence[Flight]:
    """The flights as a fit needs them: long ones at a rate that the model's fastest mode asks for, which is said in a note."""
    if all(len(f) <= LONG for f in flights):
        return flights
    fastest = _fastest_mode(model, max(flights, key=len))
    rate = UNKNOWN if fastest is None else max(SLOWEST, EACH_TIME_CONSTANT * fastest)
    return [_thinned(model, f, rate, fastest, keep_held) if len(f) > LONG else f for f in flights]


def _thinned(model: Model, flight: Flight, rate: float, fastest: float | None, keep_held: bool) -> Flight:
    before = 1.0 / flight.sample_interval
    factor = int(before / rate + 1e-6)
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


def low_passed(flight: Flight, factor: int, looked_at: Sequence[str], *, keep_held: bool = False) -> Flight:
    """The flight at every `factor`-th sample of each segment, low-passed.

    looked_at: columns whose wild, repeated and stuck values are taken out before. A sample is measured where one of the
    samples it stands for is; commands that hold between their records are taken as they are.
    """
    conditioned = condition_columns(flight, looked_at, keep_held=keep_held)
    notes = list(conditioned.notes)
    rows = np.concatenate([np.arange(s.start, s.stop, factor) for s in flight.segments])
    selected = np.zeros(len(flight), bool)
    selected[rows] = True
    columns = {}
    for name in (n for n in flight.columns if flight.measured(n) and flight.held(n) is None):
        values = conditioned.flight[name]
        measured = np.isfinite(values)
        if name in looked_at:
            measured = conditioned.fresh(name) & ~conditioned.stuck(name)
            notes += conditioned.slow_notes(name, "filtered on straight lines between new values")
            notes += conditioned.stuck_notes(name, "left out there")
        if measured.any():
            columns[name] = _filtered(flight, values, measured, factor)[rows]
    return flight.part(selected).with_columns(**columns).with_notes(*notes)


def _filtered(flight: Flight, values: Array, measured: Mask, factor: int) -> Array:
    """(N,) values behind the low pass, NaN where none of the samples about one is measured."""
    reach = TAPS * factor
    kernel = np.sinc(CORNER / factor * np.arange(-reach, reach + 1)) * np.hamming(2 * reach + 1)
    kernel /= kernel.sum()
    result = np.full(values.size, np.nan)
    for part in flight.segments:
        known = measured[part]
        if not known.any():
            continue
        whole = values[part]
        if not known.all():
            places = np.arange(known.size)
            whole = np.interp(places, places[known], whole[known])
        pad = min(reach, known.size - 1)
        extended = np.pad(np.pad(whole, pad, mode="reflect", reflect_type="odd"), reach - pad, mode="edge")
        smooth = _convolved(extended, kernel)
        if not known.all():
            near = _convolved(np.pad(known.astype(float), factor // 2), np.ones(2 * (factor // 2) + 1))
            smooth[near <= 0.5] = np.nan
        result[part] = smooth
    return result


def _convolved(values: Array, kernel: Array) -> Array:
    """Where the kernel (M,) lies wholly on the values (N,): (N - M + 1,), by Fourier transforms. Written out: scipy.signal takes
    longer to load than ten minutes take to filter."""
    size = 1 << int(values.size - 1).bit_length()
    product = np.fft.rfft(values, size) * np.fft.rfft(kernel, size)
    return np.asarray(np.fft.irfft(product, size)[kernel.size - 1 : values.size])


def _fastest_mode(model: Model, flight: Flight) -> float | None:
    """Largest eigenvalue [rad/s] of the motion about what was flown; None where no regression tells it."""
    from estimation.estimators.frequency_domain.transformed import state_matrices  # with scipy

    factor = max(1, int(1.0 / flight.sample_interval / UNKNOWN))
    part = _liveliest(model, flight, LOOKED_AT * factor)
    try:
        with numerical_failures():
            thin = low_passed(part, factor, _columns(model)) if factor > 1 else part
            slim, data = without_absent_outputs(model, prepare_all(model, thin, FOR_REGRESSION))
            values = {**model.starts(), **equation_error(slim, data).values}
            states = np.concatenate([data[0].states[s.rows] for s in data[0].segments])
            inputs = np.concatenate([s.u for s in data[0].segments])
            at = np.nan_to_num(np.nanmean(states, axis=0)), np.nan_to_num(np.nanmean(inputs, axis=0))
            A = state_matrices(trace(slim.structure), *at, Simulator.build(slim, compile_="never").vector(values))[0]
            fastest = float(np.abs(np.linalg.eigvals(A)).max(initial=0.0))
    except (UserError, NumericalFailure):
        return None
    return fastest if np.isfinite(fastest) else None


def _liveliest(model: Model, flight: Flight, count: int) -> Flight:
    """The stretch of `count` samples in which the controls move most."""
    controls = [s.source for s in model.inputs if s.control and flight.measured(s.source)]
    if len(flight) <= count or not controls:
        return flight.part(slice(0, count))
    starts = np.arange(0, len(flight) - count + 1, count)
    moves = [sum(float(np.nanstd(flight[c][a : a + count])) for c in controls) for a in starts]
    first = int(starts[int(np.argmax(moves))])
    return flight.part(slice(first, first + count))
