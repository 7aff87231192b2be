"""Columns with implausible numbers: degrees for radians, a wrong sign, another unit of time, wild values.

A fit would accept them and give wrong derivatives, so they are refused before it, or noted.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from daq.contract.channels import COLUMN_BY_NAME
from daq.utilities.constants import RADIAN
from estimation.errors import DataError
from estimation.models.base import Signal
from groundstation.flight import Array, Flight
from groundstation.flight.contradictions import no_airspeed
from groundstation.flight.findings import Finding, FindingKind
from groundstation.flight.quality.repeats import STUCK_SAMPLES, span_of

BOUNDED_ANGLES = ("theta", "alpha", "beta", "delta_e", "delta_a", "delta_r", "cmd_e", "cmd_a", "cmd_r")
"""Angles that never exceed a right angle."""

TURNING_ANGLES = ("phi", "psi")
"""Angles that may run through full turns: a continued roll through inverted flight is no jump."""

RATES = {"p": "phi", "q": "theta"}
"""Rate -> the angle whose derivative it is while bank and pitch are moderate."""

FASTEST = 20.0  # rad/s: 1100 deg/s, beyond any aircraft
LARGE = 0.7  # rad: flow and surface angles beyond 40 deg are rare
USUAL = 0.99  # quantile of a column's size that is compared with a limit: single wild values do not count
RELATED = 0.7  # correlation from which a rate and the slope of its angle show a difference in units
UNIT_FACTOR = 2.0  # a ratio within this factor of 57 or 1000 is one of units
ABSURD = 1e9  # rad/s: no unit or clock makes such a rate, but a damaged record may contain it
WILD = 2.0  # times the range of a channel: a spike within it may be real, and hardly affects a fit
MOST_WILD = 0.01  # of a column's values: more spikes are no accident
SLOWEST = 5.0  # s between samples, a fifth of a phugoid: slower records show nothing that an estimate needs
SAME_UNITS = {
    "radian": "rad", "radians": "rad", "rad/sec": "rad/s", "rads-1": "rad/s", "m/sec": "m/s", "ms-1": "m/s", "ms-2": "m/s2",
    "m/s/s": "m/s2", "kgm-3": "kg/m3", "-": "1", "newton": "N", "kelvin": "K", "pascal": "Pa",
}  # fmt: skip
"""Other spellings of the flight format's units."""
TIME_UNITS = {"milliseconds": 1e3, "microseconds": 1e6}


def refuse_impossible(
    flight: Flight, driving: Sequence[Signal], outputs: Sequence[Signal], notes: list[Finding]
) -> None:
    """DataError for a column with another unit or sign; unlikely numbers get a note in `notes`.

    driving: inputs and states, whose airspeed and density the model divides by; outputs: may belong to an aircraft at rest.
    Only columns in the same unit in model and flight format are judged; a model that states another unit is refused.
    """
    for s in (*driving, *outputs):
        _refuse_stated_unit(flight, s)
    divisors = {s.source for s in driving}
    model_units = {(s.source, s.unit) for s in (*driving, *outputs)}
    judged = [c for c, column in COLUMN_BY_NAME.items() if (c, column.unit) in model_units and flight.measured(c)]
    for name in judged:
        values = flight[name][np.isfinite(flight[name])]
        if COLUMN_BY_NAME[name].unit == "rad":
            _check_angle(flight, name, values, notes)
        elif name in ("p", "q", "r"):
            _refuse_degrees(flight, name, float(np.quantile(np.abs(values), USUAL)), FASTEST, "rad/s")
        elif name in ("V", "rho") and (values.min() <= 0.0 if name in divisors else np.median(values) < 0.0):
            _refuse_sign(flight, name, values)
    for rate, angle in RATES.items():
        if rate in judged and angle in judged:
            _refuse_other_unit(flight, rate, angle)


def _refuse_stated_unit(flight: Flight, signal: Signal) -> None:
    """DataError where a model states another unit for a column than the flight format."""
    column = COLUMN_BY_NAME.get(signal.source)
    if column is None or not signal.unit:
        return
    if _plain_unit(signal.unit) not in {_plain_unit(column.unit), *(("1",) if column.unit == "rad" else ())}:
        raise DataError(
            f"{flight.name}: the model states {signal.name} in {signal.unit}, and flights hold {signal.source} in {column.unit}:"
            f' write the equations for {column.unit} and state unit = "{column.unit}", or convert in them'
        )


def _plain_unit(unit: str) -> str:
    """A unit in one spelling, whether written m/s^2, m/s**2 or m s-2, rad or radians."""
    text = unit.strip().replace("**", "").replace("^", "").replace("²", "2").replace("³", "3").replace(" ", "")
    return SAME_UNITS.get(text, text)


def _check_angle(flight: Flight, name: str, values: Array, notes: list[Finding]) -> None:
    """DataError for an angle in degrees; a note where it may be."""
    size = float(np.quantile(np.abs(values), USUAL))
    if name in BOUNDED_ANGLES:
        _refuse_degrees(flight, name, size, 0.5 * np.pi, "rad")
        if name != "theta" and size > LARGE:
            text = f"{name} reaches {size:.2g} rad ({size * RADIAN:.0f} deg): make sure that it is in radians"
            notes.append(Finding(FindingKind.UNLIKELY, text))
    elif name in TURNING_ANGLES and np.abs(np.diff(values)).max(initial=0.0) > 1.5 * 2.0 * np.pi:
        _refuse_degrees(flight, name, size, 0.0, "rad")  # a jump from 180 to -180 deg is 57 times a turn


def _refuse_degrees(flight: Flight, name: str, size: float, limit: float, unit: str) -> None:
    if size > limit:
        raise DataError(
            f"{flight.name}: {name} reaches {size:.3g}, which cannot be {unit}: it looks like degrees; "
            "convert the file with 'sideslip import', or multiply by pi/180"
        )


def _refuse_sign(flight: Flight, name: str, values: Array) -> None:
    times = flight.time[np.isfinite(flight[name])][values <= 0.0]
    unit = COLUMN_BY_NAME[name].unit
    reason = no_airspeed(flight) if name == "V" else ""
    raise DataError(
        f"{flight.name}: {name} is {values.min():.3g} {unit} (zero or less at {times.size} samples, first at t = "
        f"{times[0]:g} s)" + (reason or _remedy(name, values))
    )


def _remedy(name: str, values: Array) -> str:
    """What to do about a column that is not above zero everywhere."""
    if not values.any():
        return f"; a dead channel: fill {name} in, or leave its column out"
    if (values <= 0.0).all():
        return "; turn its sign"
    return "; turn its sign, or leave that time out (--segments of estimate and match, or cut the file)"


def _refuse_other_unit(flight: Flight, rate: str, angle: str) -> None:
    """DataError where a rate is about 57 times the slope of its angle, or a 57th of it."""
    ratio = _ratio_to_slope(flight, rate, angle)
    if ratio is None:
        return
    for suspect, right, factor in ((rate, angle, ratio), (angle, rate, 1.0 / ratio)):
        if RADIAN / UNIT_FACTOR < factor < RADIAN * UNIT_FACTOR:
            raise DataError(
                f"{flight.name}: {suspect} is {factor:.0f} times too large beside {right}: one is in degrees, the other in "
                "radians; convert the file with 'sideslip import'"
            )


def _ratio_to_slope(flight: Flight, rate: str, angle: str) -> float | None:
    """Size of a rate over that of the slope of its angle; None where the two are not correlated."""
    dt = np.diff(flight.time)
    same_segment = np.diff(flight.segment) == 0
    with np.errstate(invalid="ignore", over="ignore"):  # what infinities make is not usable
        jump = np.diff(flight[angle])
        slope = jump / dt
        mean = 0.5 * (flight[rate][1:] + flight[rate][:-1])
        usable = same_segment & (np.abs(slope) < ABSURD) & (np.abs(mean) < ABSURD) & (np.abs(jump) < np.pi)
    if usable.sum() < 2 * STUCK_SAMPLES:
        return None
    a, b = slope[usable] - slope[usable].mean(), mean[usable] - mean[usable].mean()
    if a.std() == 0.0 or b.std() == 0.0 or float(a @ b) < RELATED * float(np.linalg.norm(a) * np.linalg.norm(b)):
        return None
    return float(np.linalg.norm(b) / np.linalg.norm(a))


def refuse_other_time_unit(flight: Flight) -> None:
    """DataError where time is not in seconds.

    Evidence is an attitude that turns a thousand times too slowly for its rate, or samples further apart than SLOWEST.
    """
    for rate, angle in RATES.items():
        if not (flight.measured(rate) and flight.measured(angle)):
            continue
        ratio = _ratio_to_slope(flight, rate, angle)
        for unit, factor in TIME_UNITS.items():
            if ratio is not None and factor / UNIT_FACTOR < ratio < factor * UNIT_FACTOR:
                raise DataError(
                    _time_unit_text(flight, unit, f"{angle} turns {factor:.0e} times too slowly for {rate}")
                )
    if flight.sample_interval > SLOWEST:
        unit = "microseconds" if flight.sample_interval > 1e3 * SLOWEST else "milliseconds"
        raise DataError(_time_unit_text(flight, unit, f"samples lie {flight.sample_interval:g} s apart"))


def _time_unit_text(flight: Flight, unit: str, evidence: str) -> str:
    return (
        f"{flight.name}: time looks like {unit}, it must be in seconds ({evidence}); "
        "convert the file with 'sideslip import', or divide the column time"
    )


def wild_values(values: Array) -> NDArray[np.bool_]:
    """(N,) single values that differ from the median of five by more than WILD times the range of the channel.

    None where they are more than MOST_WILD of the values.
    """
    rows = np.flatnonzero(np.isfinite(values))
    result = np.zeros(values.size, bool)
    if rows.size < STUCK_SAMPLES:
        return result
    z = values[rows]
    around = np.lib.stride_tricks.sliding_window_view(np.pad(z, 2, mode="edge"), 5)
    wild = np.abs(z - np.median(around, axis=1)) > WILD * span_of(z)
    if wild.sum() <= max(1, MOST_WILD * z.size):
        result[rows[wild]] = True
    return result
