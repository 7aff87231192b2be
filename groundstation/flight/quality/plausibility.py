"""Mistakes of unit and sign that the data show: gravity, angles beyond pi, attitude against gyro, speeds.

Each check takes time (N,) [s] and columns (N,), and yields a finding with the column, what is unusual, and the unit or sign that
would explain it.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from daq.contract.channels import COLUMN_BY_NAME
from daq.utilities.constants import FOOT, GRAVITY, MILE_PER_HOUR, NAUTICAL_MILE, RADIAN
from groundstation.flight.arrays import Array, integral, slope_and_agreement, windows
from groundstation.flight.findings import Finding, FindingKind
from groundstation.flight.kinematics import GYROS, heading_rate
from groundstation.flight.quality.axes import wrong_axes

Columns = Mapping[str, Array]
Reversals = Mapping[tuple[str, ...], tuple[str, list[tuple[Array, Array]]]]
"""Columns whose signs are reversed -> names of the columns that they would agree with, and in every window the motion and the
integral of its cause (n,)."""


REVERSED_AGREEMENT = 0.85  # least share of a motion's variance that is explained with the sign reversed
MOST_REMAINING = 1.0 / 3.0  # of the variance unexplained with the recorded sign, that may then remain unexplained
SLOPE_TOLERANCE = 0.25  # of the slope about 1, with the sign reversed
LEAST_AGREEMENT = 0.7  # share of an angle's variance that its rate explains, for their slope to count
LARGEST_RADIANS = 1.6  # of theta, or a bank angle in ordinary flight: a larger one is in degrees

ONE_G = (0.75, 1.3)  # median specific force of a flight in g; turns and pulls lie within
UNIT_RATIO = (0.8, 1.25)  # of the median specific force over one g in another unit, for that unit to be suggested
FREE_OF_GRAVITY = 0.3  # g; a smaller median specific force looks like one without gravity
UPWARD_GRAVITY = (0.5, 1.3)  # median of az in g, for its sign to be reversed
MOST_BACKWARDS = 0.02  # share of steps back in time, beyond which the rows are shuffled, or the column is not time
SAMPLE_STEP = (1e-3, 0.5)  # [s] between samples that a unit of time must give for it to be suggested
LEAST_OTHER_STEP = 4.0  # between samples as read, from which ms, us or ns is suspected in place of s
SLOWEST_STEP, FASTEST_STEP = 2.0, 1e-4  # [s] between samples, beyond which the unit of time is doubtful
EVEN_STEP, EVEN_SHARE, FEWEST_EVEN = 0.2, 0.9, 20
"""Sorted times are evenly spaced where this share of at least so many steps is within EVEN_STEP of the median."""
RANGE_MARGIN = 1e-3  # [rad] of rounding beyond the range of an angle
LARGEST_DEGREES = 370.0  # a larger angle is not in degrees
SAME_SLOPE = 1.2  # largest over smallest slope of the three angles for an error of the clock
UNIT_AGREEMENT = 0.8  # least share of the sideways motion that is explained, for its slope to show the unit of V
UNIT_TOLERANCE, UNIT_TOLERANCE_BY_GROUND = 0.08, 0.15  # relative, of a ratio of speeds from that of two units
LEAST_PRESSURE = 20.0  # [Pa], of 6 m/s: noise of the zero spoils the speed by a smaller one
LEAST_GROUND_SPEED, FEWEST_GROUND_SPEEDS = 5.0, 20  # [m/s] and samples of the ground speed for a ratio to V
LARGEST_WIND_RATIO = 1.7  # of V over ground speed; wind makes the median of a flight no larger
FEWEST_RATIOS = 5
WRAPPED_RANGE = 7.0  # [rad], a little over a turn: an angle with a larger range is not wrapped, or in degrees

_GRAVITY_IN = {"g": 1.0, "ft/s2": 32.174, "mg (or cm/s2)": 990.0}
_ANGLES = ("phi", "theta", "psi", "alpha", "beta", "delta_e", "delta_a", "delta_r", "cmd_e", "cmd_a", "cmd_r")
_RADIANS = (0.5, 2.0)
"""Slope of an angle against the integral of its gyro in the same unit; it is 57 for degrees, and -1 for the wrong sign."""

_RATES = ("p", "q", "r")
DAMAGED_FACTOR = 1e5  # times the plausible limit: beyond degrees, hundredths of them and microseconds of a servo
DAY_NUMBERS = ((30_000.0, 80_000.0), (700_000.0, 800_000.0))
"""Day numbers of the years 1982 to 2119: Excel's since 1899-12-30, MATLAB's datenum since the year 0."""
_LONG_UNITS = {"min": 60.0, "h": 3600.0, "days (of Excel or MATLAB)": 86400.0}
_USUAL_STEP = (0.004, 1.0)  # [s] between samples of flight dynamics
_SPEED_UNITS = {"knots": 3600 / NAUTICAL_MILE, "km/h": 3.6, "mph": 1 / MILE_PER_HOUR, "ft/s": 1 / FOOT, "cm/s": 100.0}

_FAST_UNITS = {"knots, ft/s or km/h": 3.6, "cm/s": 100.0, "mm/s": 1000.0}
"""Groups of units for an airspeed that is too large in m/s -> the largest number of them in one m/s."""

_OTHER_UNITS: dict[str, tuple[tuple[str, float, float], ...]] = {
    "p_static": (("hPa", 200, 1100), ("kPa", 20, 110), ("inHg", 6, 19.9), ("psi", 3, 5.9)),
    "temperature": (("degC", -60, 60), ("degF", 60, 130)),
    "rho": (("g/m3", 300, 1600), ("slug/ft3", 6e-4, 3.2e-3)),
    "throttle": (("%", 1.5, 100), ("us", 800, 2200)),
    "mx": (("uT", 1.5, 100), ("gauss", 0.015, 1.4), ("nT", 1500, 1e5), ("mgauss", 101, 1400)),
    "altitude": (("ft", 2e4, 6.5e4),),
    "altitude_gnss": (("ft or cm", 2e4, 6.5e4), ("mm or cm", 6.5e4, 2e7)),
    "latitude": (("degE7", 1e6, 9e8),),
    "longitude": (("degE7", 1e6, 1.8e9),),
}
"""Column -> units, with the lowest and highest median that a flight has in each."""

LARGEST_ZERO_ERROR = 10.0  # [Pa] of a pitot, the dynamic pressure of 4 m/s: one that is more negative has another cause
NORMAL_FORCE_TOLERANCE = 0.25
"""Relative difference of az from the normal force by pitch rate, speed and attitude, for angle of attack and its change."""


def suspicions(time: Array, columns: Columns) -> list[Finding]:
    """Findings on columns that look like another unit, sign or axis. time: (N,) [s]; columns: name -> (N,), as recorded."""
    present = {n: v for n, v in columns.items() if n in COLUMN_BY_NAME and np.isfinite(v).sum() >= 2}
    units = (_time, _gravity, _angles, _rates, _speed, _other_columns, _pressure_speed, _ground_speed)
    signs = (_gravity_sign, _attitude_rate, _sideways, _upwards)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # the checks report such values
        axes = list(wrong_axes(time, present))  # explain every wrong sign, too
        return [*axes, *(f for check in (*units, *(() if axes else signs)) for f in check(time, present))]


def _suspect(columns: str | tuple[str, ...], text: str) -> Finding:
    """The finding on some columns. text: what is unusual, and what would explain it."""
    columns = (columns,) if isinstance(columns, str) else columns
    return Finding(FindingKind.UNLIKELY, f"{', '.join(columns)}: {text}", columns=columns)


def _median(values: Array) -> float:
    return float(np.nanmedian(values))


def _time(time: Array, c: Columns) -> Iterator[Finding]:
    if _shuffled(time):
        time = np.sort(time)
    steps = np.diff(time)
    backwards = float(np.mean(steps < 0)) if steps.size else 0.0
    steps = steps[steps > 0]
    if backwards > MOST_BACKWARDS:
        yield _suspect("time", f"runs backwards from {backwards:.0%} of the rows to the next; is this the time column?")
        return  # the steps of shuffled rows, or of a column that is not time, do not show a unit
    if not steps.size:
        return
    interval = float(np.median(steps))
    for unit, scale in (("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)):
        if interval >= LEAST_OTHER_STEP and SAMPLE_STEP[0] <= interval * scale <= SAMPLE_STEP[1]:
            yield _suspect("time", f"{interval:g} s from sample to sample; is the column in {unit}?")
            return
    if interval > SLOWEST_STEP:
        yield _suspect(
            "time", f"{interval:g} s from sample to sample is too slow for flight dynamics; check the time unit"
        )
    elif interval < FASTEST_STEP:
        units = [u for u, scale in _LONG_UNITS.items() if _USUAL_STEP[0] <= interval * scale <= _USUAL_STEP[1]]
        begin = float(np.nanmin(time))
        if any(first < begin < last for first, last in DAY_NUMBERS):
            units = [u for u in units if u.startswith("days")] or units
        candidates = " or ".join(units) if units else "min, h or days"
        yield _suspect("time", f"{interval:.3g} s from sample to sample; is the column in {candidates}?")


def _shuffled(time: Array) -> bool:
    """Whether the times, when sorted, are evenly spaced, so that only the order of the rows is wrong."""
    finite = time[np.isfinite(time)]
    if finite.size < FEWEST_EVEN:
        return False
    steps = np.diff(np.sort(finite))
    interval = float(np.median(steps))
    return interval > 0 and float(np.mean(np.abs(steps - interval) < EVEN_STEP * interval)) > EVEN_SHARE


def _gravity(time: Array, c: Columns) -> Iterator[Finding]:
    if not all(a in c for a in ("ax", "ay", "az")):
        return
    size = _median(np.sqrt(c["ax"] ** 2 + c["ay"] ** 2 + c["az"] ** 2))
    if not ONE_G[0] * GRAVITY < size < ONE_G[1] * GRAVITY and not _pulled(c):
        nearest = min(_GRAVITY_IN, key=lambda u: abs(np.log(max(size, 1e-9) / _GRAVITY_IN[u])))
        unit = nearest if UNIT_RATIO[0] < size / _GRAVITY_IN[nearest] < UNIT_RATIO[1] else None
        if unit is None and size < FREE_OF_GRAVITY * GRAVITY:
            hint = "an accelerometer in level flight shows one g: is gravity taken out of ax, ay, az?"
        else:
            hint = f"are ax, ay, az in {unit}?" if unit else "check unit and axes of ax, ay, az"
        yield _suspect(("ax", "ay", "az"), f"the median specific force is {size:.4g}, not near 9.8 m/s2; {hint}")


def _gravity_sign(time: Array, c: Columns) -> Iterator[Finding]:
    if "az" in c and UPWARD_GRAVITY[0] * GRAVITY < _median(c["az"]) < UPWARD_GRAVITY[1] * GRAVITY:
        yield _suspect("az", "positive in the mean, but with z down level flight has -9.8 m/s2; turn it with sign = -1")


def _pulled(c: Columns) -> bool:
    """Whether the flight path turned as az requires: a trimmed pull of two g is no mistake of the unit."""
    if not all(n in c for n in ("q", "V", "phi", "theta")):
        return False
    with np.errstate(invalid="ignore"):
        normal_force = -(GRAVITY * np.cos(c["theta"]) * np.cos(c["phi"]) + c["q"] * c["V"])
        finite = np.isfinite(normal_force) & np.isfinite(c["az"])
    if not finite.any():
        return False
    ratio = float(np.median(c["az"][finite])) / (float(np.median(normal_force[finite])) or np.nan)
    return abs(ratio - 1.0) < NORMAL_FORCE_TOLERANCE


def _angles(time: Array, c: Columns) -> Iterator[Finding]:
    for name in _ANGLES:
        if name in c:
            low, high = COLUMN_BY_NAME[name].plausible
            lowest, highest = float(np.nanmin(c[name])), float(np.nanmax(c[name]))
            extreme = highest if highest > -lowest else lowest
            if damaged := _damaged(c[name], high):
                yield _suspect(name, damaged)
            elif (lowest < low - RANGE_MARGIN or highest > high + RANGE_MARGIN) and not is_unwrapped(time, c, name):
                unit = "deg" if abs(extreme) <= LARGEST_DEGREES else "cdeg or us"
                limit = high if extreme > 0 else low
                yield _suspect(name, f"reaches {extreme:.4g} rad, beyond {limit:.3g}; is it in {unit}?")


def is_unwrapped(time: Array, c: Columns, name: str) -> bool:
    """Whether an angle beyond its range was not wrapped, since it is in radians by the integral of its gyro; False without a
    gyro, or with too little motion."""
    if name not in ("phi", "psi") or not all(n in c for n in (name, GYROS[name])):
        return False
    slope = _angle_slope(time, c, name)
    return slope is not None and _about_one(slope)


def _rates(time: Array, c: Columns) -> Iterator[Finding]:
    for name in _RATES:
        if name in c:
            high = COLUMN_BY_NAME[name].plausible[1]
            largest = float(np.nanmax(np.abs(c[name])))
            if damaged := _damaged(c[name], high):
                yield _suspect(name, damaged)
            elif largest > high:
                yield _suspect(name, f"reaches {largest:.4g} rad/s, beyond {high:g}; is it in deg/s?")


def _damaged(values: Array, high: float) -> str:
    """A text on values that are too large for any unit; empty without such values. values: (N,); high: their plausible limit."""
    damaged = np.abs(values) > DAMAGED_FACTOR * high
    if not damaged.any():
        return ""
    largest = np.nanmax(np.abs(values))
    return f"shows {largest:.2g} at {int(damaged.sum())} samples, which no sensor does: damaged values; leave their times out"


def _speed(time: Array, c: Columns) -> Iterator[Finding]:
    if "V" not in c:
        return
    high, middle = COLUMN_BY_NAME["V"].plausible[1], _median(c["V"])
    if middle > high:
        unit = next(unit for unit, factor in _FAST_UNITS.items() if middle / factor <= high or unit == "mm/s")
        yield _suspect("V", f"median {middle:.4g} m/s, beyond {high:g}; is it in {unit}?")


def _other_columns(time: Array, c: Columns) -> Iterator[Finding]:
    for name, values in c.items():
        if name in (*_ANGLES, *_RATES, "ax", "ay", "az", "V", "V_cas"):
            continue
        low, high = COLUMN_BY_NAME[name].plausible
        middle = _median(values)
        if low <= middle <= high:
            continue
        key = "mx" if name in ("my", "mz") else name
        unit = next((u for u, a, b in _OTHER_UNITS.get(key, ()) if a <= abs(middle) <= b or a <= middle <= b), None)
        hint = f"is it in {unit}?" if unit else "check its unit"
        yield _suspect(
            name, f"median {middle:.4g} {COLUMN_BY_NAME[name].unit}, outside {low:.4g} to {high:.4g}; {hint}"
        )


def _attitude_rate(time: Array, c: Columns) -> Iterator[Finding]:
    """Attitude against the integrated gyros. The slope is 1, 57.3 or its inverse where one is in degrees, or -1 for a wrong sign;
    another slope that all three share is an error of the clock."""
    slopes = {a: _angle_slope(time, c, a) for a, rate in GYROS.items() if a in c and rate in c}
    ratio = _clock_ratio([s or 0.0 for s in slopes.values()])
    if ratio is not None:
        words = f"runs {max(ratio, 1 / ratio):.3g} times too {'slowly' if ratio < 1 else 'fast'}"
        yield _suspect("time", f"{words} for attitude to be what the gyros turn: check the time unit")
        return
    for angle, slope in slopes.items():
        rate = GYROS[angle]
        if slope is None:
            continue
        if _about_one(abs(slope) / RADIAN):
            yield _suspect(angle, f"moves {abs(slope):.0f} times as far as {rate} turns; is {angle} in deg?")
        elif _about_one(abs(slope) * RADIAN):
            yield _suspect(rate, f"turns {1 / abs(slope):.0f} times as far as {angle} moves; is {rate} in deg/s?")
        elif _about_one(-slope):
            yield _suspect(rate, f"turns against {angle}; one of them has the wrong sign (sign = -1)")


def _about_one(slope: float) -> bool:
    """Whether a slope is that of two angles in the same unit and with the same sign."""
    return _RADIANS[0] < slope < _RADIANS[1]


def _clock_ratio(slopes: Sequence[float]) -> float | None:
    """Factor by which the clock runs too fast, from the slopes of the angles against their gyros; None where these differ, or are
    explained by the units of the angles."""
    positive = [s for s in slopes if s > 0.0]
    if len(positive) < 2 or max(positive) > SAME_SLOPE * min(positive):
        return None
    middle = float(np.median(positive))
    by_unit = any(_about_one(slope) for slope in (middle, middle / RADIAN, middle * RADIAN))
    return None if by_unit else 1.0 / middle


def _angle_slope(time: Array, c: Columns, angle: str) -> float | None:
    """Slope of phi, theta or psi against the integral of its gyro; None without motion. psi: against the heading rate, or r where
    q and an attitude in radians are missing."""
    in_radians = all(n in c for n in ("q", "phi", "theta")) and all(
        np.nanmax(np.abs(c[n])) <= LARGEST_RADIANS for n in ("phi", "theta")
    )
    rate = heading_rate(c) if angle == "psi" and in_radians else c[GYROS[angle]]
    return _integral_slope(time, c[angle], rate)


def _sideways(time: Array, c: Columns) -> Iterator[Finding]:
    """Sideways motion, d(V beta)/dt = p w - r u + g sin(phi) cos(theta) + ay: the unit of V, and signs of beta, phi and r."""
    measured = all(n in c for n in ("ay", "p", "r", "phi", "theta", "beta", "V"))
    if not measured or float(np.nanmax(np.abs(c["phi"]))) > LARGEST_RADIANS:
        return
    alpha = c["alpha"] if "alpha" in c and float(np.nanmax(np.abs(c["alpha"]))) < 1 else np.zeros_like(c["V"])
    v, force, weight = c["V"] * c["beta"], c["ay"], GRAVITY * np.sin(c["phi"]) * np.cos(c["theta"])
    yawing, rolling = c["V"] * c["r"] * np.cos(alpha), c["V"] * c["p"] * np.sin(alpha)
    parts = list(windows(time, v, yawing, rolling, force, weight))
    slope, agreement = slope_and_agreement([(v + integral(t, r - p), integral(t, f + g)) for t, v, r, p, f, g in parts])
    if agreement > UNIT_AGREEMENT and slope > 0 and "p_dynamic" not in c:
        units = [u for u, factor in _SPEED_UNITS.items() if abs(1 / (slope * factor) - 1) < UNIT_TOLERANCE]
        if units:
            text = (
                f"{1 / slope:.3g} times the speed at which the aircraft turns and slips; is it in {' or '.join(units)}?"
            )
            yield _suspect("V", text)
            return
    bank: tuple[str, ...] = ("phi", "p") if (_integral_slope(time, c["phi"], c["p"]) or 0.0) >= 0.0 else ("phi",)
    roll_sign = -1.0 if "p" in bank else 1.0
    reversals: Reversals = {  # without ay, which is too small a part to show its sign
        ("beta",): ("ay, r and phi", [(integral(t, r - p) - v, integral(t, f + g)) for t, v, r, p, f, g in parts]),
        bank: (
            "ay, r and beta",
            [(v + integral(t, r - roll_sign * p), integral(t, f - g)) for t, v, r, p, f, g in parts],
        ),
        ("r",): ("ay, phi and beta", [(v - integral(t, r + p), integral(t, f + g)) for t, v, r, p, f, g in parts]),
    }
    yield from _wrong_signs("sideways", agreement if slope > 0 else 0.0, reversals)


def _upwards(time: Array, c: Columns) -> Iterator[Finding]:
    """Motion along z, d(V alpha)/dt = q u - p v + g cos(phi) cos(theta) + az: the signs of alpha and q."""
    if not all(n in c for n in ("az", "q", "theta", "alpha", "V")):
        return
    zero = np.zeros_like(c["V"])
    bank, rolling, slip = (c.get(n, zero) for n in ("phi", "p", "beta"))
    if any(float(np.nanmax(np.abs(angle))) > LARGEST_RADIANS for angle in (c["theta"], c["alpha"], bank)):
        return
    w, pitching = c["V"] * np.sin(c["alpha"]), c["V"] * np.cos(c["alpha"]) * c["q"]
    force = c["az"] + GRAVITY * np.cos(c["theta"]) * np.cos(bank) - rolling * c["V"] * slip
    parts = list(windows(time, w, pitching, force))
    slope, agreement = slope_and_agreement([(w - integral(t, q), integral(t, f)) for t, w, q, f in parts])
    pitch: tuple[str, ...] = ("q", "theta") if (_integral_slope(time, c["theta"], c["q"]) or 0.0) >= 0.0 else ("q",)
    reversals: Reversals = {
        ("alpha",): ("az and q", [(-w - integral(t, q), integral(t, f)) for t, w, q, f in parts]),
        pitch: ("az and alpha", [(w + integral(t, q), integral(t, f)) for t, w, q, f in parts]),
    }
    yield from _wrong_signs("vertical", agreement if slope > 0 else 0.0, reversals)


def _wrong_signs(motion: str, agreement: float, reversals: Reversals) -> Iterator[Finding]:
    """The columns whose reversed sign would make a motion agree with its cause. motion: its name for the text; agreement: share
    of its variance that is explained with the recorded signs."""
    fits = [(columns, reference, *slope_and_agreement(pairs)) for columns, (reference, pairs) in reversals.items()]
    columns, reference, slope, share = max(fits, key=lambda fit: fit[3] if abs(fit[2] - 1.0) < SLOPE_TOLERANCE else 0.0)
    clear = share > REVERSED_AGREEMENT and (1.0 - share) < MOST_REMAINING * (1.0 - agreement)
    if clear and abs(slope - 1.0) < SLOPE_TOLERANCE:
        question = "is its sign" if len(columns) == 1 else f"are the signs of {' and '.join(columns)}"
        text = f"turned, it would agree with the {motion} motion that {reference} make; {question} wrong (sign = -1)?"
        yield _suspect(columns, text)


def _integral_slope(time: Array, angle: Array, rate: Array) -> float | None:
    """Slope of an angle against the integral of a rate, over windows of 4 s less a straight line; None without common motion."""
    pairs = [
        (integral(t, b), np.unwrap(a) if np.ptp(a) < WRAPPED_RANGE else a) for t, a, b in windows(time, angle, rate)
    ]
    slope, agreement = slope_and_agreement(pairs)
    return slope if agreement >= LEAST_AGREEMENT else None


def _pressure_speed(time: Array, c: Columns) -> Iterator[Finding]:
    if "V" not in c or "p_dynamic" not in c:
        return
    ground = np.hypot(c["vn"], c["ve"]) if "vn" in c and "ve" in c else c["V"]  # V of swapped tubes is noise
    speed = np.where(np.isfinite(c["p_dynamic"]), ground if np.isfinite(ground).any() else c["V"], np.nan)
    fast = speed > 0.5 * np.max(speed, where=np.isfinite(speed), initial=0.0)
    if fast.any() and _median(c["p_dynamic"][fast]) < -LARGEST_ZERO_ERROR:
        yield _suspect("p_dynamic", "negative in flight: are the tubes of the pitot swapped? turn it with sign = -1")
    rho = c.get("rho", np.full_like(c["V"], 1.2))
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = c["V"] / np.sqrt(2 * np.where(c["p_dynamic"] > LEAST_PRESSURE, c["p_dynamic"], np.nan) / rho)
    yield from _speed_ratio(ratio, "the dynamic pressure gives", UNIT_TOLERANCE)


def _ground_speed(time: Array, c: Columns) -> Iterator[Finding]:
    if "p_dynamic" in c or not all(n in c for n in ("V", "vn", "ve")):
        return
    ground = np.hypot(c["vn"], c["ve"])
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.where(ground > LEAST_GROUND_SPEED, c["V"] / ground, np.nan)
    if np.isfinite(ratio).sum() > FEWEST_GROUND_SPEEDS and _median(ratio) > LARGEST_WIND_RATIO:
        yield from _speed_ratio(ratio, "GPS gives", UNIT_TOLERANCE_BY_GROUND)


def _speed_ratio(ratio: Array, source: str, tolerance: float) -> Iterator[Finding]:
    """The unit of V that explains the median of V over another speed, within a relative tolerance. source: of that speed."""
    if np.isfinite(ratio).sum() < FEWEST_RATIOS:
        return
    middle = _median(ratio)
    for unit, factor in _SPEED_UNITS.items():
        if abs(middle / factor - 1) < tolerance:
            yield _suspect("V", f"{middle:.3g} times the speed that {source}; is it in {unit}?")
            return
