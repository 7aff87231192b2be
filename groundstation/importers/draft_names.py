"""Columns of a table that a mapping is drafted for: which flight column a name means, and in which unit its values are.

A name is a hint; the unit is read off values that physics bounds (gravity, pi, the rate of an angle). Where values
allow more than one unit, or none, the draft says so and a person decides.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from daq.contract.channels import COLUMN_BY_NAME
from daq.utilities.constants import GRAVITY
from groundstation.flight.arrays import Array
from groundstation.importers.units import UNITS, find_unit

_MEANT: tuple[tuple[str, str], ...] = (
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
"""Flight column -> names that people give it, in lower case, without units and with one underscore between words."""
_UNIT_IN_NAME = re.compile(
    r"[ _\[(]+(deg[/_]?s|degps|dps|deg|rad[/_]?s|rad|m[/_]?s\^?2|m[/_]s|mps|knots|kts?|kmh|ft|psi"
    r"|hpa|kpa|pa|degc|kg[/_]?m3|g)[\])]?$",
    re.IGNORECASE,
)
_SPELT = {"deg_s": "deg/s", "degs": "deg/s", "degps": "deg/s", "rad_s": "rad/s", "rads": "rad/s", "m_s2": "m/s2", "ms2": "m/s2",
          "m_s": "m/s", "kmh": "km/h", "kg_m3": "kg/m3", "kgm3": "kg/m3"}  # fmt: skip
_TIME = re.compile(r"(?i)(irig_?)?(time|t|timestamp|stamp|clock|sec(onds)?)(_?(s|ms|us|ns|utc|sec))?")

_TIME_UNIT = re.compile(r"(?i)[\[( _](s|sec|ms|us|µs|ns)[\])]?$")
FEWEST_STEPS = 20  # of a column that is taken for time by its values
EVEN, MOSTLY_EVEN = 0.5, 0.95
"""Share of a step by which steps may differ, and of the steps that do not: gaps and jitter of loggers."""

ANGLES = {"p": "phi", "q": "theta", "r": "psi"}
"""Rate -> the angle that it turns."""
MOST_PREFIXES = 2  # words of a system before the name of a quantity: EGI_, FCC_A_
SHORTEST_WITHOUT = 3  # letters of a name that says what it is without them
NOT_THE_MOTION = frozenset(
    "cmd command commanded target desired demand demanded ref reference set setpoint sp error err bias std sigma var "
    "variance status valid flag fail mode trim limit max min stick pedal lever".split()
)
"""Words of a name that is something else than the quantity that it names beside them: asked for, a fault, a pilot's lever."""

_GRAVITY = {"m/s2": GRAVITY, "g": 1.0, "ft/s2": 32.174, "mg": 1000.0, "cm/s2": 980.665}
_CLOSE = 0.25  # of gravity, by which the median specific force of a flight may differ from it: turns, and a filter
FEWEST_ROWS = 20  # of a table, below which a correlation says nothing
CLEARER = 0.5  # of what the second best leaves of a correlation: what one column of two may leave to be the better one
_RATE_AGREES = 0.15  # of the ratio of an angle's slope and its rate to what two units make it


@dataclass(frozen=True, slots=True)
class UnitGuess:
    """The unit of a column, why, and whether its values say it."""

    unit: str
    why: str
    sure: bool = False


def normalised_name(name: str) -> str:
    """A name as the table of names knows them."""
    return re.sub(r"[^a-z0-9]+", "_", _UNIT_IN_NAME.sub("", name).lower()).strip("_")


def unit_in_name(name: str) -> str | None:
    """The unit at the end of a name, as `deg/s` of `roll_rate_deg_s`."""
    match = _UNIT_IN_NAME.search(name)
    if match is None or match.start() == 0:
        return None
    word = match[1].lower()
    return word if find_unit(_SPELT.get(word, word)) is not None and word not in _SPELT else _SPELT.get(word)


def unit_fits(unit: str, column: str) -> bool:
    """Whether a unit is one of the quantity of a flight column."""
    si_unit = find_unit(unit)
    return si_unit is not None and si_unit.si == COLUMN_BY_NAME[column].unit


def meant_column(name: str) -> str | None:
    """The flight column that a name means: as it stands, else without the system that it begins with (EGI_PITCH_ANGLE) or the
    number that it ends with. A single letter behind a system says nothing (`x_p`), nor does what was asked for or made of it."""
    words = normalised_name(name).split("_")
    if set(words) & NOT_THE_MOTION:
        return None
    end = len(words) - 1 if len(words) > 1 and words[-1].isdigit() else len(words)
    for begin in range(min(MOST_PREFIXES, len(words) - 1) + 1):
        for stop in dict.fromkeys((len(words), end)):
            text = "_".join(words[begin:stop])
            column = next((c for c, pattern in _MEANT if re.fullmatch(pattern, text)), None)
            if column is not None and ((begin == 0 and stop == len(words)) or len(text) >= SHORTEST_WITHOUT):
                return column
    return None


def candidate_columns(names: Sequence[str]) -> dict[str, list[str]]:
    """Flight column -> names that may mean it, an exact one first."""
    candidates: dict[str, list[str]] = {}
    for name in names:
        column = meant_column(name)
        if column is not None:
            candidates.setdefault(column, []).append(name)
    return {c: sorted(labels, key=lambda label: _distance(label, c)) for c, labels in candidates.items()}


def _distance(name: str, column: str) -> tuple[bool, int]:
    """How far a name is from that of its column: another name, and words too many."""
    return normalised_name(name) != column, len(normalised_name(name).split("_"))


def time_column(names: Sequence[str]) -> str | None:
    """The column that holds time, by its name."""
    return next((n for n in names if _TIME.fullmatch(re.sub(r"[^A-Za-z0-9]+", "_", n).strip("_"))), None)


def running_column(values: Mapping[str, Array]) -> str | None:
    """The column that rises from row to row in even steps, as time does, whatever its name: the first with a unit of time in
    its name, else the first that does not count rows. None where none does."""
    running = [name for name, column in values.items() if _runs(column)]
    with_unit = [n for n in running if _TIME_UNIT.search(n)]
    no_counter = [n for n in running if np.any(values[n] != np.round(values[n]))]
    return next(iter((*with_unit, *no_counter)), None)


def _runs(column: Array) -> bool:
    steps = np.diff(column)
    middle = float(np.median(steps)) if steps.size >= FEWEST_STEPS else 0.0
    return middle > 0.0 and float(np.mean(np.abs(steps - middle) < EVEN * middle)) > MOSTLY_EVEN


def time_unit(time: Array) -> tuple[str, str]:
    """Unit of a time column and why: the one in which the rate is one that flights are logged at."""
    step = float(np.median(np.diff(time[np.isfinite(time)]))) if np.isfinite(time).sum() > 1 else 0.0
    for unit in ("s", "ms", "us", "ns"):
        rate = 1.0 / (step * UNITS[unit].scale) if step > 0 else 0.0
        if 0.9 <= rate <= 1100.0:
            return unit, f"rows every {step:.4g}: {rate:.4g} Hz in {unit}"
    return "s", f"UNKNOWN unit: rows every {step:.4g}"


@np.errstate(all="ignore")  # absurd values, which are in no unit
def unit_of(column: str, names: Mapping[str, str], values: Mapping[str, Array], time: Array | None) -> UnitGuess:
    """Unit of a proposed column. names: flight column -> its column in the table."""
    si = COLUMN_BY_NAME[column].unit
    x = values[names[column]]
    x = x[np.isfinite(x)]
    if not x.size:
        return UnitGuess(si, "no values")
    low, high = (float(v) for v in np.percentile(x, [0.5, 99.5]))
    extent = f"{low:.4g} to {high:.4g}"
    if column in ("ax", "ay", "az"):
        return _force_unit(names, values, extent)
    if column in ("p", "q", "r"):
        return _rate_unit(column, names, values, time, extent)
    if si == "rad":
        limit = np.pi if column in ("phi", "psi") else np.pi / 2 if column in ("theta", "alpha", "beta") else 1.0
        if max(abs(low), abs(high)) > 1.1 * limit:
            return UnitGuess("deg", f"{extent}: more than an angle in rad can be", True)
        return UnitGuess("rad", f"{extent}: rad, if it moves so far; UNKNOWN where degrees would be small")
    median = float(np.median(x))
    able = [unit for unit, lowest, largest in _RANGES.get(column, ()) if lowest <= median <= largest]
    if len(able) == 1:
        return UnitGuess(able[0], f"{extent}: {able[0]} by what the atmosphere allows", True)
    if able:
        return UnitGuess(able[0], f"{extent}; UNKNOWN unit: {' or '.join(able)}")
    return UnitGuess(si, f"{extent}; UNKNOWN unit, taken as {si}")


_RANGES: Mapping[str, tuple[tuple[str, float, float], ...]] = {
    "p_static": (("Pa", 15e3, 110e3), ("hPa", 150, 1100), ("kPa", 15, 110), ("inHg", 4.5, 32), ("psi", 2.1, 16)),
    "temperature": (("K", 200, 330), ("degC", -60, 55)),
    "rho": (("kg/m3", 0.2, 1.5), ("slug/ft3", 0.0004, 0.003)),
}
"""Flight column -> units and the values of a median that only they allow."""


def _force_unit(names: Mapping[str, str], values: Mapping[str, Array], extent: str) -> UnitGuess:
    parts = [values[names[c]] for c in ("ax", "ay", "az") if c in names]
    size = float(np.nanmedian(np.sqrt(np.sum(np.square(parts), axis=0))))
    for unit, gravity in _GRAVITY.items():
        if len(parts) == 3 and abs(size / gravity - 1.0) < _CLOSE:
            return UnitGuess(unit, f"{extent}; median specific force {size:.4g}: gravity in {unit}", True)
    return UnitGuess("m/s2", f"{extent}; UNKNOWN unit: median specific force {size:.4g} is gravity in none")


@np.errstate(all="ignore")
def rate_that_turns(
    labels: Sequence[str], angle: str, values: Mapping[str, Array], time: Array | None
) -> tuple[str, str]:
    """Which of several columns of one rate turns the angle as it was recorded, and why; the first where none does better.

    labels: of the rate, angle: of the angle it turns, in `values`. By the correlation with the angle's slope: no unit, sign or
    offset is needed.
    """
    if time is None or time.size != values[angle].size or time.size < FEWEST_ROWS:
        return labels[0], ""
    with np.errstate(invalid="ignore", divide="ignore"):
        slope = np.diff(values[angle]) / np.diff(time)
    half_way = 0.5 * (np.nanmax(values[angle]) - np.nanmin(values[angle]))
    runs_on = np.abs(np.diff(values[angle])) < half_way  # no half turn
    follows = {}
    for label in labels:
        between = 0.5 * (values[label][1:] + values[label][:-1])
        use = np.isfinite(between) & np.isfinite(slope) & runs_on
        moves = use.sum() > FEWEST_ROWS and np.std(between[use]) > 0 and np.std(slope[use]) > 0
        follows[label] = abs(float(np.corrcoef(between[use], slope[use])[0, 1])) if moves else 0.0
    best, second = sorted(follows, key=lambda label: -follows[label])[:2]
    if 1.0 - follows[best] > CLEARER * (1.0 - follows[second]):
        return labels[0], ""
    said = ", ".join(f"{label} {follows[label]:.3f}" for label in (best, second))
    return best, f"goes with the slope of {angle} better than the other ({said})"


def _rate_unit(
    column: str, names: Mapping[str, str], values: Mapping[str, Array], time: Array | None, extent: str
) -> UnitGuess:
    """By the slope of the angle that it turns: in rad/s and rad, or deg/s and deg, both are equal."""
    angle = ANGLES[column]
    rate = values[names[column]]
    if angle in names and time is not None and time.size == rate.size and time.size > 2:
        scale = UNITS[unit_of(angle, names, values, time).unit].scale
        slope = np.gradient(np.unwrap(np.nan_to_num(values[names[angle]]) * scale), time)
        with np.errstate(invalid="ignore", divide="ignore"):
            use = np.isfinite(rate) & np.isfinite(slope)
            ratio = float(np.std(rate[use]) / np.std(slope[use])) if use.any() and np.std(slope[use]) > 0 else np.nan
        for unit in ("rad/s", "deg/s"):
            if abs(ratio * UNITS[unit].scale - 1.0) < 3 * _RATE_AGREES:
                return UnitGuess(unit, f"{extent}; moves as the slope of {names[angle]} in {unit}", True)
    largest = float(np.nanpercentile(np.abs(rate), 99))
    return UnitGuess("deg/s" if largest > 8.0 else "rad/s", f"{extent}; UNKNOWN unit, by its size")
