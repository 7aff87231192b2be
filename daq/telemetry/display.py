"""Air data for the eye of whoever watches a standard ground station: from raw counts and a few numbers of the configuration.

The numbers are `[downlink.display]`, nominal ones of data sheet and installation drawing. What they do not cover is None:
no value is better than a wrong one. Nothing that is recorded, sent down as counts or estimated ever passes through here.
SI and radians; body axes x forward, y right, z down.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from daq.contract.bmp390 import Bmp390Trimming
from daq.contract.channels import CHANNEL_BY_NAME
from daq.contract.scan import Scan, SensorState
from daq.sensors.standstill import PITOT_PASCAL
from daq.telemetry.config import DisplayConfig
from daq.utilities.constants import (
    GAS_CONSTANT,
    HEAT_RATIO,
    LAPSE_RATE,
    SEA_LEVEL_DENSITY,
    SEA_LEVEL_PRESSURE,
    SEA_LEVEL_TEMPERATURE,
    ZERO_CELSIUS,
)

Vector = tuple[float, float, float]

_DENSITY_EXPONENT = 4.25588  # g / (R L) - 1
_SOUND_SQUARED = HEAT_RATIO * GAS_CONSTANT * SEA_LEVEL_TEMPERATURE

LEAST_AIRSPEED = 8.0
"""Below this calibrated airspeed [m/s] no wind is told: the 40 Pa of it are what the pitot's zero may be off
(65 Pa for a volt of supply), and vanes of an aircraft that is hardly moving point anywhere."""
WIND_TIME_S = 20.0
"""Time constant of the wind's mean: several periods of phugoid and Dutch roll of a small aircraft, whose errors average out."""

PRESSURES, TEMPERATURES = (2.0e4, 1.3e5), (220.0, 370.0)
"""What a BMP390 can measure (300 to 1250 hPa, -40 to 85 C: BST-BMP390-DS002, table 2) and a margin; else its coefficients are
not what they were."""

_QUATERNION = ("quaternion_w", "quaternion_x", "quaternion_y", "quaternion_z")
_VELOCITY = ("velocity_north_mm", "velocity_east_mm", "velocity_down_mm")


def measured(scan: Scan, name: str) -> float | None:
    """A raw value of a scan; None where it is missing, or its sensor does not vouch for it."""
    status = scan.groups.get(CHANNEL_BY_NAME[name].group)
    if status is None or status.state not in (SensorState.OK, SensorState.STALE):
        return None
    return scan.values.get(name)


def attitude(scan: Scan) -> tuple[float, float, float, float] | None:
    """The attitude filter's quaternion w, x, y, z, which turns body axes into north, east, down."""
    if any(name not in scan.values for name in _QUATERNION):
        return None
    w, x, y, z = (scan.values[name] / 32767 for name in _QUATERNION)
    return w, x, y, z


def heading(quaternion: tuple[float, float, float, float]) -> float:
    """Heading from true north, clockwise, 0 to 2 pi [rad]."""
    w, x, y, z = quaternion
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) % math.tau


def calibrated_airspeed(dynamic_pressure: float) -> float:
    """Calibrated airspeed [m/s] of isentropic flow at standard sea level; 0 where the pressure [Pa] is not positive."""
    rise = math.expm1(0.4 / 1.4 * math.log1p(max(0.0, dynamic_pressure) / SEA_LEVEL_PRESSURE))
    return math.sqrt(2 / 0.4 * _SOUND_SQUARED * rise)


def standard_density(altitude: float) -> float:
    """Density of the standard atmosphere below 11 km [kg/m3]."""
    ratio = 1 - LAPSE_RATE / SEA_LEVEL_TEMPERATURE * min(max(altitude, -1000.0), 11_000.0)
    return float(SEA_LEVEL_DENSITY * ratio**_DENSITY_EXPONENT)


class Display:
    """Turns raw scans into what is shown.

    facts: run-time facts of the sensors, `static.nvm` among them (the pressure chip's own coefficients).
    """

    def __init__(self, config: DisplayConfig, facts: Callable[[], Mapping[str, str]] = dict) -> None:
        self._config = config
        self._facts = facts
        self._nvm = ""
        self._chip: Bmp390Trimming | None = None
        self._linear = (math.nan, math.nan, 0.0)  # Pa and K a count, K at zero: of what compensates by itself
        self.pitot_pascal = PITOT_PASCAL
        """Pascal a count of the pitot."""
        self.pitot_zero_count = config.pitot_zero_count
        """Count of the pitot at rest; a pitot zeroed by command replaces the configured one."""

    def look_up_facts(self) -> None:
        """Ask for the pressure chip's coefficients, which are known once the chip has been found."""
        facts = self._facts()
        nvm = facts.get("static.nvm", "")
        pascal, kelvin, coldest = (facts.get(f"static.{key}") for key in ("scale_pa", "scale_k", "offset_k"))
        self._linear = float(pascal or "nan"), float(kelvin or "nan"), float(coldest or 0.0)
        self.pitot_pascal = float(facts.get("pitot.scale_pa", PITOT_PASCAL))
        if nvm != self._nvm:
            self._nvm, self._chip = nvm, _chip(nvm)

    def static(self, scan: Scan) -> tuple[float, float] | None:
        """Static pressure [Pa] and the chip's temperature [K]."""
        raw, warmth = measured(scan, "static_pressure"), measured(scan, "static_temperature")
        if raw is None or warmth is None:
            return None
        if self._chip is not None:
            pressure, temperature = self._chip.compensate(float(raw), float(warmth))
        else:
            pressure, temperature = raw * self._linear[0], warmth * self._linear[1] + self._linear[2]
        if PRESSURES[0] < pressure < PRESSURES[1] and TEMPERATURES[0] < temperature < TEMPERATURES[1]:
            return pressure, temperature
        return None

    def dynamic_pressure(self, scan: Scan) -> float | None:
        """Pitot minus static pressure [Pa]."""
        count, zero, slope = measured(scan, "pitot_pressure"), self.pitot_zero_count, self._config.pitot_pa_per_count
        return None if count is None or zero is None or slope is None else (count - zero) * slope

    def airspeed(self, scan: Scan) -> float | None:
        """Calibrated airspeed [m/s]."""
        pressure = self.dynamic_pressure(scan)
        return None if pressure is None else calibrated_airspeed(pressure)

    def alpha(self, scan: Scan) -> float | None:
        """Angle of attack at the vane [rad], nose up positive."""
        return self._vane(scan, "alpha_vane", self._config.alpha_zero_count, self._config.alpha_rad_per_count)

    def beta(self, scan: Scan) -> float | None:
        """Sideslip at the vane [rad], wind from the right positive."""
        return self._vane(scan, "beta_vane", self._config.beta_zero_count, self._config.beta_rad_per_count)

    def _vane(self, scan: Scan, name: str, zero: float | None, slope: float | None) -> float | None:
        count = measured(scan, name)
        if count is None or zero is None or slope is None:
            return None
        reference = self._config.sensor_supply_count
        if reference is not None:  # a potentiometer divides its supply, whatever that is at the moment
            supply = measured(scan, "sensor_supply")
            if not supply or supply < 0:
                return None
            count *= reference / supply
        return (count - zero) * slope

    def supply_voltage(self, scan: Scan, volts_per_count: float | None) -> float | None:
        """Main supply [V]."""
        count = measured(scan, "supply")
        return None if count is None or volts_per_count is None else max(0.0, count * volts_per_count)

    def wind(self, scan: Scan) -> Vector | None:
        """The wind as this scan alone shows it, the air's velocity to north, east, down [m/s]; needs a fix in the scan."""
        ground = velocity(scan)
        turn = attitude(scan)
        speed, alpha, beta = self.airspeed(scan), self.alpha(scan), self.beta(scan)
        if ground is None or turn is None or speed is None or alpha is None or beta is None or speed < LEAST_AIRSPEED:
            return None
        static = self.static(scan)
        if static is not None:
            density = static[0] / (GAS_CONSTANT * static[1])
        else:
            density = standard_density(scan.values.get("height_msl_mm", 0) * 1e-3)
        true = speed * math.sqrt(SEA_LEVEL_DENSITY / density)
        body = (true * math.cos(alpha) * math.cos(beta), true * math.sin(beta), true * math.sin(alpha) * math.cos(beta))
        north, east, down = _body_to_ned(turn, body)
        return ground[0] - north, ground[1] - east, ground[2] - down


def velocity(scan: Scan) -> Vector | None:
    """Velocity over ground, north, east, down [m/s], of a scan with a three-dimensional fix."""
    if scan.values.get("gnss_fix", 0) < 3 or any(name not in scan.values for name in _VELOCITY):
        return None
    north, east, down = (scan.values[name] * 1e-3 for name in _VELOCITY)
    return north, east, down


def _chip(nvm: str) -> Bmp390Trimming | None:
    try:
        return Bmp390Trimming.from_nvm(bytes.fromhex(nvm))
    except ValueError:  # no chip yet, or a damaged one, which the sensor's own state tells
        return None


def _body_to_ned(quaternion: tuple[float, float, float, float], v: Vector) -> Vector:
    """A body vector in north, east, down: v + 2 w (q x v) + 2 q x (q x v)."""
    w, x, y, z = quaternion
    a, b, c = 2 * (y * v[2] - z * v[1]), 2 * (z * v[0] - x * v[2]), 2 * (x * v[1] - y * v[0])
    return v[0] + w * a + y * c - z * b, v[1] + w * b + z * a - x * c, v[2] + w * c + x * b - y * a


@dataclass(frozen=True, slots=True)
class WindEstimate:
    """Mean wind to north, east, down [m/s] and its variability, one sigma, horizontal and vertical [m/s]."""

    mean: Vector
    horizontal: float
    vertical: float


class WindMean:
    """The exponentially weighted mean of winds seen one after another.

    It is told when observations span a time constant, and no longer when they have stopped for one.
    """

    def __init__(self, time_s: float = WIND_TIME_S) -> None:
        self._time_s = time_s
        self._since: float | None = None
        self._last = -math.inf
        self._mean: Vector = (0.0, 0.0, 0.0)
        self._square: Vector = (0.0, 0.0, 0.0)  # of the distance from the mean

    def add(self, time: float, wind: Vector) -> None:
        """An observation at `time` [s]."""
        if self._since is None or time - self._last > self._time_s:
            self._since, self._mean, self._square = time, wind, (0.0, 0.0, 0.0)
        else:
            share = 1 - math.exp(-max(0.0, time - self._last) / self._time_s)
            deviation = tuple(w - m for w, m in zip(wind, self._mean, strict=True))
            north, east, down = (m + share * d for m, d in zip(self._mean, deviation, strict=True))
            self._mean = north, east, down
            n, e, d = ((1 - share) * (s + share * d * d) for s, d in zip(self._square, deviation, strict=True))
            self._square = n, e, d
        self._last = time

    def estimate(self, time: float) -> WindEstimate | None:
        """The wind as known at `time` [s]."""
        if self._since is None or self._last - self._since < self._time_s or time - self._last > self._time_s:
            return None
        north, east, down = self._square
        return WindEstimate(self._mean, math.sqrt((north + east) / 2), math.sqrt(down))


def celsius(kelvin: float) -> float:
    """A temperature [K] in degrees Celsius, as MAVLink has it."""
    return kelvin - ZERO_CELSIUS
