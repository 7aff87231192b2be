"""Facts about the sensors that the logger found out: chip coefficients, filter delays, instants within a group, ranges.

A recording carries them as `group.key`; a calibration set can hold them in `logger.toml` for streams that do not. What the
recording says takes precedence.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from daq.contract.channels import CHANNEL_BY_NAME
from groundstation.calibration.conversions import Bmp390Compensation
from groundstation.calibration.schema import CalibrationError

_SCALE_KEYS = {
    **dict.fromkeys(("accel_x", "accel_y", "accel_z"), "imu.accel_scale_m_s2"),
    **dict.fromkeys(("gyro_x", "gyro_y", "gyro_z"), "imu.gyro_scale_rad_s"),
    **dict.fromkeys(("mag_x", "mag_y", "mag_z"), "mag.scale_t"),
}
# first-order low passes; an attitude filter integrates the gyro, lag and all
_LAG_KEYS = {"accelerometer": "imu.accel_delay_s", **dict.fromkeys(("gyro", "attitude"), "imu.gyro_delay_s")}
_LONGEST_DELAY = 1.0  # s
_LARGEST_SCALE = 1e3  # units a count; every real scale is far below one
_LARGEST_OFFSET = 1e6  # Pa or K; as a pressure, ten atmospheres
_AMBIENT_PRESSURES = 5e4, 1.2e5  # Pa, at which a sensor may have been calibrated: up to 5.5 km of altitude
_LARGEST_COUNT = 65535.0

INSTANT_STEP = 1e-3
"""[s] The measured instants within a group differ a little from flight to flight. Rounded to this step they are the same in a
recording and in `logger.toml`, so that a stream without facts gives the same flight to the last bit."""


@dataclass(frozen=True)
class RecordedFacts:
    """`group.key` -> text, as recorded."""

    values: Mapping[str, str]
    _numbers: dict[str, float | None] = field(default_factory=dict, init=False, repr=False, compare=False)

    def nvm(self, group: str) -> bytes:
        """Coefficient bytes of a group's chip; empty when not known. Raises CalibrationError when not hexadecimal."""
        text = self.values.get(f"{group}.nvm", "")
        try:
            return bytes.fromhex(text)
        except ValueError:
            raise CalibrationError(f"fact {group}.nvm = {text!r} is not hexadecimal; correct logger.toml") from None

    def zero_count(self, instrument: str) -> float | None:
        """Count of an instrument at zero input, measured before flight; None when it was not measured."""
        return self._number(f"{instrument}.zero_count")

    def transfer(self, group: str, unit: str) -> tuple[float, float] | None:
        """Scale [unit/count] and value at count zero [unit] of a group's chip by its data sheet; None when not known.

        unit: `pa` or `k`.
        """
        scale = self._number(f"{group}.scale_{unit}")
        return None if scale is None else (scale, self._number(f"{group}.offset_{unit}") or 0.0)

    @property
    def thermal_pitot_pa(self) -> float | None:
        """Ambient pressure [Pa] at which a thermal pitot sensor, which measures mass flow, reads true; None for other sensors."""
        return self._number("pitot.calibrated_pa")

    def stamped(self, group: str) -> bool:
        """Whether a group's samples carry their sender's time, and repeat in each scan until the next one."""
        return self.values.get(f"{group}.stamped") == "sender"

    def delay(self, instrument: str, group: str) -> float:
        """Delay of an instrument's reading by the chip's own filter [s]; 0 when not known."""
        if instrument in _LAG_KEYS:
            return 0.0
        return self._number(f"{group}.filter_delay_s") or 0.0

    def lag(self, instrument: str) -> float:
        """Time constant of an instrument's first-order low pass [s]; 0 when there is none or it is not known."""
        if instrument == "attitude" and self.stamped("attitude"):
            return 0.0  # an autopilot's filter takes the gyro before its low pass
        key = _LAG_KEYS.get(instrument)
        return (self._number(key) or 0.0) if key else 0.0

    def offset_in_group(self, channel: str) -> float:
        """Time at which a channel was sampled after its group's instant [s], to INSTANT_STEP; 0 when not known."""
        key = f"{CHANNEL_BY_NAME[channel].group}.{channel}_after_s"
        measured = self._number(key) or 0.0
        return round(measured / INSTANT_STEP) * INSTANT_STEP

    def scale(self, channel: str) -> float | None:
        """Units per count of a channel: that of the recorded range where it is not the table's."""
        row = CHANNEL_BY_NAME[channel]
        if row.scale is None:
            return None
        key = _SCALE_KEYS.get(channel)
        if key is None and row.group.startswith("analog"):
            key = f"{row.group}.scale_v"
        if key is None and channel.startswith("pwm"):
            key = "capture.scale_s"
        recorded = self._number(key) if key else None
        return recorded if recorded and not math.isclose(recorded, row.scale, rel_tol=1e-9) else row.scale

    def _number(self, key: str) -> float | None:
        """The number of a fact, checked once: live, each scan asks for all of them."""
        if key not in self._numbers:
            self._numbers[key] = self._checked(key)
        return self._numbers[key]

    def _checked(self, key: str) -> float | None:
        text = self.values.get(key)
        if text is None:
            return None
        reason = _why_not(key, text)
        if reason:
            raise CalibrationError(f"{reason}; correct logger.toml")
        return float(text)


class Reported(NamedTuple):
    """Facts that passed their check, and those that did not. refused: name -> why it is not used."""

    facts: Mapping[str, str]
    refused: Mapping[str, str]


def reported(values: Mapping[str, str]) -> Reported:
    """The facts of a sender, each checked against its bounds. Facts that this program does not use pass. Never raises."""
    refused_facts = {key: reason for key, text in values.items() if (reason := _why_not(key, text))}
    return Reported({k: v for k, v in values.items() if k not in refused_facts}, refused_facts)


def _why_not(key: str, text: str) -> str:
    """Why a fact cannot be used; empty where it can, or where nothing here uses it."""
    if key.endswith(".nvm"):
        return _why_no_coefficients(key, text)
    bounds = _bounds(key)
    if bounds is None:
        return ""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    low, high = bounds
    return "" if low <= value <= high else f"fact {key} = {text[:40]!r} is not a number from {low:g} to {high:g}"


def _why_no_coefficients(key: str, text: str) -> str:
    """Why a fact cannot be read as coefficients of a chip; empty where it can."""
    try:
        coefficients = bytes.fromhex(text)
        if coefficients and key.startswith("static."):
            Bmp390Compensation.from_nvm(coefficients)
    except (ValueError, CalibrationError) as error:
        detail = f": {error}" if isinstance(error, CalibrationError) else ""
        return f"fact {key} = {text[:40]!r} holds no coefficients in hexadecimal{detail}"
    return ""


def _bounds(key: str) -> tuple[float, float] | None:
    """Smallest and largest possible number of a fact; None for a fact that is no number, or that nothing here uses."""
    if (
        key in _SCALE_KEYS.values()
        or key in ("capture.scale_s", "pitot.scale_pa", "static.scale_pa", "static.scale_k")
        or (key.startswith("analog") and key.endswith(".scale_v"))
    ):
        return 0.0, _LARGEST_SCALE
    if key in _LAG_KEYS.values():
        return 0.0, _LONGEST_DELAY
    if key in ("pitot.offset_pa", "static.offset_pa", "static.offset_k"):
        return -_LARGEST_OFFSET, _LARGEST_OFFSET
    if key == "pitot.calibrated_pa":
        return _AMBIENT_PRESSURES
    if key.endswith(".zero_count"):
        return 0.0, _LARGEST_COUNT
    if key.endswith((".filter_delay_s", "_after_s")):
        return -_LONGEST_DELAY, _LONGEST_DELAY
    return None
