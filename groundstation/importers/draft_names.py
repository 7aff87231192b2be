"""For the draft of a mapping: the flight column that a table's column means, by its name, and its unit, by its values.

A unit follows from values that physics bounds (gravity, pi, the rate of an angle). Where the values fit several units, or none,
the draft contains UNKNOWN, and a person decides.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from daq.contract.channels import COLUMN_BY_NAME
from daq.utilities.constants import GRAVITY
from groundstation.flight.arrays import Array
from groundstation.importers.units import UNITS, find_unit

_NAME_PATTERNS: tuple[tuple[str, str], ...] = (
    ("ax", r"(acc?(el(eration)?)?|specific_force|imu_acc?)_?(x|lon\w*)|a_?x|nx(_?lon\w*)?|(longitudinal|axial)_acc\w*"),
    ("ay", r"(acc?(el(eration)?)?|specific_force|imu_acc?)_?(y|lat\w*)|a_?y|ny|lateral_acc\w*"),
    ("az", r"(acc?(el(eration)?)?|specific_force|imu_acc?)_?(z|nor\w*|vert\w*)|a_?z|nz|(normal|vertical)_acc\w*"),
    ("p", r"p|roll_?rate(_p)?|(gyr(o)?|omega|w|ang\w*vel\w*)_?x|rollspeed"),
    ("q", r"q|pitch_?rate(_q)?|(gyr(o)?|omega|w|ang\w*vel\w*)_?y|pitchspeed"),
    ("r", r"r|yaw_?rate(_r)?|(gyr(o)?|omega|w|ang\w*vel\w*)_?z|yawspeed"),
    ("phi", r"phi|roll(_?angle|_d)?|bank(_?angle)?"),
    ("theta", r"theta|pitch(_?angle|_?attitude|_d)?"),
    ("psi", r"psi|yaw(_?angle|_d)?|(true_?)?heading|hdg"),
    ("alpha", r"alpha|aoa|angle_?of_?attack"),
    ("beta", r"beta|aos+|ssa|(side_?slip|angle_?of_?sideslip)(_?angle)?"),
    ("V", r"v|tas|(true_?)?air_?speed|v_?tas|vtrue"),
    ("V_cas", r"ias|cas|eas|(indicated|calibrated|equivalent|computed)_?air_?speed"),
    ("delta_e", r"(delta_?|d)?e|ele(v(ator)?)?(_?(pos\w*|angle|defl\w*))?|stab_?pos|de"),
    ("delta_a", r"(delta_?|d)?a|ail(eron)?s?(_?(pos\w*|angle|defl\w*))?|da"),
    ("delta_r", r"(delta_?|d)?r|rud(der)?(_?(pos\w*|angle|defl\w*))?|dr"),
    ("p_static", r"(p_?s(tat\w*)?|static_?press\w*|baro_?press\w*|press(ure)?)"),
    ("p_dynamic", r"(p_?dyn\w*|q_?c|q_?bar|dyn\w*_?press\w*|diff\w*_?press\w*)"),
    ("temperature", r"(oat|sat|temp(erature)?|(outside_?)?air_?temp\w*)"),
    ("altitude", r"(alt(itude)?(_?baro\w*|_?press\w*)?|baro_?alt\w*|press\w*_?alt\w*|h)"),
    ("latitude", r"lat(itude)?"),
    ("longitude", r"lon(g|gitude)?"),
    ("vn", r"v_?n(orth)?|vel_?n(orth)?|north_?vel\w*"),
    ("ve", r"v_?e(ast)?|vel_?e(ast)?|east_?vel\w*"),
    ("vd", r"v_?d(own)?|vel_?d(own)?|down_?vel\w*"),
    ("thrust", r"thrust"),
    ("rho", r"rho|(air_?)?density"),
)
"""Flight column -> pattern of its usual names, in the form of `normalised_name`."""
_UNIT_IN_NAME = re.compile(
    r"[ _\[(]+(deg[/_]?s|degps|dps|deg|rad[/_]?s|rad|m[/_]?s\^?2|m[/_]s|mps|knots|kts?|kmh|ft|psi"
    r"|hpa|kpa|pa|degc|kg[/_]?m3|g)[\])]?$",
    re.IGNORECASE,
)
_UNIT_SPELLINGS = {
    "deg_s": "deg/s", "degs": "deg/s", "degps": "deg/s", "rad_s": "rad/s", "rads": "rad/s", "m_s2": "m/s2", "ms2": "m/s2",
    "m_s": "m/s", "kmh": "km/h", "kg_m3": "kg/m3", "kgm3": "kg/m3",
}  # fmt: skip
_TIME = re.compile(r"(?i)(irig_?)?(time|t|timestamp|stamp|clock|sec(onds)?)(_?(s|ms|us|ns|utc|sec))?")

_TIME_UNIT = re.compile(r"(?i)[\[( _](s|sec|ms|us|µs|ns)[\])]?$")
FEWEST_STEPS = 20  # of a column that is taken as time by its values
STEP_TOLERANCE, LEAST_EVEN = 0.5, 0.95
"""Relative difference of a step from the median, and least share of steps within it: loggers have gaps and jitter."""

ANGLES = {"p": "phi", "q": "theta", "r": "psi"}
"""Rate -> its angle."""
MOST_PREFIXES = 2  # words for the system before the name of a quantity: EGI_, FCC_A_
SHORTEST_NAME = 3  # letters of a name that is recognised after such words
OTHER_QUANTITIES = frozenset(
    "cmd command commanded target desired demand demanded ref reference set setpoint sp error err bias std sigma var "
    "variance status valid flag fail mode trim limit max min stick pedal lever".split()
)
"""Words in names of something else than the measured quantity: its command, its error, a pilot's lever."""

_GRAVITY = {"m/s2": GRAVITY, "g": 1.0, "ft/s2": 32.174, "mg": 1000.0, "cm/s2": 980.665}
_GRAVITY_TOLERANCE = 0.25
"""Relative difference of a flight's median specific force from gravity, at most: turns, and a filter."""
_LOWEST_HZ, _HIGHEST_HZ = 0.9, 1100.0
"""Rates of rows that a logger has, with a margin: 1 Hz to 1 kHz."""
_EXTENT_PERCENTILES = (0.5, 99.5)  # of values, for their range without outliers
_LARGEST_RAD: Mapping[str, float] = {"phi": np.pi, "psi": np.pi, **dict.fromkeys(("theta", "alpha", "beta"), np.pi / 2)}
"""Column -> its largest angle [rad]."""
_LARGEST_SURFACE_RAD = 1.0  # of a control surface: 57 deg
_ANGLE_MARGIN = 1.1  # times the largest angle, for noise: beyond it the unit is degrees
_FAST_RATE, _RATE_PERCENTILE = 8.0, 99.0
"""A rate whose percentile is larger is probably in deg/s: 8 rad/s are 460 deg/s."""
FEWEST_ROWS = 20  # of a table, for a correlation
MOST_DECORRELATION = 0.5  # largest ratio of 1 - correlation of the best column to that of the second, for a choice
_RATE_TOLERANCE = 0.45  # relative difference of a rate's std from that of its angle's slope


@dataclass(frozen=True, slots=True)
class UnitGuess:
    """Unit of a column; why: the evidence as text; sure: whether the values determine it."""

    unit: str
    why: str
    sure: bool = False


def normalised_name(name: str) -> str:
    """A name in lower case, without its unit, with one underscore between words."""
    return re.sub(r"[^a-z0-9]+", "_", _UNIT_IN_NAME.sub("", name).lower()).strip("_")


def unit_in_name(name: str) -> str | None:
    """The unit at the end of a name, `deg/s` for `roll_rate_deg_s`; None without one."""
    match = _UNIT_IN_NAME.search(name)
    if match is None or match.start() == 0:
        return None
    word = match[1].lower()
    if word in _UNIT_SPELLINGS:
        return _UNIT_SPELLINGS[word]
    return word if find_unit(word) is not None else None


def meant_column(name: str) -> str | None:
    """The flight column that a name means, as a whole, or without leading words for a system (EGI_PITCH_ANGLE) or a final number.
    None for a single letter after a system (`x_p`), for commands and errors, and for other names."""
    words = normalised_name(name).split("_")
    if set(words) & OTHER_QUANTITIES:
        return None
    end = len(words) - 1 if len(words) > 1 and words[-1].isdigit() else len(words)
    for begin in range(min(MOST_PREFIXES, len(words) - 1) + 1):
        for stop in dict.fromkeys((len(words), end)):
            text = "_".join(words[begin:stop])
            column = next((c for c, pattern in _NAME_PATTERNS if re.fullmatch(pattern, text)), None)
            if column is not None and ((begin == 0 and stop == len(words)) or len(text) >= SHORTEST_NAME):
                return column
    return None


def candidate_columns(names: Sequence[str]) -> dict[str, list[str]]:
    """Flight column -> names that may mean it, the closest first."""
    candidates: dict[str, list[str]] = {}
    for name in names:
        column = meant_column(name)
        if column is not None:
            candidates.setdefault(column, []).append(name)
    return {c: sorted(labels, key=lambda label: _distance(label, c)) for c, labels in candidates.items()}


def _distance(name: str, column: str) -> tuple[bool, int]:
    """Key for sorting names: whether it differs from the column's, and its number of words."""
    return normalised_name(name) != column, len(normalised_name(name).split("_"))


def time_column(names: Sequence[str]) -> str | None:
    """The first column that is time by its name; None without one."""
    return next((n for n in names if _TIME.fullmatch(re.sub(r"[^A-Za-z0-9]+", "_", n).strip("_"))), None)


def running_column(values: Mapping[str, Array]) -> str | None:
    """The column that is time by its values, which rise in even steps: the first with a unit of time in its name, else the first
    that is not a counter of rows; None without one."""
    running = [name for name, column in values.items() if _runs(column)]
    with_unit = [n for n in running if _TIME_UNIT.search(n)]
    no_counter = [n for n in running if np.any(values[n] != np.round(values[n]))]
    return next(iter((*with_unit, *no_counter)), None)


def _runs(column: Array) -> bool:
    """Whether values (n,) rise in even steps."""
    steps = np.diff(column)
    middle = float(np.median(steps)) if steps.size >= FEWEST_STEPS else 0.0
    return middle > 0.0 and float(np.mean(np.abs(steps - middle) < STEP_TOLERANCE * middle)) > LEAST_EVEN


def time_unit(time: Array) -> tuple[str, str]:
    """Unit of a time column that gives the rows a logger's rate, and the evidence as text; s where none fits."""
    step = float(np.median(np.diff(time[np.isfinite(time)]))) if np.isfinite(time).sum() > 1 else 0.0
    for unit in ("s", "ms", "us", "ns"):
        rate = 1.0 / (step * UNITS[unit].scale) if step > 0 else 0.0
        if _LOWEST_HZ <= rate <= _HIGHEST_HZ:
            return unit, f"rows every {step:.4g}: {rate:.4g} Hz in {unit}"
    return "s", f"UNKNOWN unit: rows every {step:.4g}"


@np.errstate(all="ignore")  # damaged values of any size, which fit no unit
def unit_of(column: str, names: Mapping[str, str], values: Mapping[str, Array], time: Array | None) -> UnitGuess:
    """Unit of a flight column by its values. names: flight column -> column of the table; values: of the table; time: [s]."""
    si = COLUMN_BY_NAME[column].unit
    x = values[names[column]]
    x = x[np.isfinite(x)]
    if not x.size:
        return UnitGuess(si, "no values")
    low, high = (float(v) for v in np.percentile(x, _EXTENT_PERCENTILES))
    extent = f"{low:.4g} to {high:.4g}"
    if column in ("ax", "ay", "az"):
        return _force_unit(names, values, extent)
    if column in ("p", "q", "r"):
        return _rate_unit(column, names, values, time, extent)
    if si == "rad":
        limit = _LARGEST_RAD.get(column, _LARGEST_SURFACE_RAD)
        if max(abs(low), abs(high)) > _ANGLE_MARGIN * limit:
            return UnitGuess("deg", f"{extent}: more than an angle in rad can be", True)
        return UnitGuess("rad", f"{extent}: rad, if it moves so far; UNKNOWN where degrees would be small")
    median = float(np.median(x))
    possible = [unit for unit, lowest, largest in _RANGES.get(column, ()) if lowest <= median <= largest]
    if len(possible) == 1:
        return UnitGuess(possible[0], f"{extent}: {possible[0]} by what the atmosphere allows", True)
    if possible:
        return UnitGuess(possible[0], f"{extent}; UNKNOWN unit: {' or '.join(possible)}")
    return UnitGuess(si, f"{extent}; UNKNOWN unit, taken as {si}")


_RANGES: Mapping[str, tuple[tuple[str, float, float], ...]] = {
    "p_static": (("Pa", 15e3, 110e3), ("hPa", 150, 1100), ("kPa", 15, 110), ("inHg", 4.5, 32), ("psi", 2.1, 16)),
    "temperature": (("K", 200, 330), ("degC", -60, 55)),
    "rho": (("kg/m3", 0.2, 1.5), ("slug/ft3", 0.0004, 0.003)),
}
"""Flight column -> units, with the lowest and largest median that the atmosphere gives in each."""


def _force_unit(names: Mapping[str, str], values: Mapping[str, Array], extent: str) -> UnitGuess:
    """Unit of the specific force, whose median is near gravity."""
    parts = [values[names[c]] for c in ("ax", "ay", "az") if c in names]
    size = float(np.nanmedian(np.sqrt(np.sum(np.square(parts), axis=0))))
    for unit, gravity in _GRAVITY.items():
        if len(parts) == 3 and abs(size / gravity - 1.0) < _GRAVITY_TOLERANCE:
            return UnitGuess(unit, f"{extent}; median specific force {size:.4g}: gravity in {unit}", True)
    return UnitGuess("m/s2", f"{extent}; UNKNOWN unit: median specific force {size:.4g} is gravity in none")


@np.errstate(all="ignore")
def rate_that_turns(
    labels: Sequence[str], angle: str, values: Mapping[str, Array], time: Array | None
) -> tuple[str, str]:
    """The column of a rate that correlates best with the slope of its angle, and why; the first where none is clearly better.

    labels: candidates for the rate, at least two; angle: label of the angle; both in `values` (n,). A correlation needs no unit,
    sign or offset.
    """
    if time is None or time.size != values[angle].size or time.size < FEWEST_ROWS:
        return labels[0], ""
    with np.errstate(invalid="ignore", divide="ignore"):
        slope = np.diff(values[angle]) / np.diff(time)
    half_range = 0.5 * (np.nanmax(values[angle]) - np.nanmin(values[angle]))
    continuous = np.abs(np.diff(values[angle])) < half_range  # no wrap of the angle
    correlation = {}
    for label in labels:
        rate = 0.5 * (values[label][1:] + values[label][:-1])
        use = np.isfinite(rate) & np.isfinite(slope) & continuous
        moves = use.sum() > FEWEST_ROWS and np.std(rate[use]) > 0 and np.std(slope[use]) > 0
        correlation[label] = abs(float(np.corrcoef(rate[use], slope[use])[0, 1])) if moves else 0.0
    first, second = sorted(correlation, key=lambda label: -correlation[label])[:2]
    if 1.0 - correlation[first] > MOST_DECORRELATION * (1.0 - correlation[second]):
        return labels[0], ""
    evidence = ", ".join(f"{label} {correlation[label]:.3f}" for label in (first, second))
    return first, f"goes with the slope of {angle} better than the other ({evidence})"


def _rate_unit(
    column: str, names: Mapping[str, str], values: Mapping[str, Array], time: Array | None, extent: str
) -> UnitGuess:
    """Unit of a rate, in which its standard deviation is that of its angle's slope; by its size without the angle."""
    angle = ANGLES[column]
    rate = values[names[column]]
    if angle in names and time is not None and time.size == rate.size and time.size > 2:
        scale = UNITS[unit_of(angle, names, values, time).unit].scale
        slope = np.gradient(np.unwrap(np.nan_to_num(values[names[angle]]) * scale), time)
        with np.errstate(invalid="ignore", divide="ignore"):
            use = np.isfinite(rate) & np.isfinite(slope)
            ratio = float(np.std(rate[use]) / np.std(slope[use])) if use.any() and np.std(slope[use]) > 0 else np.nan
        for unit in ("rad/s", "deg/s"):
            if abs(ratio * UNITS[unit].scale - 1.0) < _RATE_TOLERANCE:
                return UnitGuess(unit, f"{extent}; moves as the slope of {names[angle]} in {unit}", True)
    largest = float(np.nanpercentile(np.abs(rate), _RATE_PERCENTILE))
    return UnitGuess("deg/s" if largest > _FAST_RATE else "rad/s", f"{extent}; UNKNOWN unit, by its size")
