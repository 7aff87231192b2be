"""Two flights in one, for view and report: the second is shifted in time onto the first, and its columns are added to it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.flight.errors import FlightError
from groundstation.flight.flight import GAP_FACTOR, Flight
from groundstation.flight.manoeuvres import find_manoeuvres
from groundstation.flight.marks import marks_of

Array = NDArray[np.float64]

COMPARED = ("delta_a", "delta_r", "delta_e", "cmd_a", "cmd_r", "cmd_e", "p", "q", "r", "phi", "theta")
"""Columns whose correlation gives the shift."""
COMPARISON_RATE = 20.0
"""[Hz] to which these columns are resampled: the rise of a servo then lasts some samples."""
SHORTEST_OVERLAP = 5.0
"""[s]; over a shorter common time any two flights correlate."""
LEAST_CORRELATION = 0.3
"""Over all columns, below which a correlation gives no shift."""
BOOT_TIME, FIRST_STATE = 10.0, 1.0
"""[s] after its start in which an autopilot reports its version and board, and writes its first state."""
BESIDE = "_model"
"""Ending of the columns that the view draws beside those of a flight."""


@dataclass(frozen=True)
class PairedFlight:
    """flight: the first, with the columns of the second added under names ending in BESIDE. shift: added to the second's time
    [s]. text: the shift, and what gave it."""

    flight: Flight
    shift: float
    text: str


def beside(first: Flight, second: Flight, by: str = "auto") -> PairedFlight:
    """Both flights in one. by: 'correlation', 'input' (first movement of a control), 'event' (first event, mode or message that
    both have), 'start', or 'auto': correlation, else input, else start. FlightError where that gives no shift, or no common
    time."""
    finders: Mapping[str, Callable[[Flight, Flight], tuple[float, str] | None]] = {
        "correlation": _by_correlation, "input": _by_input, "event": _by_event, "start": _by_start,
    }  # fmt: skip
    methods = ("correlation", "input", "start") if by == "auto" else (by,)
    result = next((f for f in (finders[w](first, second) for w in methods) if f is not None), None)
    if result is None:
        raise FlightError(
            f"{second.name} cannot be laid on {first.name} by {by}: they have nothing of it in common; try --align start"
        )
    shift, text = result
    time = second.time + shift
    columns = {
        f"{n}{BESIDE}": _resampled(first.time, time, v, second)
        for n, v in second.columns.items()
        if not n.endswith(BESIDE)
    }
    if not any(np.isfinite(v).any() for v in columns.values()):
        raise FlightError(f"{second.name}, moved by {shift:+.2f} s, has no time in common with {first.name}")
    first_columns = {n: v for n, v in first.columns.items() if not n.endswith(BESIDE)}
    pair = Flight.build(
        first.name, first.time, {**first_columns, **columns}, segment=first.segment, provenance=first.provenance
    )
    return PairedFlight(pair, shift, f"{second.name} is moved by {shift:+.2f} s onto {first.name}: {text}")


def _resampled(base: Array, time: Array, values: Array, flight: Flight) -> Array:
    """The values of the second flight at the times `base` of the first (n,); NaN outside it and in its gaps. time: of the second,
    shifted [s]."""
    finite = np.isfinite(values)
    if finite.sum() < 2:
        return np.full(base.size, np.nan)
    t, v = time[finite], values[finite]
    index = np.clip(np.searchsorted(t, base) - 1, 0, t.size - 2)
    covered = (base >= t[0]) & (base <= t[-1]) & (t[index + 1] - t[index] <= GAP_FACTOR * flight.sample_interval)
    return np.where(covered, np.interp(base, t, v), np.nan)


def _by_start(first: Flight, second: Flight) -> tuple[float, str]:
    return float(first.time[0] - second.time[0]), "both begin together"


def _by_input(first: Flight, second: Flight) -> tuple[float, str] | None:
    a, b = find_manoeuvres(first), find_manoeuvres(second)
    if not a or not b:
        return None
    return a[0].start - b[0].start, f"the first input of each ({a[0].title}; {b[0].title})"


def _by_event(first: Flight, second: Flight) -> tuple[float, str] | None:
    for first_events, second_events in zip(_ranked_events(first), _ranked_events(second), strict=True):
        second_times: dict[str, float] = {}
        for time, text in second_events:
            second_times.setdefault(text, time)
        common = next(
            ((time - second_times[text], f"by '{text}'") for time, text in first_events if text in second_times), None
        )
        if common is not None:
            return common
    return None


def _ranked_events(flight: Flight) -> tuple[list[tuple[float, str]], ...]:
    """(Time [s], text) of events and changes of mode, of messages, and of all events and modes from the start on, in the order in
    which they are tried. Messages of the boot (version, board) are left out, since every log has them."""
    marks = marks_of(flight)
    events, modes = [(m.time, m.text) for m in marks.events], [(m.start, f"mode {m.name}") for m in marks.modes]
    start = min([t for t, _ in (*events, *modes)] + [m.time for m in marks.messages] + [float(flight.time[0])])
    messages = [(m.time, m.text) for m in marks.messages if m.time > start + BOOT_TIME]
    changes = [event for event in (*events, *modes[1:]) if event[0] > start + FIRST_STATE]
    return sorted(changes), sorted(messages), sorted([*events, *modes])


def _by_correlation(first: Flight, second: Flight) -> tuple[float, str] | None:
    """The shift with the largest correlation over all columns that both flights have."""
    names = [n for n in COMPARED if first.measured(n) and second.measured(n)]
    a, b = (np.arange(f.time[0], f.time[-1], 1 / COMPARISON_RATE) for f in (first, second))
    min_samples = round(SHORTEST_OVERLAP * COMPARISON_RATE)
    if not names or min(a.size, b.size) < min_samples:
        return None
    size = a.size + b.size
    cross = np.zeros(2 * size)
    power_a = power_b = np.zeros(2 * size)
    for name in names:
        x, y = _normalised(first, name, a), _normalised(second, name, b)
        cross = cross + _products(x, y, size)
        power_a = power_a + _products(x**2, np.ones_like(y), size)
        power_b = power_b + _products(np.ones_like(x), y**2, size)
    common = _products(np.ones(a.size), np.ones(b.size), size)
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = np.where(
            (common >= min_samples) & (power_a > 0) & (power_b > 0), cross / np.sqrt(power_a * power_b), -1.0
        )
        # a short overlap correlates by chance
        correlation = correlation * np.sqrt(np.clip(common / min(a.size, b.size), 0.0, 1.0))
    peak = int(np.argmax(correlation))
    if correlation[peak] < LEAST_CORRELATION:
        return None
    lag = peak if peak < size else peak - 2 * size
    return float(a[0] - b[0] + lag / COMPARISON_RATE), f"{', '.join(names)} correlate by {correlation[peak]:.2f}"


def _normalised(flight: Flight, name: str, time: Array) -> Array:
    """A column interpolated at `time` (n,), less its median, over its rms."""
    finite = np.isfinite(flight[name])
    values = np.interp(time, flight.time[finite], flight[name][finite])
    values = values - np.median(values)
    return np.asarray(values / (np.sqrt(np.mean(values**2)) or 1.0))


def _products(x: Array, y: Array, size: int) -> Array:
    """(2 size,) sum over t of x(t + lag) y(t) for each lag in samples; negative lags count from the end, as in an FFT."""
    return np.asarray(np.fft.irfft(np.fft.rfft(x, 2 * size) * np.conj(np.fft.rfft(y, 2 * size)), 2 * size))
