"""Feeds the attitude filter from a scan's IMU, magnetometer, pitot and GPS counts."""

import math
from collections.abc import Mapping

from daq.acquisition.attitude import AttitudeFilter
from daq.acquisition.health import GroupHealth
from daq.acquisition.supervisor import GroupOutcome
from daq.contract.scan import RawValue, SensorState
from daq.sensors.config import SensorsConfig
from daq.sensors.gravity_reference import VelocityFix
from daq.sensors.icm20948 import COUNTS_PER_DPS, COUNTS_PER_G
from daq.sensors.ms4525do import indicated_airspeed, nominal_transfer
from daq.utilities.constants import GRAVITY

_USABLE = (SensorState.OK, SensorState.RECOVERING, SensorState.OUT_OF_RANGE)
_TESLA_PER_COUNT = 0.15e-6


class AttitudeSource:
    """The attitude as a group of its own, computed once for each IMU sample."""

    AIRSPEED_HELD_NS = 500_000_000

    def __init__(self, config: SensorsConfig, imu_rate_hz: float, now_ns: int) -> None:
        assert config.attitude is not None
        imu = config.section("imu")
        self.record = GroupHealth(
            "attitude", SensorState.RECOVERING, since_ns=now_ns, required=config.attitude.required
        )
        gyro_range = getattr(imu, "gyro_range_dps", 500)
        self._accel_scale = GRAVITY / COUNTS_PER_G[getattr(imu, "accel_range_g", 8)]
        self._gyro_scale = math.radians(1 / COUNTS_PER_DPS[gyro_range])
        self._filter = AttitudeFilter(config.attitude, imu_rate_hz, math.radians(gyro_range))
        lowpass_hz = getattr(imu, "accel_lowpass_hz", 0.0)
        self._imu_delay_s = 1.0 / (2.0 * math.pi * lowpass_hz) if lowpass_hz else 0.0
        self._pascal_per_count, self._pascal_at_zero = nominal_transfer(config.pitot)
        self._airspeed: float | None = None
        self._airspeed_ns = 0

    def update(self, outcomes: Mapping[str, GroupOutcome], scan_ns: int) -> GroupOutcome:
        """The attitude belonging to this scan's IMU sample."""
        imu = outcomes["imu"]
        counts = imu.values
        if imu.state not in _USABLE or not counts:
            return self._report(SensorState.ABSENT, f"IMU is {imu.state.words}", scan_ns, {})
        self._note_airspeed(outcomes.get("pitot"))
        gyro, accel = self._gyro_scale, self._accel_scale
        attitude = self._filter.update(
            imu.time_ns * 1e-9,
            (counts["gyro_x"] * gyro, counts["gyro_y"] * gyro, counts["gyro_z"] * gyro),
            (counts["accel_x"] * accel, counts["accel_y"] * accel, counts["accel_z"] * accel),
            _field(outcomes.get("mag")),
            self._airspeed if imu.time_ns - self._airspeed_ns < self.AIRSPEED_HELD_NS else None,
            self._fix(outcomes.get("gnss")),
        )
        if imu.state is not SensorState.OK:
            return self._report(SensorState.RECOVERING, f"IMU is {imu.state.words}", imu.time_ns, attitude.counts())
        if attitude.initialising:
            return self._report(SensorState.RECOVERING, "finding its level", imu.time_ns, attitude.counts())
        return self._report(SensorState.OK, "", imu.time_ns, attitude.counts())

    def _report(self, state: SensorState, detail: str, time_ns: int, values: Mapping[str, RawValue]) -> GroupOutcome:
        self.record.note(state, detail, time_ns)
        return GroupOutcome(state, detail, time_ns, values)

    def _fix(self, gnss: GroupOutcome | None) -> VelocityFix | None:
        if gnss is None or gnss.state is not SensorState.OK or "velocity_north_mm" not in gnss.values:
            return None
        counts = gnss.values
        velocity = (
            counts["velocity_north_mm"] * 1e-3,
            counts["velocity_east_mm"] * 1e-3,
            counts["velocity_down_mm"] * 1e-3,
        )
        return VelocityFix(gnss.time_ns * 1e-9 + self._imu_delay_s, velocity)

    def _note_airspeed(self, pitot: GroupOutcome | None) -> None:
        """Airspeed by the pitot sensor's nominal transfer function; good to a few per cent, enough for the turn."""
        if pitot is None or pitot.state is not SensorState.OK or math.isnan(self._pascal_per_count):
            return
        pressure = pitot.values["pitot_pressure"] * self._pascal_per_count + self._pascal_at_zero
        self._airspeed = indicated_airspeed(pressure)
        self._airspeed_ns = pitot.time_ns


def _field(mag: GroupOutcome | None) -> tuple[float, float, float] | None:
    if mag is None or mag.state is not SensorState.OK:
        return None
    counts = mag.values
    return counts["mag_x"] * _TESLA_PER_COUNT, counts["mag_y"] * _TESLA_PER_COUNT, counts["mag_z"] * _TESLA_PER_COUNT
