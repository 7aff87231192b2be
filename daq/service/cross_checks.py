"""Lines of the go/no-go table that hold a sensor against another one, or against what the earth and its weather allow."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from statistics import fmean

from daq.config import LoggerConfig
from daq.contract.channels import CHANNEL_BY_NAME
from daq.contract.scan import Scan
from daq.sensors.standstill import LEAST_SCANS, counts
from daq.service.checks import PreflightCheck, PreflightVerdict, graded
from daq.telemetry.config import DisplayConfig
from daq.telemetry.display import Display
from daq.utilities.constants import LAPSE_RATE, SEA_LEVEL_TEMPERATURE

SEA_LEVEL_PA = 94_500.0, 106_000.0
"""Sea-level pressures of all weather that aircraft fly in, 950 to 1055 hPa, and 5 hPa of a barometer's error and of a fix that
is 40 m off."""
VERTICAL_M = 40.0
"""A fix whose own estimate of its height is worse than this says nothing of pressure."""
FIELD_UT = 12.0, 95.0
"""The earth has 22 to 67 uT (IGRF); before calibration iron of the airframe may add or take what is left of these."""
RAIL = 0.01
"""Of an input's range: a potentiometer that rests this close to an end has lost its supply or its wiper."""
MOVED = 0.02
"""Of an input's range: a surface that a pilot moves through its travel moves its potentiometer by ten times that."""
SURFACES = ("elevon_left_pot", "elevon_right_pot", "rudder_pot")
_FIX_3D = 3
_FULL = 32767  # counts of an analog input
_EXPONENT = 5.25588  # g / (R L) of the standard atmosphere


def cross_checks(
    config: LoggerConfig, scans: Sequence[Scan], facts: Callable[[], Mapping[str, str]]
) -> Iterator[PreflightCheck]:
    """Static pressure against GPS height, the magnetic field, potentiometers of the surfaces. facts: of the sensors."""
    yield from _height(config, scans, facts)
    yield from _field(scans)
    yield from _surfaces(config, scans)


def sea_level_pressure(pressure: float, height: float) -> float:
    """The pressure at sea level [Pa] that the standard atmosphere has where it is `pressure` [Pa] at `height` [m]."""
    ratio: float = 1.0 - LAPSE_RATE * min(height, 11_000.0) / SEA_LEVEL_TEMPERATURE
    return float(pressure / ratio**_EXPONENT)


def _height(
    config: LoggerConfig, scans: Sequence[Scan], facts: Callable[[], Mapping[str, str]]
) -> Iterator[PreflightCheck]:
    display = Display(DisplayConfig(), facts)
    display.look_up_facts()
    pressures = [found[0] for s in scans if (found := display.static(s)) is not None]
    heights = [
        s.values["height_msl_mm"] * 1e-3
        for s in scans
        if s.values.get("gnss_fix", 0) >= _FIX_3D
        and "height_msl_mm" in s.values
        and s.values.get("vertical_accuracy_mm", 0) * 1e-3 <= VERTICAL_M
    ]
    if len(pressures) < LEAST_SCANS or not heights:
        return
    pressure, height = fmean(pressures), heights[-1]
    sea_level = sea_level_pressure(pressure, height)
    low, high = SEA_LEVEL_PA
    text = (
        f"static pressure {pressure / 100:.0f} hPa at a GPS height of {height:.0f} m: {sea_level / 100:.0f} hPa at sea level"
        f" (weather has {low / 100:.0f} to {high / 100:.0f})"
    )
    if not low <= sea_level <= high:
        text += "; is the static tube blocked or on the pitot? is the fix a good one?"
    yield graded("static height", low <= sea_level <= high, text, _failure(config, ["static"]))


def _field(scans: Sequence[Scan]) -> Iterator[PreflightCheck]:
    axes = [counts(scans, f"mag_{axis}") for axis in "xyz"]
    if len(axes[0]) < LEAST_SCANS:
        return
    scale = (CHANNEL_BY_NAME["mag_x"].scale or 0.0) * 1e6
    size = math.hypot(*(fmean(axis) * scale for axis in axes))
    low, high = FIELD_UT
    text = f"{size:.0f} uT (the earth has 22 to 67; limits {low:.0f} and {high:.0f} before calibration)"
    if not low <= size <= high:
        text += "; iron, a magnet or a live cable beside it? move it, or the aircraft"
    yield graded("magnetic field", low <= size <= high, text, PreflightVerdict.CAUTION)


def _surfaces(config: LoggerConfig, scans: Sequence[Scan]) -> Iterator[PreflightCheck]:
    """One line on all of them: where each potentiometer rests, and whether it was moved."""
    readings = {name: counts(scans, name) for name in SURFACES}
    readings = {name: values for name, values in readings.items() if len(values) >= LEAST_SCANS}
    if not readings:
        return
    shares = {name: fmean(values) / _FULL for name, values in readings.items()}
    lost = [name for name, share in shares.items() if not RAIL <= share <= 1.0 - RAIL]
    moved = [name for name, values in readings.items() if max(values) - min(values) >= MOVED * _FULL]
    text = ", ".join(f"{name.removesuffix('_pot')} at {share:.0%}" for name, share in shares.items()) + " of the range"
    if lost:
        text += f"; {' and '.join(lost)} at an end of it (limit {RAIL:.0%}): supply or wiper lost?"
    elif moved:
        text += f"; moved: {', '.join(name.removesuffix('_pot') for name in moved)}"
    else:
        text += "; to see their travel move the sticks during the check"
    yield graded("surfaces", not lost, text, _failure(config, [CHANNEL_BY_NAME[name].group for name in lost]))


def _failure(config: LoggerConfig, groups: Sequence[str]) -> PreflightVerdict:
    """A no-go where one of the groups is required."""
    sections = [config.sensors.section(group) for group in groups]
    required = any(section is not None and section.required for section in sections)
    return PreflightVerdict.NO_GO if required else PreflightVerdict.CAUTION
