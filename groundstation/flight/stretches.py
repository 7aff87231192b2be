"""Stretches of a flight as `--segments` gives them, and the times at which the aircraft was in the air.

`2:12,15:25` [s], `mode:MANUAL`, `V > 12 and abs(phi) < 0.5`, `mode:FBWA and V > 12`. Stretches by mode or condition leave out
times without lift of the wings (on the ground, rolling, hovering), and runs too short for a manoeuvre.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.utilities.plain_words import listed
from groundstation.flight.airspeed import airspeed, ground_speed, lost_airspeed
from groundstation.flight.arrays import Array, Mask, hold_recent, true_runs
from groundstation.flight.errors import FlightError
from groundstation.flight.expression import MODE, Expression, parse_condition
from groundstation.flight.flight import Flight
from groundstation.flight.marks import FlightMode, marks_of

SHORTEST_STRETCH = 1.0  # [s] of a stretch by mode or condition: a shorter one holds no manoeuvre
MOST_MODES_SHOWN, MOST_COLUMNS_SHOWN = 12, 40  # in a message
STANDING_SPEED = 3.0  # [m/s] below which an aeroplane stands, taxies or hovers, and no pitot measures well
SLOW_SHARE = 0.55  # of the median airspeed, below which wings carry less than a third of the weight
STANDING_SHARE = 0.35
"""Share of the largest airspeed, used where that is less: a model that flies at 4 m/s does not stand at 2 m/s."""
ALMOST_LARGEST = 0.98  # quantile that counts as the largest airspeed, so that spikes do not
GROUND_SHARE = 0.5  # of the ground speed in flight, below which the aircraft stands or taxies
SHORTEST_SLOW = 2.0  # [s] of low airspeed: a stall or a gust is shorter
FLYING_HEIGHT = 3.0  # [m] above the ground, below which an aeroplane at the start or end of a record rolls or flares
LONGEST_ROLL = 60.0  # [s] from standing to that height, or back
_TIMES = re.compile(r"(?:[\s\d.eE+\-,]|inf|nan)*:(?:[\s\d.eE+\-:,]|inf|nan)*|[\s\d.eE+\-,]+")


class StretchError(FlightError):
    """A text that names no stretch of a flight."""


@dataclass(frozen=True)
class LabelledStretches:
    """label: (N,) number of each sample's stretch, -1 outside; notes: sentences on what was left out, and why."""

    label: NDArray[np.int64]
    notes: tuple[str, ...] = ()


def is_times(text: str) -> bool:
    """Whether a text of `--segments` gives stretches by times (or is empty), not by mode or condition."""
    return not text.strip() or _TIMES.fullmatch(text.strip()) is not None


def stretches_where(flight: Flight, text: str) -> LabelledStretches:
    """The stretches of a flight in which a condition holds. FlightError for a text that is no condition, a column or mode that
    the flight does not have, or a condition that holds nowhere for long enough."""
    condition = parse_condition(text)
    columns = _condition_columns(flight, condition)
    holds = (condition.values(columns) > 0.0) & np.all([np.isfinite(c) for c in columns.values()], axis=0)
    flight_phase = airborne(flight)
    notes = [flight_phase.text] if flight_phase.text and (holds & ~flight_phase.flying).any() else []
    runs = true_runs(holds & flight_phase.flying, flight.segments)
    stretches = [(a, b) for a, b in runs if flight.time[b - 1] - flight.time[a] >= SHORTEST_STRETCH]
    if len(runs) > len(stretches):
        notes.append(f"{len(runs) - len(stretches)} stretches of '{text}' shorter than {SHORTEST_STRETCH:g} s left out")
    if not stretches:
        reason = "; ".join(notes) or f"it holds at {int(holds.sum())} of {len(flight)} samples"
        raise StretchError(f"--segments {text!r}: nothing of {flight.name} is left: {reason}")
    label = np.full(len(flight), -1, np.int64)
    for number, (a, b) in enumerate(stretches):
        label[a:b] = number
    return LabelledStretches(label, tuple(notes))


def _condition_columns(flight: Flight, condition: Expression) -> dict[str, Array]:
    """The columns (N,) that a condition names; a mode is 1 where the autopilot was in it, else 0."""
    modes = marks_of(flight).modes
    columns: dict[str, Array] = {}
    for name in condition.columns:
        if name.startswith(MODE):
            columns[name] = _in_mode(flight, name.removeprefix(MODE), modes)
        elif name == "time":
            columns[name] = flight.time
        elif flight.measured(name):
            columns[name] = flight[name]
        else:
            measured = listed(["time", *(c for c in flight.columns if flight.measured(c))], MOST_COLUMNS_SHOWN)
            raise StretchError(f"--segments {condition.text!r}: {flight.name} has no column {name}; it has {measured}")
    return columns


def _in_mode(flight: Flight, name: str, modes: Iterable[FlightMode]) -> Array:
    """(N,) 1 where the autopilot was in a mode, 0 elsewhere."""
    spans = [m for m in modes if m.name.upper() == name.upper()]
    if not spans:
        names = listed(dict.fromkeys(m.name for m in modes), MOST_MODES_SHOWN)
        hint = f"its modes are {names}" if names else "its file names no flight modes; write times like 2:12"
        raise StretchError(f"--segments mode:{name}: {flight.name} was never in it; {hint}")
    in_mode = np.zeros(len(flight))
    for span in spans:
        in_mode[(flight.time >= span.start) & (flight.time < span.stop)] = 1.0
    return in_mode


# ------------------------------------------------------------------------------------------------------- in the air


@dataclass(frozen=True)
class Airborne:
    """flying: (N,) samples in the air. text: what was left out and why; empty where nothing was. stood: whether the aircraft
    stands at the start or end of the record, by airspeed and, where measured, ground speed, and flies in between."""

    flying: Mask
    text: str
    stood: bool = False


def airborne(flight: Flight) -> Airborne:
    """When the aircraft was in the air; throughout where no speed is measured."""
    speed = hold_recent(flight.time, _speed(flight))
    standing = _standing_speed(speed)
    moving = speed[np.isfinite(speed) & (speed > standing)]
    limit = max(SLOW_SHARE * float(np.median(moving)), standing) if moving.size else 0.0
    with np.errstate(invalid="ignore"):
        slow_runs = true_runs(speed < limit, flight.segments)
    slow = np.zeros(len(flight), bool)
    for a, b in slow_runs:
        slow[a:b] = flight.time[b - 1] - flight.time[a] >= SHORTEST_SLOW
    slow &= ~lost_airspeed(flight.time, flight.columns, flight.segments)
    if not slow.any():
        return Airborne(~slow, "")
    rolls = _rolls(flight, slow)
    flying = ~(slow | rolls)
    seconds = int((~flying).sum()) * flight.sample_interval
    text = (
        f"{seconds:.1f} s on the ground, at lift-off or landing, or in a hover are left out: slower than {limit:.3g} m/s"
        + (f", or within {FLYING_HEIGHT:g} m of the ground before and after" if (rolls & ~slow).any() else "")
    )
    return Airborne(flying, text, bool(flying.any()) and _stands_at_an_end(flight, speed, standing, flying))


def _standing_speed(speed: Array) -> float:
    """Speed [m/s] below which an aeroplane stands. speed: (N,) [m/s]."""
    known = speed[np.isfinite(speed)]
    return min(STANDING_SPEED, STANDING_SHARE * float(np.quantile(known, ALMOST_LARGEST))) if known.size else 0.0


def _stands_at_an_end(flight: Flight, speed: Array, standing: float, flying: Mask) -> bool:
    """Whether a segment begins or ends below the standing speed [m/s], and the ground speed, where measured, is low there,
    too."""
    count = max(round(SHORTEST_SLOW / flight.sample_interval), 1)
    ends = [e for p in flight.segments for e in (speed[p][:count], speed[p][-count:]) if np.isfinite(e).any()]
    if not any(np.nanmedian(e) < standing for e in ends):
        return False
    ground = ground_speed(flight.time, flight.columns)
    if ground is None or not np.isfinite(ground).any():
        return True
    on_ground, in_flight = ground[~flying & np.isfinite(ground)], ground[flying & np.isfinite(ground)]
    return (
        on_ground.size > 0 and in_flight.size > 0 and bool(np.median(on_ground) < GROUND_SHARE * np.median(in_flight))
    )


def _speed(flight: Flight) -> Array:
    """(N,) airspeed [m/s], also by pressure; speed over ground where that is not measured; NaN without either."""
    speed = airspeed({n: v for n, v in flight.columns.items() if flight.measured(n)})
    if speed is not None:
        return speed
    if flight.measured("vn") and flight.measured("ve"):
        return np.asarray(np.hypot(flight["vn"], flight["ve"]))
    return np.full(len(flight), np.nan)


def _rolls(flight: Flight, slow: Mask) -> Mask:
    """(N,) samples of take-off and landing between standing and FLYING_HEIGHT."""
    rolls = np.zeros(len(flight), bool)
    height = next((flight[c] for c in ("altitude", "altitude_gnss") if flight.measured(c)), None)
    if height is None:
        return rolls
    for part in flight.segments:
        for step in (1, -1):
            rolls[part][::step] |= _first_roll(flight.time[part][::step], slow[part][::step], height[part][::step])
    return rolls


def _first_roll(time: Array, slow: Mask, height: Array) -> Mask:
    """(n,) samples of the take-off of one segment, which must begin slow; for the landing, all three arrays are reversed."""
    rolls = np.zeros(slow.size, bool)
    if not slow[0]:
        return rolls
    stop = int(np.argmin(slow)) if not slow.all() else slow.size
    ground = float(np.nanmedian(height[:stop])) if np.isfinite(height[:stop]).any() else np.nan
    with np.errstate(invalid="ignore"):
        high = np.flatnonzero((height > ground + FLYING_HEIGHT) & (np.arange(slow.size) >= stop))
    if high.size and abs(time[high[0]] - time[stop - 1]) <= LONGEST_ROLL:
        rolls[stop : high[0]] = True
    return rolls
