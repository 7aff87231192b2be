"""Contradictions between sensors, at rest and in flight: a pitot that is not zeroed, or swapped, covered or blocked; a frozen
vane; a turned IMU. Judged once a second over the last five, from raw counts at nominal scales.

At rest a pitot off by more than `OFFSET_PA` is zeroed before motion. Wind differs from an offset by its variance: gusts of a
fifth of the mean speed vary the pressure by two fifths of its mean.
"""

import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from statistics import fmean, pstdev

from daq.contract.scan import Scan
from daq.sensors.config import SensorsConfig
from daq.sensors.icm20948 import COUNTS_PER_DPS, COUNTS_PER_G
from daq.sensors.mounting import AS_PRINTED, Axis, Mounting, check_mounting
from daq.sensors.ms4525do import indicated_airspeed, nominal_transfer
from daq.sensors.standstill import LEAST_SCANS, counts, ground_speed, motion_evidence, pitot_motion_evidence
from daq.utilities.constants import (
    FLYING_GROUND_SPEED,
    GRAVITY,
    LEAST_PITOT_PRESSURE,
    LEAST_PITOT_SHARE,
    SEA_LEVEL_DENSITY,
)

WINDOW_S = 5.0  # of scans that a check uses
CHECK_INTERVAL_S = 1.0
OFFSET_PA = 10.0
"""A larger offset of the pitot at rest is zeroed: 5 % of the dynamic pressure at 18 m/s, so 5 % of each derivative."""
BROKEN_PA = 300.0
"""A larger offset at rest, twice what makers and users report, is a fault: trapped pressure or a wrong range."""
STEADY = 0.25
"""A pressure whose standard deviation is less than this share of its mean is an offset, not wind (which has 0.4)."""
MOST_SHARE = 4.0
"""Largest pitot pressure over that by the ground speed: more is a head wind as fast as it, or pressure trapped in the tube."""
FROZEN_COUNTS, FROZEN_ENCODER_COUNTS = 8.0, 2.0
"""Least travel of a vane in flight within the window, for an ADS1115 and an encoder: eight counts at 4.096 V are 1 mV, a tenth of
a degree; two counts of an encoder are a sixth of a degree."""
TILT_RAD = math.radians(35.0)
"""Largest tilt at rest: more than any aircraft on its gear, tail draggers (15 degrees) and a wing on the ground included."""
FORCE_ERROR = 0.1
"""Largest relative error of specific force at rest: six times a consumer accelerometer's zero and scale together."""
LAUNCH_GAIN = 7.0
"""Least gain of ground speed within the window [m/s], 1.4 m/s2: a tail that rises by 12 degrees meanwhile cannot reverse the
acceleration that the IMU shows."""
LAUNCH_SHARE = 0.5
"""Least share of that gain that the accelerometers must show for its direction to be judged."""
LAUNCH_TURN_RAD = math.radians(60.0)
"""Largest angle of the acceleration to body x: more than by bank and a rising tail, less than by a box turned at a right
angle."""
_AXES: tuple[Axis, ...] = ("+x", "-x", "+y", "-y", "+z", "-z")
_VANES = {
    "alpha_vane": ("angle-of-attack vane", FROZEN_COUNTS),
    "beta_vane": ("sideslip vane", FROZEN_COUNTS),
    "alpha_encoder": ("angle-of-attack vane", FROZEN_ENCODER_COUNTS),
    "beta_encoder": ("sideslip vane", FROZEN_ENCODER_COUNTS),
}


@dataclass(frozen=True, slots=True)
class SensorContradiction:
    """A contradiction. subject: sensor or channel; text: a sentence with value, unit and limit."""

    subject: str
    text: str


@dataclass(frozen=True, slots=True)
class PitotAtRest:
    """The pitot at rest. count: mean reading [counts]; offset_pa: the same relative to the data sheet's zero [Pa]; spread_pa:
    standard deviation [Pa]; scans: how many."""

    count: float
    offset_pa: float
    spread_pa: float
    scans: int

    @property
    def steady(self) -> bool:
        """Whether the reading is an offset rather than wind."""
        return self.spread_pa <= max(STEADY * abs(self.offset_pa), OFFSET_PA / 2)

    @property
    def words(self) -> str:
        """The reading in words, with the airspeed it would mean."""
        speed = indicated_airspeed(abs(self.offset_pa))
        return f"{self.offset_pa:+.0f} Pa ({speed:.0f} m/s), spread {self.spread_pa:.1f} Pa"


class Scales:
    """Nominal scales of the fitted sensors: accel [m/s2 per count], gyro [rad/s per count], pascal [Pa per count], pascal_at_zero
    [Pa at count zero]; NaN where not known."""

    def __init__(self, config: SensorsConfig) -> None:
        imu = config.section("imu")
        self.accel = GRAVITY / COUNTS_PER_G[getattr(imu, "accel_range_g", 8)]
        self.gyro = math.radians(1 / COUNTS_PER_DPS[getattr(imu, "gyro_range_dps", 500)])
        self.pascal, self.pascal_at_zero = nominal_transfer(config.pitot)
        self.mounting: Mounting = getattr(imu, "mounting", AS_PRINTED)

    def force(self, scans: Sequence[Scan]) -> tuple[float, float, float] | None:
        """Mean specific force in body axes [m/s2]; None without enough valid samples of an IMU."""
        axes = [counts(scans, f"accel_{a}") for a in "xyz"]
        if len(axes[0]) < LEAST_SCANS:
            return None
        x, y, z = (fmean(axis) * self.accel for axis in axes)
        return x, y, z


def pitot_at_rest(scans: Sequence[Scan], scales: Scales) -> PitotAtRest | None:
    """The pitot's reading at rest; None while the aircraft moves, or without a pitot of known scale."""
    pitot = counts(scans, "pitot_pressure")
    if math.isnan(scales.pascal) or len(pitot) < LEAST_SCANS or motion_evidence(scans):
        return None
    mean = fmean(pitot)
    offset = mean * scales.pascal + scales.pascal_at_zero
    return PitotAtRest(mean, offset, pstdev(pitot) * scales.pascal, len(pitot))


def level(scans: Sequence[Scan], scales: Scales) -> tuple[bool, str] | None:
    """Whether gravity lies along body z at rest, and a sentence; None while the aircraft moves, or without an IMU."""
    force = scales.force(scans)
    if force is None or motion_evidence(scans):
        return None
    size = math.hypot(*force)
    measured_force = "specific force " + ", ".join(f"{n} {f:+.1f}" for n, f in zip("xyz", force, strict=True)) + " m/s2"
    if abs(size - GRAVITY) > FORCE_ERROR * GRAVITY:
        return (
            False,
            f"{measured_force} is {size:.1f} in all, not 9.8 (limit {FORCE_ERROR:.0%}); check accel_range_g, or calibrate",
        )
    tilt = math.acos(max(-1.0, min(1.0, -force[2] / size)))
    measured_tilt = f"{measured_force}: {math.degrees(tilt):.0f} deg from level (limit {math.degrees(TILT_RAD):.0f})"
    if tilt <= TILT_RAD:
        return True, measured_tilt
    right = mounting_for(force, scales.mounting)
    suggestion = "[" + ", ".join(f"'{axis}'" for axis in right) + "]"
    return (
        False,
        f"{measured_tilt}; z should be -9.8 at rest: if the aircraft stands upright write sensors.imu.mounting = {suggestion}",
    )


def mounting_for(force: tuple[float, float, float], mounting: Mounting) -> Mounting:
    """The mounting that puts gravity along body z and changes fewest axes. force: mean specific force at rest under the present
    `mounting`, body axes [m/s2]."""
    vertical = max(range(3), key=lambda i: abs(force[i]))
    sign = 1 if force[vertical] < 0 else -1  # the sign with which this axis reads -9.8
    vertical_axis = mounting[vertical] if sign > 0 else _reversed(mounting[vertical])
    closest, most_equal = mounting, -1
    for x in _AXES:
        for y in _AXES:
            if len({x[1], y[1], vertical_axis[1]}) < 3:
                continue
            try:
                trial = check_mounting((x, y, vertical_axis))
            except ValueError:
                continue
            equal_axes = 2 * (x == mounting[0]) + (y == mounting[1])
            if equal_axes > most_equal:
                closest, most_equal = trial, equal_axes
    return closest


def facing(forward: Axis, mounting: Mounting) -> Mounting:
    """The mounting turned about body z so that its axis `forward` (x or y, either sign) becomes body x."""
    x, y, z = mounting
    turned = {"+x": (x, y), "-x": (_reversed(x), _reversed(y)), "+y": (y, _reversed(x)), "-y": (_reversed(y), x)}
    return check_mounting((*turned[forward], z))


def _reversed(axis: Axis) -> Axis:
    return _AXES[_AXES.index(axis) ^ 1]


class AirTruth:
    """Checks scans as they come: `check` returns new contradictions, `zero` a pitot offset to record before the first motion."""

    def __init__(self, config: SensorsConfig, *, auto_zero: bool = True) -> None:
        self._scales = Scales(config)
        self._scans: deque[Scan] = deque()
        self._next = -math.inf
        self._reported: set[str] = set()  # subjects of the contradictions at the last check
        self._auto_zero = auto_zero
        self._moved = self._zeroed = False
        self._rest: tuple[float, float, float] | None = None  # specific force before the first motion
        self._zero_count = -self._scales.pascal_at_zero / self._scales.pascal if self._scales.pascal else math.nan

    def zeroed(self, count: float) -> None:
        """Take note that the pitot was zeroed at this count, by the logger or by command."""
        self._zero_count, self._auto_zero, self._zeroed = count, False, True

    def check(self, scan: Scan) -> list[SensorContradiction]:
        """Add a scan; once a second, returns the contradictions that were absent at the last check."""
        self._scans.append(scan)
        while scan.time - self._scans[0].time > WINDOW_S:
            self._scans.popleft()
        if scan.time < self._next:
            return []
        self._next = scan.time + CHECK_INTERVAL_S
        present = list(self._present()) if self._full else []
        new = [c for c in present if c.subject not in self._reported]
        self._reported = {c.subject for c in present} if self._full else self._reported
        return new

    def zero(self) -> PitotAtRest | None:
        """The pitot at rest, once, where its offset before the first motion is steady and between OFFSET_PA and BROKEN_PA."""
        if not self._auto_zero or self._moved or not self._full:
            return None
        scans = list(self._scans)
        rest = pitot_at_rest(scans, self._scales)
        if rest is None or pitot_motion_evidence(
            counts(scans, "pitot_pressure"), check_level=False, pascal=self._scales.pascal
        ):
            return None
        if not OFFSET_PA < abs(rest.offset_pa) < BROKEN_PA or not rest.steady:
            return None
        self.zeroed(rest.count)
        return rest

    @property
    def _full(self) -> bool:
        return len(self._scans) >= LEAST_SCANS and self._scans[-1].time - self._scans[0].time > 0.8 * WINDOW_S

    def _present(self) -> Iterator[SensorContradiction]:
        scans = list(self._scans)
        speeds = [s for s in map(ground_speed, scans) if s is not None]
        if len(speeds) > 1:
            yield from self._launch(scans, speeds)
        if len(speeds) < 2 or min(speeds) < FLYING_GROUND_SPEED:
            yield from self._zero_drift(scans)
            return
        self._moved = True
        yield from self._pitot(scans, fmean(speeds))
        for name, (words, least) in _VANES.items():
            vane = counts(scans, name)
            if len(vane) >= LEAST_SCANS and max(vane) - min(vane) < least:
                travel = f"moves by {max(vane) - min(vane):.0f} counts in {WINDOW_S:.0f} s at {fmean(speeds):.0f} m/s"
                yield SensorContradiction(name, f"{words} is frozen: {travel} (at least {least:.0f} in flight)")
        force = self._scales.force(scans)
        if force is not None and force[2] > -0.3 * GRAVITY:
            seen_z = f"mean specific force on body z is {force[2]:+.1f} m/s2 in flight (at most {-0.3 * GRAVITY:.1f})"
            yield SensorContradiction("imu", f"IMU is turned: {seen_z}; correct sensors.imu.mounting")

    def _launch(self, scans: Sequence[Scan], speeds: Sequence[float]) -> Iterator[SensorContradiction]:
        """Before flight: whether the aircraft accelerates along body x; gravity does not show an IMU turned about z. Not in
        flight, where a turn out of the wind raises the ground speed too."""
        force, gain = self._scales.force(scans), speeds[-1] - speeds[0]
        if force is None or self._moved:
            return
        if not motion_evidence(scans):
            self._rest = force
        if self._rest is None or gain < LAUNCH_GAIN:
            return
        duration = scans[-1].time - scans[0].time
        x, y = ((force[i] - self._rest[i]) * duration for i in range(2))
        if math.hypot(x, y) < LAUNCH_SHARE * gain or abs(math.atan2(y, x)) < LAUNCH_TURN_RAD:
            return
        forward: Axis = ("-x" if x < 0 else "+x") if abs(x) > abs(y) else ("-y" if y < 0 else "+y")
        suggestion = "[" + ", ".join(f"'{axis}'" for axis in facing(forward, self._scales.mounting)) + "]"
        limit = f"at most {math.degrees(LAUNCH_TURN_RAD):.0f} deg from x"
        push = f"GPS gained {gain:.0f} m/s, its x {x:+.0f} and its y {y:+.0f} ({limit})"
        yield SensorContradiction("imu", f"IMU is turned about z: {push}; write sensors.imu.mounting = {suggestion}")

    def _zero_drift(self, scans: Sequence[Scan]) -> Iterator[SensorContradiction]:
        """Before the first motion: whether a pitot that was zeroed still reads zero at rest."""
        rest = pitot_at_rest(scans, self._scales) if self._zeroed and not self._moved else None
        if rest is None or not rest.steady:
            return
        moved_pa = (rest.count - self._zero_count) * self._scales.pascal
        if abs(moved_pa) > OFFSET_PA:
            words = f"pitot rests at {moved_pa:+.0f} Pa since it was zeroed (limit {OFFSET_PA:.0f}): zero it again"
            yield SensorContradiction("pitot zero", words)

    def _pitot(self, scans: Sequence[Scan], speed: float) -> Iterator[SensorContradiction]:
        pitot = counts(scans, "pitot_pressure")
        if len(pitot) < LEAST_SCANS or math.isnan(self._zero_count):
            return
        pressure = (fmean(pitot) - self._zero_count) * self._scales.pascal
        by_gps = SEA_LEVEL_DENSITY / 2 * speed**2
        gps = f"at GPS {speed:.0f} m/s"
        if pressure < LEAST_PITOT_PRESSURE:
            limit = f"limit {LEAST_PITOT_PRESSURE:.0f}"
            words = f"pitot pressure is negative in flight: {pressure:.0f} Pa {gps} ({limit}): tubes swapped?"
            yield SensorContradiction("pitot sign", words)
        elif pressure < LEAST_PITOT_SHARE * by_gps:
            words = (
                f"pitot reads {pressure:.0f} Pa {gps} (at least {LEAST_PITOT_SHARE * by_gps:.0f}): covered or blocked?"
            )
            yield SensorContradiction("pitot level", words)
        elif pressure > MOST_SHARE * by_gps:
            words = (
                f"pitot reads {pressure:.0f} Pa {gps} (at most {MOST_SHARE * by_gps:.0f}): blocked with pressure in it?"
            )
            yield SensorContradiction("pitot level", words)
