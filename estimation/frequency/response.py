"""The frequency response of an output to a control, composed of several window lengths.

Long windows reach low frequencies and resolve peaks, short ones average more. At each frequency the lengths that hold
at least two periods are weighted by (random error / least random error)^-4 (M. B. Tischler and R. K. Remple, Aircraft
and Rotorcraft System Identification, 2nd ed., chapter 10). As they share the same data, the error of the composite is the
weighted mean of their errors, as for full correlation.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter, uniform_filter1d

from estimation.errors import DataError
from estimation.frequency.feedback import feedback_note
from estimation.frequency.records import Signals, collect
from estimation.frequency.spectra import FrequencyGrid, WindowResponse, respond
from estimation.signals.curves import Complex
from groundstation.flight import Array, Flight

PERIODS = 2.0  # of a frequency in a window: with fewer, mean and trend dominate its transform
LENGTHS = 5  # of windows, as in CIFER
SHORTER = 1.6  # ratio of one length to the next
SHORTEST = 1.5  # s
FEWEST_SAMPLES = 8.0  # of a window
LONGEST = 40.0  # s, which resolves all modes of an aircraft but the phugoid
POINTS = 60  # frequencies
FEWEST_POINTS, MOST_POINTS = 2, 2000
PER_PERIOD = 4.0  # samples of a period of the highest frequency
STEPS = 10.0  # spacings of the zoomed grid up to the lowest frequency
WEIGHT_POWER = -4.0  # of the random error, in the weight of a window length (Tischler and Remple)
WORST = 1.0 / 3.0  # random error over magnitude, above which points are left out
CHANCE = 1e-3  # probability that a point without any response has a coherence that is kept
INCOHERENT = 0.3  # coherence below which points are left out
BESIDE = 7  # points whose median is judged: single points would be kept where chance makes them large
LEFT_OVER = 5.0
"""Bias left after the correction for a window's shape, over the square of the correction, both relative to H: from Dutch rolls
damped 0.05 to 0.3 in windows of 4 to 30 s."""
MOST_LEFT = 1.2  # bias left over the correction itself, where windows are too short to resolve the mode
NOISY_INPUT = 0.02  # bias of the magnitude by noise of the input, relative, from which a note reports it


@dataclass(frozen=True)
class FrequencyResponse:
    """Arrays over the frequencies kept. omega: rad/s. H: output over input, complex. std: of its real and of its imaginary part.
    coherence: with the first input, the others taken off. length: mean length of the windows [s]. left_out: (frequency,
    coherence) of points too uncertain. inputs: first the input of the response. windows [s]; duration: of data [s]; speed
    [m/s]."""

    inputs: tuple[str, ...]
    output: str
    omega: Array
    H: Complex
    std: Array
    coherence: Array
    length: Array
    left_out: tuple[tuple[float, float], ...]
    windows: tuple[float, ...]
    duration: float
    speed: float
    notes: tuple[str, ...] = ()
    flights: tuple[str, ...] = ()

    @property
    def input(self) -> str:
        """The column that the response is to."""
        return self.inputs[0]

    @property
    def conditioned(self) -> str:
        """`, with delta_r taken off` where the response is conditioned on other inputs, else empty."""
        return f", with {', '.join(self.inputs[1:])} taken off" if len(self.inputs) > 1 else ""

    @property
    def magnitude(self) -> Array:
        """Output's unit per input's."""
        return np.asarray(np.abs(self.H))

    @property
    def phase(self) -> Array:
        """Phase [rad], unwrapped from the lowest frequency on, where it is between -pi and pi."""
        return np.unwrap(np.angle(self.H))

    @property
    def std_phase(self) -> Array:
        """Random error of the phase [rad]; at most pi / sqrt(3), that of an unknown phase."""
        return np.asarray(np.minimum(self.std / np.maximum(self.magnitude, 1e-300), np.pi / np.sqrt(3.0)))

    def to_json(self) -> dict[str, Any]:
        return {
            "version": 1,
            "input": self.input,
            "output": self.output,
            "with": list(self.inputs[1:]),
            "flights": list(self.flights),
            "frequency": self.omega.tolist(),
            "magnitude": self.magnitude.tolist(),
            "phase": self.phase.tolist(),
            "coherence": self.coherence.tolist(),
            "std_magnitude": self.std.tolist(),
            "std_phase": self.std_phase.tolist(),
            "left_out": [{"frequency": f, "coherence": c} for f, c in self.left_out],
            "windows_s": list(self.windows),
            "duration_s": self.duration,
            "notes": list(self.notes),
        }


@dataclass(frozen=True)
class ResponseOptions:
    """with_: other inputs, whose effect is taken off, None for all controls that moved. band [Hz]: by default all that windows
    and samples allow. points: number of frequencies, even in their logarithm. windows: lengths [s], by default LENGTHS."""

    with_: tuple[str, ...] | None = None
    band: tuple[float, float] | None = None
    points: int = POINTS
    windows: tuple[float, ...] = field(default=())


def frequency_response(
    flights: Flight | Sequence[Flight], name: str, output: str, options: ResponseOptions | None = None
) -> FrequencyResponse:
    """Response of column `output` to column `name` over one flight or several.

    Raises MissingColumnError for a missing column, DataError where the input did not move, the stretches have too few windows, or
    the output does not follow the input.
    """
    response_options = options or ResponseOptions()
    read = [flights] if isinstance(flights, Flight) else list(flights)
    signals = collect(read, name, output, response_options.with_)
    lengths = _lengths(signals, response_options)
    low, high = _band(signals, response_options, lengths[0])
    grid = _grid(low, high, response_options.points)
    window_responses = [r for length in lengths if (r := respond(signals.stretches, length, grid)) is not None]
    if not window_responses:
        raise DataError(_too_short(signals))
    return _composed(signals, window_responses, grid, tuple(f.name for f in read))


def _too_short(signals: Signals) -> str:
    inputs, count = ", ".join(signals.names), len(signals.stretches)
    stretch_count = f"{count} stretch{'es' if count > 1 else ''}"
    return (
        f"{signals.duration:.3g} s in {stretch_count} hold too few windows to tell a response to {inputs} and its error; "
        "fly longer, give more flights, or condition on fewer inputs with --with"
    )


def _lengths(signals: Signals, options: ResponseOptions) -> tuple[float, ...]:
    """Lengths of windows [s], longest first: of the longest the data fill three for one input, two more for each other input."""
    longest = max(s.duration for s in signals.stretches)
    if options.windows:
        if not all(0.0 < w <= longest for w in options.windows):
            raise DataError(f"windows must be positive and no longer than the longest stretch, {longest:.3g} s")
        return tuple(sorted(options.windows, reverse=True))
    top = min(LONGEST, longest, signals.duration / (1.0 + 2.0 * len(signals.names)))
    lengths = [top / SHORTER**k for k in range(LENGTHS)]
    usable_lengths = tuple(w for w in lengths if w >= max(SHORTEST, FEWEST_SAMPLES * signals.step))
    if not usable_lengths:
        raise DataError(_too_short(signals))
    return usable_lengths


def _band(signals: Signals, options: ResponseOptions, longest: float) -> tuple[float, float]:
    """(lowest, highest) frequency [Hz]."""
    nyquist = 0.5 / signals.step
    low, high = options.band or (PERIODS / longest, 2.0 * nyquist / PER_PERIOD)
    if not 0.0 < low < high <= nyquist:
        raise DataError(
            f"band {low:.3g} to {high:.3g} Hz: two frequencies in order are needed, the higher at most "
            f"{nyquist:.3g} Hz (half the rate)"
        )
    if low < PERIODS / longest * (1.0 - 1e-9):
        raise DataError(
            f"band from {low:.3g} Hz: the longest window, {longest:.3g} s, holds {PERIODS:g} periods from "
            f"{PERIODS / longest:.3g} Hz on; fly longer, or begin there"
        )
    return low, high


def _grid(low: float, high: float, points: int) -> FrequencyGrid:
    if not FEWEST_POINTS <= points <= MOST_POINTS:
        raise DataError(f"{points} points: give {FEWEST_POINTS} to {MOST_POINTS}")
    spacing = low / max(STEPS, 2.0 * points * low / (high - low) if high / low < 2 else STEPS)
    target_frequencies = np.geomspace(low, high, points)
    grid_indices = np.unique(np.round((target_frequencies - low) / spacing).astype(np.intp))
    grid_indices = grid_indices[low + spacing * grid_indices <= high * (1.0 + 1e-9)]
    return FrequencyGrid(2 * np.pi * low, 2 * np.pi * spacing, grid_indices)


# ------------------------------------------------------------------------------------------------------- composite


def _composed(
    signals: Signals, window_responses: Sequence[WindowResponse], grid: FrequencyGrid, names: tuple[str, ...]
) -> FrequencyResponse:
    omega = grid.omega
    holds = np.stack([omega >= (1.0 - 1e-9) * 2 * np.pi * PERIODS / r.length for r in window_responses])
    omega, holds = omega[holds.any(axis=0)], holds[:, holds.any(axis=0)]
    if not omega.size:
        raise DataError(_too_short(signals))
    part = slice(len(grid.omega) - len(omega), None)
    bias = _bias(window_responses, part)
    error = np.where(holds, np.hypot(np.stack([r.std[part] for r in window_responses]), bias), np.inf)
    weight = (np.maximum(error, 1e-300) / np.maximum(error.min(axis=0), 1e-300)) ** WEIGHT_POWER
    weight /= weight.sum(axis=0)

    def mean(values: Sequence[Any]) -> Any:
        return np.sum(weight * np.stack([v[part] for v in values]), axis=0)

    H, std = mean([r.H for r in window_responses]), np.sum(weight * np.where(holds, error, 0.0), axis=0)
    coherence, power = mean([r.coherence for r in window_responses]), mean([r.power for r in window_responses])
    length = mean([np.full(grid.omega.shape, r.length) for r in window_responses])
    coherent = _coherent_points(H, std, coherence, mean([r.freedom for r in window_responses]))
    omitted = tuple((float(w), float(c)) for w, c in zip(omega[~coherent], coherence[~coherent], strict=True))
    if not coherent.any():
        raise DataError(
            f"{', '.join(names)}: {signals.output} does not follow {signals.names[0]} anywhere from {omega[0]:.3g} to "
            f"{omega[-1]:.3g} rad/s (coherence at most {float(coherence.max()):.2f}); is it the right output, and was the "
            "input moved on purpose?"
        )
    notes = (*signals.notes, *_notes(signals, window_responses, power[coherent]))
    return FrequencyResponse(
        signals.names, signals.output, omega[coherent], H[coherent], std[coherent], coherence[coherent], length[coherent],
        omitted,
        tuple(r.length for r in window_responses), signals.duration, signals.speed, notes, names,
    )  # fmt: skip


def _coherent_points(H: Complex, std: Array, coherence: Array, freedom: Array) -> NDArray[np.bool_]:
    """(frequencies,) which points are kept, judged together with their neighbours."""
    by_chance = 1.0 - CHANCE ** (1.0 / np.maximum(freedom, 1.0))  # exceeded with probability CHANCE without a response
    margin = np.stack([coherence - np.maximum(INCOHERENT, by_chance), WORST * np.abs(H) - std])
    return np.asarray(np.all(median_filter(margin, (1, BESIDE)) >= 0.0, axis=0) & (std <= np.abs(H)))


def _bias(window_responses: Sequence[WindowResponse], part: slice) -> Array:
    """(lengths, frequencies) bias that the shape of the window leaves in each response.

    A response with the correction keeps a part that goes with its square; one without has the bias of the next shorter window,
    smaller by the ratio of lengths squared.
    """
    biases = []
    for k, r in enumerate(window_responses):
        shifted_response = next((f for f in window_responses[k:] if f.shift is not None), None)
        if shifted_response is None or shifted_response.shift is None:
            biases.append(np.zeros(r.H[part].shape))
            continue
        shift = uniform_filter1d(shifted_response.shift, BESIDE)[part] * (shifted_response.length / r.length) ** 2
        share = np.minimum(LEFT_OVER * shift**2, MOST_LEFT * shift) if shifted_response is r else shift
        biases.append(np.minimum(share, 1.0) * np.abs(r.H[part]))
    return np.stack(biases)


def _notes(signals: Signals, window_responses: Sequence[WindowResponse], power: Array) -> list[str]:
    notes = []
    noise = signals.noise**2 * signals.step / np.maximum(power, 1e-300)
    if np.any(noise > NOISY_INPUT):
        notes.append(
            f"noise of {signals.names[0]} ({signals.noise:.2g} rms) makes the magnitude up to "
            f"{100 * float(noise.max()):.0f} % low where the control moved least"
        )
    if not any(r.corrected for r in window_responses):
        notes.append(
            "too few windows to correct for their shape: a lightly damped peak comes out low and broad, by up to "
            "6.6 (decay time / window)^2; fly longer or give more flights"
        )
    warning = feedback_note(signals)
    return [*notes, warning] if warning else notes
