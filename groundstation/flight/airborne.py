"""When an aircraft flew on its wings: not on the ground, not rolling to lift off or after touching down, not hovering."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.contract.constants import SEA_LEVEL_DENSITY
from groundstation.flight.flight import Flight

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

STANDS = 3.0
"""[m/s] below which an aeroplane stands, taxies or hovers, and no airspeed is measured well."""
SLOW = 0.55
"""Of the usual airspeed in flight: wings carry a third of the weight there, so something else carries the rest."""
LASTS = 2.0
"""[s] that it is slow before it counts: a stall or a gust passes."""
OFF_THE_GROUND = 3.0
"""[m] above where it stood before or after, below which an aeroplane that begins or ends slow still rolls or flares."""
LONGEST_ROLL = 60.0
"""[s] from standing to that height, and back."""


@dataclass(frozen=True)
class Airborne:
    """flying: (N,) samples on the wings. text: what was left out and why; empty where nothing was."""

    flying: Mask
    text: str


def airborne(flight: Flight) -> Airborne:
    """When the aircraft flew; all of the flight where no speed tells."""
    speed = _speed(flight)
    every = np.ones(len(flight), bool)
    if speed is None:
        return Airborne(every, "")
    moving = speed[np.isfinite(speed) & (speed > STANDS)]
    if not moving.size:
        return Airborne(every, "")
    limit = max(SLOW * float(np.median(moving)), STANDS)
    with np.errstate(invalid="ignore"):
        slow = _lasting(flight, speed < limit)
    if not slow.any():
        return Airborne(every, "")
    rolls = _rolls(flight, slow)
    flying = ~(slow | rolls)
    off = int((~flying).sum())
    seconds = off * flight.sample_interval
    text = (
        f"{seconds:.1f} s on the ground, at lift-off or landing, or in a hover are left out: slower than {limit:.3g} m/s"
        + (f", or within {OFF_THE_GROUND:g} m of the ground before and after" if (rolls & ~slow).any() else "")
    )
    return Airborne(flying, text)


def _speed(flight: Flight) -> Array | None:
    """Airspeed [m/s], or what the pressures make of it; over ground where neither is measured."""
    if flight.measured("V"):
        return flight["V"]
    if flight.measured("p_dynamic"):
        density = flight["rho"] if flight.measured("rho") else np.full(len(flight), SEA_LEVEL_DENSITY)
        with np.errstate(invalid="ignore"):
            return np.asarray(np.sqrt(2.0 * np.maximum(flight["p_dynamic"], 0.0) / density))
    if flight.measured("V_cas"):
        return flight["V_cas"]
    if flight.measured("vn") and flight.measured("ve"):
        return np.asarray(np.hypot(flight["vn"], flight["ve"]))
    return None


def _lasting(flight: Flight, mask: Mask) -> Mask:
    """Runs of a mask that last, each within its segment."""
    out = np.zeros_like(mask)
    for a, b in stretches_of(mask, flight):
        if flight.time[b - 1] - flight.time[a] >= LASTS:
            out[a:b] = True
    return out


def stretches_of(mask: Mask, flight: Flight) -> list[tuple[int, int]]:
    """[start, stop) of each run of True, cut at the borders of segments."""
    found = []
    for part in flight.segments:
        edges = np.flatnonzero(np.diff(np.concatenate([[False], mask[part], [False]]).astype(np.int8)))
        found += [(part.start + int(a), part.start + int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return found


def _rolls(flight: Flight, slow: Mask) -> Mask:
    """Samples between standing and some height, before and after."""
    out = np.zeros(len(flight), bool)
    height = next((flight[c] for c in ("altitude", "altitude_gnss") if flight.measured(c)), None)
    if height is None:
        return out
    for part in flight.segments:
        at, h = slow[part], height[part]
        for way in (1, -1):
            out[part][::way] |= _roll(flight.time[part][::way], at[::way], h[::way])
    return out


def _roll(time: Array, slow: Mask, height: Array) -> Mask:
    """The same from the beginning on of a segment that begins slow."""
    out = np.zeros(slow.size, bool)
    if not slow[0]:
        return out
    stop = int(np.argmin(slow)) if not slow.all() else slow.size
    ground = float(np.nanmedian(height[:stop])) if np.isfinite(height[:stop]).any() else np.nan
    with np.errstate(invalid="ignore"):
        above = np.flatnonzero((height > ground + OFF_THE_GROUND) & (np.arange(slow.size) >= stop))
    if above.size and abs(time[above[0]] - time[stop - 1]) <= LONGEST_ROLL:
        out[stop : above[0]] = True
    return out
