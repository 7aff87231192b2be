"""What an airspeed says of a flight: when the aircraft flies, how well its calibration knows it, and when a pitot stopped telling
the speed though the aircraft flew on: blocked by water or ice, or without its tube."""

import math
from collections.abc import Iterable, Mapping

import numpy as np

from daq.utilities.constants import GRAVITY, SEA_LEVEL_DENSITY
from groundstation.flight.arrays import Array, Mask, true_runs

FLYING = 5.0
"""Airspeed [m/s] below which vanes do not follow the wind: on the ground, or not measured."""
SLOW_FLYER = 1.5
"""Airspeed [m/s] that the slowest aeroplanes reach (50 g in a hall fly at 2 to 5 m/s); a pitot at rest may show as much at times,
so half of a record has to be near its largest."""
LOST = 0.3
"""Of the airspeed that a tenth of the flight exceeds: wings carry a tenth of the weight there."""
LASTS = 1.0  # [s] of a loss: gusts and single wild values are shorter
STILL_FLYING = 0.7  # of the usual speed over ground: a roll after touch-down has less, also in a tail wind
AGAINST_GROUND = 0.4  # of the speed over ground: less airspeed is a tail wind of more than half of it
OLD_FIX, CRAWLS = 3.0, 1.0  # [s] of one velocity, of more than so many [m/s]: no aircraft flies so evenly
FALL = 2.0  # [s] in which a pitot loses its pressure, and an aeroplane cannot lose the speed
SHARE_BY_FORCE = 0.5  # of the fall that accelerometers have to see before it is believed


def airspeed(columns: Mapping[str, Array]) -> Array | None:
    """(N,) V [m/s], else what the dynamic pressure makes of it, else calibrated airspeed; None without a pitot."""
    if "V" in columns:
        return columns["V"]
    if "p_dynamic" in columns:
        density = columns.get("rho", np.full(columns["p_dynamic"].size, SEA_LEVEL_DENSITY))
        with np.errstate(invalid="ignore"):
            return np.asarray(np.sqrt(2.0 * np.maximum(columns["p_dynamic"], 0.0) / density))
    return columns.get("V_cas")


def flies_from(V: Array) -> float:
    """Airspeed [m/s] from which the aircraft flies: half of what a slow one flies at throughout, else FLYING."""
    known = V[np.isfinite(V)]
    largest, middle = (float(known.max()), float(np.median(known))) if known.size else (0.0, 0.0)
    steady = largest < FLYING and largest > SLOW_FLYER and middle > 0.5 * largest
    return 0.5 * middle if steady else FLYING


def in_flight(V: Array) -> Mask:
    """(N,) samples with an airspeed of flight: on the ground a recording may last longer than in the air."""
    with np.errstate(invalid="ignore"):
        return np.asarray(flies_from(V) <= V)


def calibration_error(detail: Mapping[str, object], V: Array) -> float:
    """Relative 1 sigma of an airspeed (N,) [m/s] in flight as the calibration in a provenance's detail states it; 0 where none is
    stated, as of a log, or nothing flies."""
    stated = detail.get("uncertainty")
    sigma = stated.get("V") if isinstance(stated, Mapping) else None
    if not isinstance(sigma, int | float) or not 0.0 < sigma < math.inf or not (flying := in_flight(V)).any():
        return 0.0
    return float(sigma) / float(np.median(V[flying]))


def ground_speed(time: Array, columns: Mapping[str, Array]) -> Array | None:
    """(N,) speed over ground [m/s], NaN where a fix in motion stands still: old values. None without."""
    if not {"vn", "ve"} <= columns.keys():
        return None
    speed = np.hypot(columns["vn"], columns["ve"])
    for a, b in true_runs(np.diff(speed, prepend=np.nan) == 0.0):
        if time[b - 1] - time[a] >= OLD_FIX and speed[a] > CRAWLS:
            speed[a:b] = np.nan
    return speed


def lost_airspeed(time: Array, columns: Mapping[str, Array], segments: Iterable[slice] | None = None) -> Mask:
    """(N,) samples at which the airspeed is next to none and the aircraft flies on: by its speed over ground or, without, by
    accelerometers and pitch, which see no such fall. None where the airspeed never told, or nothing else does."""
    speed = airspeed(columns)
    lost = np.zeros(time.size, bool)
    if speed is None or np.isfinite(speed).sum() < 2:
        return lost
    usual = float(np.nanquantile(speed, 0.9))
    ground = ground_speed(time, columns)
    with np.errstate(invalid="ignore"):
        low = speed < LOST * usual
        if ground is not None:
            cruise = float(np.nanmedian(ground[~low])) if np.isfinite(ground[~low]).any() else np.inf
            flies = (ground > STILL_FLYING * cruise) & (speed < AGAINST_GROUND * ground)
    for a, b in true_runs(low, segments):
        if time[b - 1] - time[a] < LASTS:
            continue
        if ground is None or not np.isfinite(ground[a:b]).any():
            lost[a:b] = _fell(time, speed, columns, a)
        elif flies[a:b].any():
            first, last = (np.flatnonzero(flies[a:b])[[0, -1]] + a).tolist()
            lost[first : last + 1] = time[last] - time[first] >= LASTS
    return lost


def _fell(time: Array, speed: Array, columns: Mapping[str, Array], start: int) -> bool:
    """Whether the airspeed fell from that of flight at once, which neither thrust, drag nor a climb made it do."""
    if not {"ax", "theta"} <= columns.keys():
        return False
    rows = np.flatnonzero((time > time[start] - FALL) & (time <= time[start]))
    before = float(np.nanmax(speed[rows], initial=0.0))
    if before < 2.0 * float(speed[start]) or rows.size < 2:
        return False
    push = columns["ax"][rows] - GRAVITY * np.sin(columns["theta"][rows])
    return bool(np.isfinite(push).any()) and -float(np.nanmean(push)) * FALL < SHARE_BY_FORCE * (
        before - float(speed[start])
    )
