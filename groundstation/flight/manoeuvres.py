"""Manoeuvres of a flight: the windows in which controls were moved, their kinds, and the flight cut to them.

A window begins when a control leaves its slowly varying trim position by more than its noise. It ends once all controls have been
quiet for a while, and includes the aircraft's response.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from groundstation.flight.arrays import MAD_TO_SIGMA, Array
from groundstation.flight.errors import FlightError
from groundstation.flight.flight import Flight

CONTROLS = ("delta_a", "delta_r", "delta_e")
SMALLEST = 0.0175  # [rad] a control movement below 1 deg is trimming, not a manoeuvre
NOISE_FACTOR = 6  # standard deviations of the noise that a movement must exceed, too
TRIM_TIME = 12.0  # [s] of the running median that is the trim position
MEDIAN_STEP = 5  # samples between two medians: trim varies over seconds
MEDIANS_AT_ONCE = 2_000_000  # samples in windows that are sorted at once: 16 MB
QUIET = 2.0  # [s] without movement end a manoeuvre
LEAD, TAIL = 0.5, 2.5  # [s] before the first movement and after the last that belong to the window
LEADING_SHARE = 0.3  # of the largest movement; a control that moves less only follows it (mixing, gusts on the linkage)
PULSE_SHARE = 0.4  # of the amplitude, beyond which a control is in a pulse
DOUBLET_RATIO = 2.0  # of the lengths of a doublet's two pulses, at most
PULSE_TOLERANCE = 0.7  # of a pulse's length in a 3-2-1-1, in units of its shortest pulse


@dataclass(frozen=True)
class ManoeuvreStretch:
    """A stretch of flight in which controls were moved.

    start, stop: first and last time of the window [s]. controls: the columns that moved, the largest movement first.
    kind: of the first control's input, 'doublet', '3-2-1-1', 'step' or 'multistep'; 'mixed' of several controls. amplitude: of
    the first control [rad].
    """

    start: float
    stop: float
    controls: tuple[str, ...]
    kind: str
    amplitude: float

    @property
    def title(self) -> str:
        """A few words for a list or a viewer."""
        names = {"delta_a": "aileron", "delta_r": "rudder", "delta_e": "elevator"}
        return f"{' and '.join(names.get(c, c) for c in self.controls)} {self.kind}"


def find_manoeuvres(
    flight: Flight, controls: Sequence[str] = CONTROLS, *, smallest: float = SMALLEST
) -> tuple[ManoeuvreStretch, ...]:
    """The manoeuvres of a flight in order of time; none when no control column is measured.

    smallest: movement from trim [rad] that counts. A window never reaches across a gap.
    """
    manoeuvres: list[ManoeuvreStretch] = []
    present = [c for c in controls if flight.measured(c)]
    for segment in flight.segments:
        time = flight.time[segment]
        if time.size < 3:
            continue
        departures = {c: _departure(flight.columns[c][segment], time) for c in present}
        active = {c: _active(d, smallest) for c, d in departures.items()}
        if not active:
            continue
        for first, last in _windows(np.any(list(active.values()), axis=0), time):
            manoeuvres.append(_describe(time, first, last, departures, active))
    return tuple(manoeuvres)


def cut_to_manoeuvres(flight: Flight, manoeuvres: Iterable[ManoeuvreStretch], name: str | None = None) -> Flight:
    """The flight reduced to the windows, each a segment with initial states of its own in an estimate. FlightError where fewer
    than two samples lie in a window."""
    label = np.full(len(flight), -1, np.int64)
    for number, m in enumerate(manoeuvres):
        rows = (flight.time >= m.start) & (flight.time <= m.stop) & (label < 0)
        label[rows] = number
    keep = label >= 0
    if int(keep.sum()) < 2:
        raise FlightError(f"{flight.name}: no manoeuvre to cut out; the controls did not move beyond trim")
    part = flight.part(keep, name)
    # a window over a gap holds two segments: keep both divisions
    _, segment = np.unique(np.stack([label[keep], flight.segment[keep]]), axis=1, return_inverse=True)
    return replace(part, segment=np.asarray(segment).reshape(-1).astype(np.int64))


def _departure(values: Array, time: Array) -> Array:
    """(n,) movement from trim [rad]: the value less its running median, 0 where not measured."""
    width = max(3, int(TRIM_TIME / float(np.median(np.diff(time)))) | 1)
    filled = values.copy()
    missing = ~np.isfinite(filled)
    if missing.all():
        return np.zeros_like(values)
    filled[missing] = np.interp(time[missing], time[~missing], filled[~missing])
    if filled.size <= width:
        trim: Array = np.full_like(filled, float(np.median(filled)))
    else:
        half = width // 2
        padded = np.pad(filled, half, mode="reflect")
        rows = np.arange(0, filled.size, MEDIAN_STEP)
        around = sliding_window_view(padded, width)[: filled.size : MEDIAN_STEP]
        at_once = max(1, MEDIANS_AT_ONCE // width)
        parts = [np.median(around[i : i + at_once], axis=1) for i in range(0, len(around), at_once)]
        medians = np.concatenate(parts)
        trim = np.interp(np.arange(filled.size), rows, medians)
    return np.where(missing, 0.0, filled - trim)


def _active(departure: Array, smallest: float) -> NDArray[np.bool_]:
    """(n,) samples at which a control is away from trim by more than `smallest` [rad] and its noise."""
    steps = np.diff(departure)
    noise = float(np.median(np.abs(steps))) * MAD_TO_SIGMA / np.sqrt(2) if steps.size else 0.0
    return np.asarray(np.abs(departure) > max(smallest, NOISE_FACTOR * noise))


def _windows(active: NDArray[np.bool_], time: Array) -> list[tuple[int, int]]:
    """First and last row of each activity, joined where less than QUIET lies between."""
    rows = np.flatnonzero(active)
    if not rows.size:
        return []
    groups = np.split(rows, np.flatnonzero(np.diff(time[rows]) > QUIET) + 1)
    return [(int(g[0]), int(g[-1])) for g in groups if g.size >= 2]


def _describe(
    time: Array, first: int, last: int, departures: dict[str, Array], active: dict[str, NDArray[np.bool_]]
) -> ManoeuvreStretch:
    """The manoeuvre between the rows `first` and `last` of a segment. departures, active: by control, (n,)."""
    span = slice(first, last + 1)
    sizes = {c: float(np.max(np.abs(departures[c][span]))) for c in departures if active[c][span].any()}
    order = sorted(sizes, key=lambda c: -sizes[c])
    leading = tuple(c for c in order if sizes[c] > LEADING_SHARE * sizes[order[0]])
    lead = order[0]
    kind = _kind(departures[lead][span], time[span], sizes[lead]) if len(leading) == 1 else "mixed"
    return ManoeuvreStretch(
        float(max(time[0], time[first] - LEAD)), float(min(time[-1], time[last] + TAIL)), leading, kind, sizes[lead]
    )


def _kind(departure: Array, time: Array, size: float) -> str:
    """Kind of an input by its pulses: runs of one sign beyond PULSE_SHARE of the amplitude `size` [rad]."""
    sign = np.where(departure > PULSE_SHARE * size, 1, np.where(departure < -PULSE_SHARE * size, -1, 0))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], sign, [0]])))
    pulses = [
        (int(sign[a]), float(time[min(b, time.size - 1)] - time[a]))
        for a, b in zip(edges, edges[1:], strict=False)
        if sign[a] != 0
    ]
    signs, lengths = [s for s, _ in pulses], [d for _, d in pulses]
    alternating = all(a == -b for a, b in zip(signs, signs[1:], strict=False))
    if len(pulses) == 1:
        return "step"
    if alternating and len(pulses) == 2 and 1 / DOUBLET_RATIO < lengths[0] / max(lengths[1], 1e-9) < DOUBLET_RATIO:
        return "doublet"
    if alternating and len(pulses) == 4:
        unit = sum(lengths) / 7
        if all(abs(d / unit - nominal) < PULSE_TOLERANCE for d, nominal in zip(lengths, (3, 2, 1, 1), strict=True)):
            return "3-2-1-1"
    return "multistep"
