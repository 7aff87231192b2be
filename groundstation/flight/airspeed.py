"""The airspeed of a flight: the columns that give it, when the aircraft flies, its calibration error, and when the pitot failed
in flight (blocked by water or ice, or its tube lost)."""

import math
from collections.abc import Iterable, Mapping

import numpy as np

from daq.utilities.constants import GRAVITY, SEA_LEVEL_DENSITY
from groundstation.flight.arrays import Array, Mask, true_runs

FLYING = 5.0
"""Airspeed [m/s] from which an aircraft flies and its vanes follow the air."""
SLOW_FLYER = 1.5
"""Airspeed [m/s] that even the slowest aeroplanes exceed (50 g models in a hall fly at 2 to 5 m/s). A pitot at rest may show it
at times, so the median has to be half of the largest as well."""
LOST_SHARE = 0.3
"""Of the airspeed's 0.9 quantile, below which it is taken as lost: the wings would carry a tenth of the weight."""
SHORTEST_LOSS = 1.0  # [s]; gusts and single wild values are shorter
GROUND_SPEED_SHARE = 0.7
"""Share of the usual ground speed above which the aircraft flies: it rolls more slowly, also in a tail wind."""
AIRSPEED_OVER_GROUND = 0.4  # of the ground speed; less airspeed would be a tail wind of more than half the ground speed
OLD_FIX, OLD_FIX_SPEED = 3.0, 1.0  # [s] of one velocity above so many [m/s]: a fix that is repeated
FALL_TIME = 2.0  # [s] in which a pitot loses its pressure, but an aeroplane cannot lose its speed
SHARE_BY_FORCE = 0.5  # of a fall of the airspeed that accelerometers must show for it to be real


def airspeed(columns: Mapping[str, Array]) -> Array | None:
    """(N,) V [m/s], else the airspeed by dynamic pressure, else calibrated airspeed; None without a pitot."""
    if "V" in columns:
        return columns["V"]
    if "p_dynamic" in columns:
        density = columns.get("rho", np.full(columns["p_dynamic"].size, SEA_LEVEL_DENSITY))
        with np.errstate(invalid="ignore"):
            return np.asarray(np.sqrt(2.0 * np.maximum(columns["p_dynamic"], 0.0) / density))
    return columns.get("V_cas")


def flies_from(V: Array) -> float:
    """Airspeed [m/s] from which the aircraft flies: FLYING, or half the median of V (N,) where it never reaches that."""
    known = V[np.isfinite(V)]
    largest, middle = (float(known.max()), float(np.median(known))) if known.size else (0.0, 0.0)
    steady = largest < FLYING and largest > SLOW_FLYER and middle > 0.5 * largest
    return 0.5 * middle if steady else FLYING


def in_flight(V: Array) -> Mask:
    """(N,) samples at which V [m/s] is at least `flies_from`."""
    with np.errstate(invalid="ignore"):
        return np.asarray(flies_from(V) <= V)


def calibration_error(detail: Mapping[str, object], V: Array) -> float:
    """Relative 1 sigma of V (N,) [m/s] in flight by the calibration, from a provenance's `detail`; 0 where that states none, as
    for an imported log, or the aircraft never flies."""
    stated = detail.get("uncertainty")
    sigma = stated.get("V") if isinstance(stated, Mapping) else None
    if not isinstance(sigma, int | float) or not 0.0 < sigma < math.inf or not (flying := in_flight(V)).any():
        return 0.0
    return float(sigma) / float(np.median(V[flying]))


def ground_speed(time: Array, columns: Mapping[str, Array]) -> Array | None:
    """(N,) horizontal speed over ground [m/s], NaN where a moving receiver repeats its fix; None without GNSS."""
    if not {"vn", "ve"} <= columns.keys():
        return None
    speed = np.hypot(columns["vn"], columns["ve"])
    for a, b in true_runs(np.diff(speed, prepend=np.nan) == 0.0):
        if time[b - 1] - time[a] >= OLD_FIX and speed[a] > OLD_FIX_SPEED:
            speed[a:b] = np.nan
    return speed


def lost_airspeed(time: Array, columns: Mapping[str, Array], segments: Iterable[slice] | None = None) -> Mask:
    """(N,) samples at which the airspeed is almost zero although the aircraft flies: by its ground speed or, without it, because
    accelerometer and pitch show no such loss of speed. time: [s]; segments: unbroken stretches, all of the flight by default."""
    speed = airspeed(columns)
    lost = np.zeros(time.size, bool)
    if speed is None or np.isfinite(speed).sum() < 2:
        return lost
    usual = float(np.nanquantile(speed, 0.9))
    ground = ground_speed(time, columns)
    with np.errstate(invalid="ignore"):
        low = speed < LOST_SHARE * usual
        if ground is not None:
            cruise = float(np.nanmedian(ground[~low])) if np.isfinite(ground[~low]).any() else np.inf
            flies = (ground > GROUND_SPEED_SHARE * cruise) & (speed < AIRSPEED_OVER_GROUND * ground)
    for a, b in true_runs(low, segments):
        if time[b - 1] - time[a] < SHORTEST_LOSS:
            continue
        if ground is None or not np.isfinite(ground[a:b]).any():
            lost[a:b] = _fell(time, speed, columns, a)
        elif flies[a:b].any():
            first, last = (np.flatnonzero(flies[a:b])[[0, -1]] + a).tolist()
            lost[first : last + 1] = time[last] - time[first] >= SHORTEST_LOSS
    return lost


def _fell(time: Array, speed: Array, columns: Mapping[str, Array], start: int) -> bool:
    """Whether the airspeed fell to less than half in FALL_TIME, to the sample `start`, without the deceleration along x that this
    would need."""
    if not {"ax", "theta"} <= columns.keys():
        return False
    rows = np.flatnonzero((time > time[start] - FALL_TIME) & (time <= time[start]))
    before = float(np.nanmax(speed[rows], initial=0.0))
    if before < 2.0 * float(speed[start]) or rows.size < 2:
        return False
    acceleration = columns["ax"][rows] - GRAVITY * np.sin(columns["theta"][rows])
    if not np.isfinite(acceleration).any():
        return False
    return -float(np.nanmean(acceleration)) * FALL_TIME < SHARE_BY_FORCE * (before - float(speed[start]))
