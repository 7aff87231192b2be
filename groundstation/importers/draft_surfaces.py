"""Servo outputs of a log as surfaces: which, by SERVOn_FUNCTION; which way, by what the aircraft did; how far, nobody can know.

Signs: trailing edge down positive, rudder to port. Elevator down pitches down, rudder to port yaws to port, the right aileron
down rolls left: delta_a = (right - left) / 2.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from groundstation.importers.functions import name_of
from groundstation.importers.recipe import OUTPUT
from groundstation.importers.series import Array, Log, TimeSeries, native_rate
from groundstation.importers.servos import parameter_of

THROW = 20.0
"""[deg] that a draft writes where the deflection at the ends of the travel must be measured."""
LATEST = 0.05
"""[s] after a move of a servo at which the rate turns: later ones are turns of a Dutch roll on its way back."""
SHORTEST = 200
"""Records of an output in MANUAL that are enough to tell from."""
SURE = 6.0
"""Standard errors of a response that tell a sign."""
_RATE = 50.0
_TURN = 0.08
"""[s] before and after an instant between which a slope turns: a servo's lag, and far from half a Dutch roll."""


@dataclass(frozen=True, slots=True)
class OutputFunction:
    """What one function of an output does. response: rate that tells its sign; answer: sign of that rate's change by a trailing
    edge down (rudder: to port); shares: surface -> its factor in it."""

    name: str
    response: str
    answer: int
    shares: Mapping[str, float]


PARTS: Mapping[int, OutputFunction] = {
    4: OutputFunction("aileron", "p", -1, {"delta_a": 1.0}),
    19: OutputFunction("elevator", "q", -1, {"delta_e": 1.0}),
    21: OutputFunction("rudder", "r", -1, {"delta_r": 1.0}),
    24: OutputFunction("flaperon_left", "p", 1, {"delta_a": -0.5}),
    25: OutputFunction("flaperon_right", "p", -1, {"delta_a": 0.5}),
    77: OutputFunction("elevon_left", "q", -1, {"delta_e": 0.5, "delta_a": -0.5}),
    78: OutputFunction("elevon_right", "q", -1, {"delta_e": 0.5, "delta_a": 0.5}),
    79: OutputFunction("tail_left", "q", -1, {"delta_e": 0.5, "delta_r": 0.5}),
    80: OutputFunction("tail_right", "q", -1, {"delta_e": 0.5, "delta_r": -0.5}),
}
"""SERVOn_FUNCTION -> what it moves; an aileron is drafted as the right one, which rolls left when it goes down."""


@dataclass(frozen=True, slots=True)
class Drafted:
    """lines: of the mapping; shares: surface -> servo -> factor."""

    lines: tuple[str, ...]
    shares: Mapping[str, Mapping[str, float]]


def drafted_servos(log: Log, rates: Mapping[str, str]) -> Drafted:
    """The [servos] of a draft. rates: p, q, r -> series of the log."""
    lines: list[str] = []
    shares: dict[str, dict[str, float]] = {}
    taken: set[str] = set()
    for column, series in log.series.items():
        known = series.values[np.isfinite(series.values)]
        if not OUTPUT.fullmatch(column) or not known.size or float(np.ptp(known)) == 0.0:
            continue
        function = _parameter(log, column, "FUNCTION")
        part = PARTS.get(round(function)) if function is not None else None
        if part is None:
            by = f"{name_of(function)} by {parameter_of(column, 'FUNCTION')}" if function is not None else ""
            moved = by or "UNKNOWN: the log does not say"
            lines.append(f"# {column}: {known.min():g} to {known.max():g}; {moved}; in no surface of this draft")
            continue
        name, number = part.name, 2
        while name in taken:
            name, number = f"{part.name}_{number}", number + 1
        taken.add(name)
        lines += _servo_lines(log, column, name, part, series, rates.get(part.response, ""))
        for surface, factor in part.shares.items():
            shares.setdefault(surface, {})[name] = factor
    return Drafted(tuple(lines), shares)


def _servo_lines(log: Log, column: str, name: str, part: OutputFunction, series: TimeSeries, rate: str) -> list[str]:
    trim, low, high = (_parameter(log, column, e) for e in ("TRIM", "MIN", "MAX"))
    seen = series.values[np.isfinite(series.values)]
    begin, end = (
        (low, high) if low is not None and high is not None and low < high else (float(seen.min()), float(seen.max()))
    )
    middle = trim if trim is not None and begin < trim < end else float(np.median(seen))
    if not begin < middle < end:
        begin, end = middle - 0.5 * max(end - begin, 1.0), middle + 0.5 * max(end - begin, 1.0)
    sign, why = sign_of(by_hand(log, series), middle, log.series.get(rate), part.answer, rate)
    travel = f"travel = [[{begin:g}, {-sign * THROW:g}], [{end:g}, {sign * THROW:g}]]"
    ends = "MIN and MAX" if low is not None and high is not None else "least and largest output seen, UNKNOWN ends"
    by = f"{part.name.replace('_', ' ')} by {parameter_of(column, 'FUNCTION')}"
    stated = parameter_of(column, "TRIM") if trim == middle else "UNKNOWN: the median output"
    gauge = "deflections UNKNOWN: measure them with an angle gauge"
    return [
        "",
        f"[servos.{name}]",
        f'column = "{column}"      # {by}; outputs {seen.min():g} to {seen.max():g}',
        f"trim = {middle:g}      # {stated}",
        f"{travel}      # {ends}; {gauge}; {why}",
        'unit = "deg"',
        "# lag = 0.05      # [s] of the servo, first order; UNKNOWN",
    ]


def _parameter(log: Log, column: str, ending: str) -> float | None:
    name = parameter_of(column, ending)
    return log.parameters.get(name) if name else None


def by_hand(log: Log, series: TimeSeries) -> TimeSeries:
    """A series where the pilot alone moved the surfaces, by the modes of the log; all of it where they do not say so."""
    spans = [m for m in log.marks.modes if m.name == "MANUAL"]
    inside = np.zeros(series.time.size, bool)
    for span in spans:
        inside |= (series.time >= span.start) & (series.time < span.stop)
    return TimeSeries(series.time, np.where(inside, series.values, np.nan)) if inside.sum() >= SHORTEST else series


def sign_of(output: TimeSeries, trim: float, rate: TimeSeries | None, answer: int, name: str) -> tuple[int, str]:
    """Sign of the deflection at the upper end of the travel, and why: the change of a rate after the output moved.

    output: NaN where it is not to be used.
    """
    if rate is None or rate.time.size < 20 or native_rate(output) <= 0:
        return 1, "sign UNKNOWN: no rate to tell it from"
    start, stop = max(output.time[0], rate.time[0]), min(output.time[-1], rate.time[-1])
    time = np.arange(start, stop, 1 / _RATE)
    if time.size < 10 * _RATE:
        return 1, "sign UNKNOWN: too short"
    at = np.searchsorted(output.time, time, side="right") - 1
    u = output.values[np.clip(at, 0, output.time.size - 1)] - trim
    y = np.interp(time, rate.time, rate.values)
    best = max((_response(u, y, round(late * _RATE)) for late in np.arange(-LATEST, LATEST, 0.01)), key=abs)
    if abs(best) < SURE:
        return 1, f"sign UNKNOWN: {name} does not tell"
    sign = answer * (1 if best > 0 else -1)
    return sign, f"sign by the change of {name} after it moves ({abs(best):.0f} standard errors)"


def _response(u: Array, y: Array, late: int) -> float:
    """Standard errors of what a jump of u does, some samples later, to the slope of y: the turn of y about each instant against
    the jump of u about it. What moves y slowly, and feedback, have no part in a turn so short."""
    h = round(_TURN * _RATE)
    jump = np.roll(u, late)[h:] - np.roll(u, late)[:-h]
    turn = y[2 * h :] - 2.0 * y[h:-h] + y[: -2 * h]
    n = min(jump.size, turn.size)
    x, z = jump[h // 2 : h // 2 + n - h], turn[: n - h]
    use = np.isfinite(x) & np.isfinite(z)
    x, z = x[use], z[use]
    if x.size < SHORTEST:
        return 0.0
    x, z = x - x.mean(), z - z.mean()
    power = float(x @ x)
    if power <= 0.0:
        return 0.0
    slope = float(x @ z) / power
    rest = z - slope * x
    return slope * float(np.sqrt(power)) / max(float(np.std(rest)), 1e-12)


def surface_lines(shares: Mapping[str, Mapping[str, float]], lacking: Sequence[str]) -> list[str]:
    """The surfaces of a draft, mixed of its servos."""
    lines = []
    for surface, parts in shares.items():
        if set(parts.values()) == {1.0}:
            factor = 1.0 / len(parts)
            parts = dict.fromkeys(parts, factor)
        terms = ", ".join(f'{{ column = "servo.{n}", factor = {f:g} }}' for n, f in parts.items())
        single = next(iter(parts))
        made = f'{{ column = "servo.{single}" }}' if parts == {single: 1.0} else f"{{ terms = [{terms}] }}"
        lines.append(f"{surface} = {made}")
    return [*lines, *(f"# {s} = UNKNOWN: no output is said to move it" for s in lacking)]
