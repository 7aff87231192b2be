"""The signals of a frequency response: even, gapless, detrended stretches of flights, and what is said of them.

A window never crosses a gap in time, a border of segments or a hole longer than a few samples; several flights are as many
stretches more.
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
STILL = 1.5  # noise levels: an input whose samples scatter less than this shows noise and nothing else
LARGEST = 1e12  # of anything measured in SI
LEAST = 1e-9  # of a signal's own size: rounding, not motion
LONGEST_BRIDGE = 3  # missing samples that a curve may bridge
HIGHEST = 0.85  # of half the rate: a designed input ends below
SHORTEST = 16  # samples of a stretch worth having
EVEN = 0.01  # of a step: unevenness that needs no new grid
OTHER_SPEED = 0.1  # of airspeed between flights: from here they are not of one condition


@dataclass(frozen=True)
class DetrendedStretch:
    """step: s. x: (N, inputs), the one asked for first; y: (N,); both detrended."""

    step: float
    x: Array
    y: Array

    @property
    def duration(self) -> float:
        return self.step * (len(self.y) - 1)


@dataclass(frozen=True)
class Signals:
    """names: of the inputs, the one asked for first. noise: standard deviation of that one. speed: mean airspeed [m/s] or NaN."""

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
        """The longest step of all [s]."""
        return max(s.step for s in self.stretches)


def collect(flights: Sequence[Flight], name: str, output: str, with_: Sequence[str] | None) -> Signals:
    """Stretches of all flights. with_: other inputs, None for all controls that moved.

    Raises MissingColumnError for a column that no flight has, DataError where the input did not move or no stretch
    is long enough.
    """
    if name == output or output in (with_ or ()):
        raise DataError(f"frequency: {output} cannot be input and output at once; name two different columns")
    columns = (name, output, *(with_ or ()))
    for flight in flights:
        flight.require([name, output, *(with_ or ())], f"the frequency response of {output} to {name}")
    looked_at = [condition_columns(f, (*columns, *CONTROLS), keep_held=True) for f in flights]
    flights = [prepared_flight.flight for prepared_flight in looked_at]
    for flight in flights:
        _refuse_endless(flight, columns)
    _refuse_still(flights, name)
    other_inputs = (
        tuple(dict.fromkeys(w for w in with_ if w != name))
        if with_ is not None
        else _moved_text(flights, (name, output))
    )
    stretches = [s for flight in flights for s in _stretches(flight, (name, *other_inputs), output)]
    if not stretches:
        raise DataError(
            f"{', '.join(f.name for f in flights)}: no {SHORTEST} samples in a row have {name} and {output} "
            "measured; nothing to transform"
        )
    _refuse_flat(stretches, output)
    notes = (*(n.text for prepared_flight in looked_at for n in prepared_flight.notes), *_notes(flights, stretches))
    level = float(np.median([sensor_noise(s.x[:, 0]) for s in stretches]))
    return Signals((name, *other_inputs), output, tuple(stretches), level, _speed(flights), notes)


def input_movement(flight: Flight, name: str) -> tuple[float, float]:
    """(rms motion about the median, noise level) of a column."""
    values = flight[name][np.isfinite(flight[name])]
    return float(np.sqrt(np.mean((values - np.median(values)) ** 2))), sensor_noise(values)


def sensor_noise(values: Array) -> float:
    """Standard deviation of the white part of a control's samples (N,), finite.

    Edges look like noise to the spectrum near half the rate and broad multisines to third differences; noise is in both.
    """
    if values.size < SHORTEST:
        return 0.0
    taper = np.hanning(values.size)
    power = np.abs(np.fft.rfft(taper * (values - np.mean(values)))) ** 2 / float(np.sum(taper**2))
    floor = float(np.median(power[int(HIGHEST * power.size) :])) / np.log(2.0)  # median of an exponential distribution
    return min(noise_level(values), float(np.sqrt(floor)))


def _typical_movement(flights: Sequence[Flight], name: str) -> bool:
    movements = [input_movement(f, name) for f in flights if f.measured(name)]
    size = max((float(np.nanmax(np.abs(f[name]))) for f in flights if f.measured(name)), default=0.0)
    return any(rms > max(STILL * noise, LEAST * size) for rms, noise in movements)


def _refuse_still(flights: Sequence[Flight], name: str) -> None:
    if _typical_movement(flights, name):
        return
    rms, noise = max(input_movement(f, name) for f in flights)
    raise DataError(
        f"{', '.join(f.name for f in flights)}: input {name} moved only {rms:.2g} rms against {noise:.2g} of "
        "sensor noise, so there is no response to it; fly a frequency sweep, a multisine or doublets on it"
    )


def _refuse_endless(flight: Flight, names: Sequence[str]) -> None:
    for name in names:
        size = float(np.nanmax(np.abs(flight[name])))
        if not size < LARGEST:
            raise DataError(
                f"{flight.name}: {name} reaches {size:.3g}, which nothing that is measured does; look at the file"
            )


def _refuse_flat(stretches: Sequence[DetrendedStretch], output: str) -> None:
    if all(float(np.ptp(s.y)) <= 0.0 for s in stretches):
        raise DataError(f"output {output} stands still: a dead channel has no frequency response; name another output")


def _moved_text(flights: Sequence[Flight], taken: tuple[str, ...]) -> tuple[str, ...]:
    """Other controls that moved, in all flights that would be left out otherwise."""
    return tuple(
        c for c in CONTROLS if c not in taken and all(f.measured(c) for f in flights) and _typical_movement(flights, c)
    )


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
    """Index ranges without a hole longer than LONGEST_BRIDGE; they begin and end at a known sample."""
    known_indices = np.flatnonzero(known)
    if not known_indices.size:
        return []
    breaks = np.flatnonzero(np.diff(known_indices) > LONGEST_BRIDGE + 1)
    begins, ends = np.concatenate([[0], breaks + 1]), np.concatenate([breaks, [known_indices.size - 1]])
    return [(int(known_indices[a]), int(known_indices[b]) + 1) for a, b in zip(begins, ends, strict=True)]


def _resampled(time: Array, columns: Array) -> DetrendedStretch:
    """A stretch on an even grid, by a cubic where samples are missing or unevenly spaced; trends taken off."""
    step = float(time[-1] - time[0]) / (time.size - 1)
    grid = time[0] + step * np.arange(time.size)
    evenly_sampled = bool(np.all(np.abs(np.diff(time) - step) < EVEN * step)) and bool(np.isfinite(columns).all())
    if not evenly_sampled and np.isfinite(columns).all(axis=1).sum() >= FEWEST:
        columns = np.stack([curve_through(time, c, grid) for c in columns.T], axis=1)
    rise = np.stack([np.ones(time.size), np.linspace(-1.0, 1.0, time.size)], axis=1)
    flat = columns - rise @ np.linalg.lstsq(rise, columns, rcond=None)[0]
    return DetrendedStretch(step, flat[:, :-1], flat[:, -1])


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
            f"mean airspeeds of the flights lie between {min(speeds):.1f} and {max(speeds):.1f} m/s: the response "
            "is an average over "
            "different conditions"
        )
    return notes
