"""The signals of a frequency response: detrended stretches of flights at an even step, without gaps; and notes on them.

No window crosses a gap in time, a border of segments, more than a few missing samples, or the end of a flight.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.errors import DataError
from estimation.prepare.conditioned import condition_columns
from estimation.signals.curves import FEWEST, curve_through
from estimation.signals.denoise import noise_level
from groundstation.flight import Array, Flight

CONTROLS = ("delta_e", "delta_a", "delta_r")
STILL = 1.5  # rms movement over noise level, up to which an input did not move
LARGEST = 1e12  # of any measured quantity in SI
LEAST = 1e-9  # rms movement over size of a signal: smaller is rounding
LONGEST_BRIDGE = 3  # missing samples that are interpolated
HIGHEST = 0.85  # of half the sample rate, above which a control's spectrum is noise: designed inputs end below
SHORTEST = 16  # samples of a stretch
EVEN = 0.01  # of a step: with less unevenness samples are used as they are
OTHER_SPEED = 0.1  # relative difference of airspeed from which flights are not of one condition


@dataclass(frozen=True)
class DetrendedStretch:
    """step [s]. x: (N, inputs), first the input of the response; y: (N,) output; both detrended."""

    step: float
    x: Array
    y: Array

    @property
    def duration(self) -> float:
        return self.step * (len(self.y) - 1)


@dataclass(frozen=True)
class Signals:
    """names: of the inputs, first the input of the response. noise: its standard deviation. speed: mean airspeed [m/s] or NaN."""

    names: tuple[str, ...]
    output: str
    stretches: tuple[DetrendedStretch, ...]
    noise: float
    speed: float
    notes: tuple[str, ...]

    @property
    def duration(self) -> float:
        return sum(s.duration for s in self.stretches)

    @property
    def step(self) -> float:
        """The longest step of any stretch [s]."""
        return max(s.step for s in self.stretches)


def collect(flights: Sequence[Flight], name: str, output: str, with_: Sequence[str] | None) -> Signals:
    """The signals of all flights. name: input. with_: other inputs, None for all controls that moved.

    Raises MissingColumnError for a column that no flight has, DataError where the input did not move or no stretch
    is long enough.
    """
    if name == output or output in (with_ or ()):
        raise DataError(f"frequency: {output} cannot be input and output at once; name two different columns")
    columns = (name, output, *(with_ or ()))
    for flight in flights:
        flight.require([name, output, *(with_ or ())], f"the frequency response of {output} to {name}")
    prepared_flights = [condition_columns(f, (*columns, *CONTROLS), keep_held=True) for f in flights]
    flights = [prepared.flight for prepared in prepared_flights]
    for flight in flights:
        _refuse_huge(flight, columns)
    _refuse_still(flights, name)
    other_inputs = (
        tuple(dict.fromkeys(w for w in with_ if w != name))
        if with_ is not None
        else _other_controls(flights, (name, output))
    )
    stretches = [s for flight in flights for s in _stretches(flight, (name, *other_inputs), output)]
    if not stretches:
        raise DataError(
            f"{', '.join(f.name for f in flights)}: no {SHORTEST} samples in a row have {name} and {output} "
            "measured; nothing to transform"
        )
    _refuse_flat(stretches, output)
    notes = (*(n.text for prepared in prepared_flights for n in prepared.notes), *_notes(flights, stretches))
    level = float(np.median([sensor_noise(s.x[:, 0]) for s in stretches]))
    return Signals((name, *other_inputs), output, tuple(stretches), level, _speed(flights), notes)


def input_movement(flight: Flight, name: str) -> tuple[float, float]:
    """(rms motion about the median, noise level) of a column."""
    values = flight[name][np.isfinite(flight[name])]
    return float(np.sqrt(np.mean((values - np.median(values)) ** 2))), sensor_noise(values)


def sensor_noise(values: Array) -> float:
    """Standard deviation of the white part of a control's samples (N,), all finite: the lesser of two estimates.

    Steps look like noise in the spectrum near half the rate, broad multisines in third differences; noise shows in both.
    """
    if values.size < SHORTEST:
        return 0.0
    taper = np.hanning(values.size)
    power = np.abs(np.fft.rfft(taper * (values - np.mean(values)))) ** 2 / float(np.sum(taper**2))
    floor = float(np.median(power[int(HIGHEST * power.size) :])) / np.log(2.0)  # median of an exponential distribution
    return min(noise_level(values), float(np.sqrt(floor)))


def _moved(flights: Sequence[Flight], name: str) -> bool:
    """Whether a column moved beyond its noise in any flight."""
    movements = [input_movement(f, name) for f in flights if f.measured(name)]
    size = max((float(np.nanmax(np.abs(f[name]))) for f in flights if f.measured(name)), default=0.0)
    return any(rms > max(STILL * noise, LEAST * size) for rms, noise in movements)


def _refuse_still(flights: Sequence[Flight], name: str) -> None:
    if _moved(flights, name):
        return
    rms, noise = max(input_movement(f, name) for f in flights)
    raise DataError(
        f"{', '.join(f.name for f in flights)}: input {name} moved only {rms:.2g} rms against {noise:.2g} of "
        "sensor noise, so there is no response to it; fly a frequency sweep, a multisine or doublets on it"
    )


def _refuse_huge(flight: Flight, names: Sequence[str]) -> None:
    for name in names:
        size = float(np.nanmax(np.abs(flight[name])))
        if not size < LARGEST:
            raise DataError(
                f"{flight.name}: {name} reaches {size:.3g}, which nothing that is measured does; look at the file"
            )


def _refuse_flat(stretches: Sequence[DetrendedStretch], output: str) -> None:
    if all(float(np.ptp(s.y)) <= 0.0 for s in stretches):
        raise DataError(f"output {output} stands still: a dead channel has no frequency response; name another output")


def _other_controls(flights: Sequence[Flight], taken: tuple[str, ...]) -> tuple[str, ...]:
    """Controls that moved, other than `taken`, of those that all flights measured."""
    return tuple(c for c in CONTROLS if c not in taken and all(f.measured(c) for f in flights) and _moved(flights, c))


def _stretches(flight: Flight, inputs: tuple[str, ...], output: str) -> list[DetrendedStretch]:
    columns = np.stack([flight[c] for c in (*inputs, output)], axis=1)
    stretches = []
    for part in flight.segments:
        for first, last in _gapless_runs(np.asarray(np.isfinite(columns[part]).all(axis=1))):
            if last - first >= SHORTEST:
                rows = slice(part.start + first, part.start + last)
                stretches.append(_resampled(flight.time[rows], columns[rows]))
    return stretches


def _gapless_runs(known: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Index ranges without more than LONGEST_BRIDGE missing samples in a row; each starts and ends at a known one."""
    known_indices = np.flatnonzero(known)
    if not known_indices.size:
        return []
    breaks = np.flatnonzero(np.diff(known_indices) > LONGEST_BRIDGE + 1)
    begins, ends = np.concatenate([[0], breaks + 1]), np.concatenate([breaks, [known_indices.size - 1]])
    return [(int(known_indices[a]), int(known_indices[b]) + 1) for a, b in zip(begins, ends, strict=True)]


def _resampled(time: Array, columns: Array) -> DetrendedStretch:
    """A stretch at an even step, interpolated by a cubic where samples are missing or uneven; linear trends removed."""
    step = float(time[-1] - time[0]) / (time.size - 1)
    grid = time[0] + step * np.arange(time.size)
    evenly_sampled = bool(np.all(np.abs(np.diff(time) - step) < EVEN * step)) and bool(np.isfinite(columns).all())
    if not evenly_sampled and np.isfinite(columns).all(axis=1).sum() >= FEWEST:
        columns = np.stack([curve_through(time, c, grid) for c in columns.T], axis=1)
    line = np.stack([np.ones(time.size), np.linspace(-1.0, 1.0, time.size)], axis=1)
    detrended = columns - line @ np.linalg.lstsq(line, columns, rcond=None)[0]
    return DetrendedStretch(step, detrended[:, :-1], detrended[:, -1])


def _speed(flights: Sequence[Flight]) -> float:
    speeds = [float(np.nanmean(f["V"])) for f in flights if f.measured("V")]
    return float(np.mean(speeds)) if speeds else float("nan")


def _notes(flights: Sequence[Flight], stretches: Sequence[DetrendedStretch]) -> list[str]:
    notes = []
    if len(stretches) > len(flights):
        notes.append(f"{len(stretches)} stretches without a gap; no window crosses from one to the next")
    speeds = [float(np.nanmean(f["V"])) for f in flights if f.measured("V")]
    if len(speeds) > 1 and max(speeds) > (1.0 + OTHER_SPEED) * min(speeds):
        notes.append(
            f"mean airspeeds of the flights lie between {min(speeds):.1f} and {max(speeds):.1f} m/s: the response is an average"
            " over different conditions"
        )
    return notes
