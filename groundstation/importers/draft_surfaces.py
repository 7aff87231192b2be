"""Surfaces from the servo outputs of a log, for a draft map: the surface by SERVOn_FUNCTION, the sign by the aircraft's response.
The size of the deflection is in no log and must be measured.

Signs: trailing edge down positive, rudder to port. Elevator down pitches down, rudder to port yaws to port, the right aileron
down rolls left: delta_a = (right - left) / 2.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np

from groundstation.importers.functions import OUTPUT, function_name
from groundstation.importers.series import Array, Log, TimeSeries, native_rate
from groundstation.importers.servos import parameter_of

THROW = 20.0  # [deg] at the ends of the travel, written into a draft until a person has measured them
LARGEST_DELAY = 0.05
"""[s] from a step of a servo to the change of the rate's slope: a later change is the return of a Dutch roll."""
FEWEST_RECORDS = 200  # of an output, to determine a sign
FEWEST_RATES = 20  # of a gyro: far too few for a sign
SHORTEST_COMMON_S = 10.0  # of output and rate
LEAST_STANDARD_ERRORS = 6.0  # of a response, to determine a sign
_RATE = 50.0  # [Hz] to which output and rate are resampled
_LEAST_STD = 1e-12  # of a residual: guards the division
_DELAY_STEP = 0.01  # [s] between the delays that are tried
_TURN = 0.08
"""[s] before and after an instant between which slopes are compared: longer than a servo's lag, far below half a Dutch roll."""


@dataclass(frozen=True, slots=True)
class OutputFunction:
    """The effect of one SERVOn_FUNCTION. rate: whose response shows the sign; rate_sign: of its change for trailing edge down
    (rudder: to port); shares: surface -> factor of this output in it."""

    name: str
    rate: str
    rate_sign: int
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
"""SERVOn_FUNCTION -> its effect; a function "aileron" is taken as the right aileron, which rolls left when it goes down."""


Shares = Mapping[str, Mapping[str, float]]
"""Surface -> servo -> factor of the servo in the surface."""


def drafted_servos(log: Log, rates: Mapping[str, str]) -> tuple[list[str], Shares]:
    """The lines [servos] of a draft map, and the factors of the servos in each surface. rates: p, q, r -> series of the log."""
    lines: list[str] = []
    shares: dict[str, dict[str, float]] = {}
    names: set[str] = set()
    for column, series in log.series.items():
        outputs = series.values[np.isfinite(series.values)]
        if not OUTPUT.fullmatch(column) or not outputs.size or float(np.ptp(outputs)) == 0.0:
            continue
        function = _parameter(log, column, "FUNCTION")
        part = PARTS.get(round(function)) if function is not None else None
        if part is None:
            moves = "UNKNOWN: the log does not say"
            if function is not None:
                moves = f"{function_name(function)} by {parameter_of(column, 'FUNCTION')}"
            extent = f"{outputs.min():g} to {outputs.max():g}"
            lines.append(f"# {column}: {extent}; {moves}; in no surface of this draft")
            continue
        numbered = (part.name if n == 1 else f"{part.name}_{n}" for n in count(1))
        name = next(n for n in numbered if n not in names)
        names.add(name)
        lines += _servo_lines(log, column, name, part, rates.get(part.rate, ""))
        for surface, factor in part.shares.items():
            shares.setdefault(surface, {})[name] = factor
    return lines, shares


def _servo_lines(log: Log, column: str, name: str, part: OutputFunction, rate: str) -> list[str]:
    """The section of one servo. column: series of its output; name: of the servo; rate: series that shows the sign."""
    series = log.series[column]
    outputs = series.values[np.isfinite(series.values)]
    trim, low, high = (_parameter(log, column, e) for e in ("TRIM", "MIN", "MAX"))
    begin, end = float(outputs.min()), float(outputs.max())
    if low is not None and high is not None and low < high:
        begin, end = low, high
    middle = trim if trim is not None and begin < trim < end else float(np.median(outputs))
    if not begin < middle < end:
        half = 0.5 * max(end - begin, 1.0)
        begin, end = middle - half, middle + half
    sign, evidence = sign_of(by_hand(log, series), middle, log.series.get(rate), part.rate_sign, rate)
    ends = "MIN and MAX" if low is not None and high is not None else "least and largest output seen, UNKNOWN ends"
    origin = f"{part.name.replace('_', ' ')} by {parameter_of(column, 'FUNCTION')}"
    trim_origin = parameter_of(column, "TRIM") if trim == middle else "UNKNOWN: the median output"
    gauge = "deflections UNKNOWN: measure them with an angle gauge"
    return [
        "",
        f"[servos.{name}]",
        f'column = "{column}"      # {origin}; outputs {outputs.min():g} to {outputs.max():g}',
        f"trim = {middle:g}      # {trim_origin}",
        f"travel = [[{begin:g}, {-sign * THROW:g}], [{end:g}, {sign * THROW:g}]]      # {ends}; {gauge}; {evidence}",
        'unit = "deg"',
        "# lag = 0.05      # [s] of the servo, first order; UNKNOWN",
    ]


def _parameter(log: Log, column: str, ending: str) -> float | None:
    return log.parameters.get(parameter_of(column, ending) or "")


def by_hand(log: Log, series: TimeSeries) -> TimeSeries:
    """The series with NaN outside mode MANUAL; unchanged where the log has too little of that mode."""
    manual = np.zeros(series.time.size, bool)
    for mode in log.marks.modes:
        if mode.name == "MANUAL":
            manual |= (series.time >= mode.start) & (series.time < mode.stop)
    if manual.sum() < FEWEST_RECORDS:
        return series
    return TimeSeries(series.time, np.where(manual, series.values, np.nan))


def sign_of(output: TimeSeries, trim: float, rate: TimeSeries | None, rate_sign: int, name: str) -> tuple[int, str]:
    """Sign of the deflection at the upper end of the travel, by the response of a rate to the output; and the evidence as text.

    output: NaN where it is not to be used; trim: its value at zero deflection; rate: [rad/s]; rate_sign: as in
    `OutputFunction`; name: of the rate. The sign is 1 where it is not known.
    """
    if rate is None or rate.time.size < FEWEST_RATES or native_rate(output) <= 0:
        return 1, "sign UNKNOWN: no rate that shows it"
    start, stop = max(output.time[0], rate.time[0]), min(output.time[-1], rate.time[-1])
    time = np.arange(start, stop, 1 / _RATE)
    if time.size < SHORTEST_COMMON_S * _RATE:
        return 1, "sign UNKNOWN: too short"
    rows = np.searchsorted(output.time, time, side="right") - 1
    u = output.values[np.clip(rows, 0, output.time.size - 1)] - trim
    y = np.interp(time, rate.time, rate.values)
    delays = np.arange(-LARGEST_DELAY, LARGEST_DELAY, _DELAY_STEP)
    response = max((_response(u, y, round(delay * _RATE)) for delay in delays), key=abs)
    if abs(response) < LEAST_STANDARD_ERRORS:
        return 1, f"sign UNKNOWN: {name} does not tell"
    sign = rate_sign * (1 if response > 0 else -1)
    return sign, f"sign by the change of {name} after it moves ({abs(response):.0f} standard errors)"


def _response(u: Array, y: Array, delay: int) -> float:
    """t statistic of the regression of the change of y's slope on the jump of u `delay` samples before. Slow motion and feedback
    have no effect within so short a time."""
    h = round(_TURN * _RATE)
    jump = np.roll(u, delay)[h:] - np.roll(u, delay)[:-h]
    turn = y[2 * h :] - 2.0 * y[h:-h] + y[: -2 * h]
    n = min(jump.size, turn.size)
    x, z = jump[h // 2 : h // 2 + n - h], turn[: n - h]
    use = np.isfinite(x) & np.isfinite(z)
    x, z = x[use], z[use]
    if x.size < FEWEST_RECORDS:
        return 0.0
    x, z = x - x.mean(), z - z.mean()
    power = float(x @ x)
    if power <= 0.0:
        return 0.0
    slope = float(x @ z) / power
    residual = z - slope * x
    return slope * float(np.sqrt(power)) / max(float(np.std(residual)), _LEAST_STD)


def surface_lines(shares: Shares, missing: Sequence[str]) -> list[str]:
    """The surfaces of a draft map as mixes of its servos. missing: surfaces without an output."""
    lines = []
    for surface, parts in shares.items():
        if set(parts.values()) == {1.0}:
            parts = dict.fromkeys(parts, 1.0 / len(parts))
        terms = ", ".join(f'{{ column = "servo.{n}", factor = {f:g} }}' for n, f in parts.items())
        single = next(iter(parts))
        source = f'column = "servo.{single}"' if parts == {single: 1.0} else f"terms = [{terms}]"
        lines.append(f"{surface} = {{ {source} }}")
    return [*lines, *(f"# {s} = UNKNOWN: no output has such a function" for s in missing)]
