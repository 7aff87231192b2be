"""The aircraft's motion from a scan with nominal transfer functions: accurate enough to protect the aircraft.

Bank and load factor to about 1 deg and 0.02, airspeed to some per cent (indicated, sea-level density), angle of attack to
about 1 deg at the vane. A quantity whose last good sample is too old is None.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from daq.actuation.config import EnvelopeConfig, SequencerConfig
from daq.contract.scan import RawValue, Scan, SensorState
from daq.contract.sequencing import Reason
from daq.sensors.config import SensorsConfig
from daq.sensors.icm20948 import COUNTS_PER_G
from daq.sensors.ms4525do import indicated_airspeed, nominal_transfer

_MS = 1_000_000
_QUATERNION_SCALE = 1 / 32767
_NEEDED: Mapping[str, str] = {
    "attitude": "quaternion_w",
    "imu": "accel_z",
    "pitot": "pitot_pressure",
    "analog_a": "alpha_vane",
    "gnss": "height_msl_mm",
}
"""Sensor group -> the channel without which its sample is not used."""


@dataclass(frozen=True, slots=True)
class MotionState:
    """Motion at one instant, None where not known.

    bank, alpha [rad]; load_factor [1], positive upwards; airspeed: indicated [m/s]; height: above the field [m].
    """

    bank: float | None = None
    load_factor: float | None = None
    airspeed: float | None = None
    alpha: float | None = None
    height: float | None = None


class MotionReader:
    """Converts the counts of each scan; holds the last good sample of each group for as long as the limits allow."""

    def __init__(self, config: SequencerConfig, sensors: SensorsConfig) -> None:
        limits = config.limits
        self._stale_ns = round(limits.stale_ms * _MS)
        self._gnss_stale_ns = round(limits.gnss_stale_ms * _MS)
        self._elevation = limits.field_elevation_m
        self._vane = config.alpha_vane
        self._g_per_count = 1.0 / COUNTS_PER_G[getattr(sensors.section("imu"), "accel_range_g", 8)]
        self._volt_per_count = getattr(sensors.section("analog_a"), "range_v", 4.096) / 32768
        self._pascal_per_count, self._pascal_at_zero = nominal_transfer(sensors.section("pitot"))
        self._good: dict[str, tuple[int, Mapping[str, RawValue]]] = {}

    def read(self, scan: Scan, now_ns: int) -> MotionState:
        """The motion at `now_ns`, from this scan and earlier ones."""
        for group, channel in _NEEDED.items():
            status = scan.groups.get(group)
            if status is not None and status.state is SensorState.OK and channel in scan.values:
                self._good[group] = scan.time_monotonic_ns + 1000 * status.offset_us, scan.values
        return MotionState(
            bank=self._bank(now_ns),
            load_factor=self._scaled("imu", "accel_z", now_ns, -self._g_per_count),
            airspeed=self._airspeed(now_ns),
            alpha=self._alpha(now_ns),
            height=self._height(now_ns),
        )

    def _values(self, group: str, now_ns: int) -> Mapping[str, RawValue]:
        """All values of the scan in which a group was last good; empty when that is too old."""
        sample = self._good.get(group)
        stale_ns = self._gnss_stale_ns if group == "gnss" else self._stale_ns
        return sample[1] if sample is not None and now_ns - sample[0] <= stale_ns else {}

    def _scaled(self, group: str, channel: str, now_ns: int, scale: float) -> float | None:
        count = self._values(group, now_ns).get(channel)
        return None if count is None else count * scale

    def _bank(self, now_ns: int) -> float | None:
        values = self._values("attitude", now_ns)
        if "quaternion_w" not in values:
            return None
        w, x, y, z = (values[f"quaternion_{c}"] * _QUATERNION_SCALE for c in "wxyz")
        return math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))

    def _airspeed(self, now_ns: int) -> float | None:
        count = self._values("pitot", now_ns).get("pitot_pressure")
        if count is None:
            return None
        pressure = count * self._pascal_per_count + self._pascal_at_zero
        return indicated_airspeed(pressure)

    def _alpha(self, now_ns: int) -> float | None:
        volts = self._scaled("analog_a", "alpha_vane", now_ns, self._volt_per_count)
        return None if volts is None else (volts - self._vane.centre_v) * self._vane.rad_per_v

    def _height(self, now_ns: int) -> float | None:
        height = self._scaled("gnss", "height_msl_mm", now_ns, 1e-3)
        return None if height is None else height - self._elevation


class FlightEnvelope:
    """The configured limits of motion; a limited quantity that is not known counts as a stale sensor."""

    def __init__(self, limits: EnvelopeConfig) -> None:
        bank = None if limits.bank_deg is None else (-math.radians(limits.bank_deg), math.radians(limits.bank_deg))
        alpha = (
            None if limits.alpha_deg is None else (math.radians(limits.alpha_deg[0]), math.radians(limits.alpha_deg[1]))
        )
        degree, unity = math.degrees(1.0), 1.0
        rows = (
            ("bank", bank, Reason.BANK, degree, "deg"),
            ("load_factor", limits.load_factor, Reason.LOAD_FACTOR, unity, ""),
            ("airspeed", limits.airspeed, Reason.AIRSPEED, unity, "m/s"),
            ("alpha", alpha, Reason.ALPHA, degree, "deg"),
            ("height", limits.height_m, Reason.HEIGHT, unity, "m"),
        )
        self._rows = [
            (name, limit, reason, scale, unit) for name, limit, reason, scale, unit in rows if limit is not None
        ]

    def judge(self, motion: MotionState) -> tuple[Reason, str] | None:
        """Reason and detail of the first violation, stale sensors before limits; None within all limits."""
        for name, *_ in self._rows:
            if getattr(motion, name) is None:
                return Reason.SENSOR, f"no {name.replace('_', ' ')}"
        for name, (low, high), reason, scale, unit in self._rows:
            value = getattr(motion, name)
            if not low <= value <= high:
                extent = f"{low * scale:.3g} to {high * scale:.3g} {unit}".rstrip()
                return reason, f"{value * scale:.3g} outside {extent}"
        return None
