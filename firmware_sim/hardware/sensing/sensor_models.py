"""Scenario table `[sensors]`: what the physical instruments are like, and where they sit.

The defaults agree with the nominal calibration of the CDFP, so that a flight on a nominal scenario is calibrated without
bench work; noise levels are those of a small aircraft with a running engine. Positions are from the CG in body axes x
forward, y right, z down [m]. `unit` other than 0 draws an individual set of instruments within the tolerances, which
then has to be calibrated on the bench.
"""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field, field_validator

from firmware_sim.hardware.bus import BusModel
from firmware_sim.tables import SimulatorTable, checked, merged

SIGNALS: tuple[str, ...] = tuple(
    (
        "accel_x accel_y accel_z gyro_x gyro_y gyro_z imu_temperature "  # body axes, m/s2, rad/s, K
        "mag_x mag_y mag_z "  # body axes, T
        "alpha_vane beta_vane elevon_left_pot elevon_right_pot rudder_pot "  # V
        "supply sensor_supply analog_1 analog_2 analog_3 analog_4 analog_5 "  # V at the converter
        "pitot_pressure pitot_temperature static_pressure static_temperature "  # Pa, K
        "thrust_bridge "  # V/V
        "latitude longitude altitude velocity_north velocity_east velocity_down "  # deg, deg, m, m/s
        "bank pitch heading_north heading_east "  # rad, rad, cosine and sine of the heading
        "alpha_encoder beta_encoder "  # rad, of the vanes' shafts
        "pwm_1 pwm_2 pwm_3 pwm_4 pwm_5 pwm_6 "  # s
        "digital_1 digital_2 digital_3 digital_4 digital_5"
    ).split()
)
"""Unit and axes as commented; `pwm_1` and all after it hold between grid points."""

AT = {name: i for i, name in enumerate(SIGNALS)}


Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]
Positive = Annotated[float, Field(gt=0.0)]
Sigma = Annotated[float, Field(ge=0.0)]

_ZERO: Vector = (0.0, 0.0, 0.0)
_IDENTITY: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
COUNTS_PER_NEWTON = 40_000.0
REFERENCE_TEMPERATURE = 298.15  # K, at which biases are as stated
NAU7802_GAIN = 128.0


class TriadModel(SimulatorTable):
    """Three axes: reading = matrix true + bias + bias_per_kelvin (T - 298.15 K) + noise, in body axes."""

    matrix: Matrix = Field(default=_IDENTITY, description="scale factors and misalignment (magnetometer: soft iron)")
    bias: Vector = Field(default=_ZERO, description="zero offset (magnetometer: hard iron)")
    bias_per_kelvin: Vector = _ZERO
    turn_on: Sigma = Field(default=0.0, description="standard deviation of a further bias, new at every power-up")
    noise: Vector = Field(default=_ZERO, description="standard deviation of a sample")


class ImuModel(SimulatorTable):
    """[sensors.imu]: ICM-20948. body_from_chip: matrix that turns printed chip axes into body axes (chip face down); left out,
    the chip sits as the logger's configuration has it mounted."""

    position: Vector = _ZERO
    body_from_chip: Matrix | None = None
    accel: TriadModel = TriadModel(noise=(0.05, 0.05, 0.08), turn_on=0.02)
    gyro: TriadModel = TriadModel(noise=(0.007, 0.007, 0.005), turn_on=0.001)
    die_above_air_k: float = Field(default=8.0, description="self-heating of the board [K]")


class MagModel(SimulatorTable):
    """[sensors.mag]: AK09916 inside the ICM-20948."""

    field: TriadModel = TriadModel(noise=(0.4e-6, 0.4e-6, 0.4e-6))


class VaneModel(SimulatorTable):
    """[sensors.alpha_vane], [sensors.beta_vane]: a balanced vane on a potentiometer or Hall sensor.

    The vane follows the local flow as a second-order system; its delay at low frequency is damping / (pi frequency_hz).
    """

    position: Vector
    wash_factor: Positive = Field(
        default=1.0, description="local angle = wash_factor x free-stream angle + wash_offset"
    )
    wash_offset: float = Field(default=0.0, description="[rad]")
    frequency_hz: Positive = 20.0
    damping: Positive = 0.5
    stop_rad: Positive = Field(default=1.2, description="mechanical stops at plus and minus this angle")
    centre_v: float = 2.5
    volts_per_rad: float = 1.25
    noise_rad: Sigma = 0.0044
    cubic_v_per_rad3: float = Field(default=0.0, description="curvature of the transfer [V/rad3]")


class PotentiometerModel(SimulatorTable):
    """[sensors.elevon_left], [sensors.elevon_right], [sensors.rudder_pot]."""

    centre_v: float = 2.5
    volts_per_rad: float = 1.6
    noise_rad: Sigma = 0.0012
    cubic_v_per_rad3: float = 0.0


class SupplyModel(SimulatorTable):
    """[sensors.supply]: the 5 V sensor supply, to which vanes and potentiometers are ratiometric, and the dividers."""

    sensor_v: float = 5.0
    sensor_v_per_main_v: float = Field(default=0.0, description="line regulation against 12 V")
    ripple_v: Sigma = 0.0005
    main_divider: Positive = 5.0
    sensor_divider: Positive = 2.0


class PitotModel(SimulatorTable):
    """[sensors.pitot]: MS4525DO, +-1 psi. factor multiplies the impact pressure (position error of the total port)."""

    factor: Positive = 1.0
    offset_pa: float = 0.0
    offset_pa_per_v: float = Field(
        default=0.0, description="zero shift with the sensor supply away from 5 V; 65 is usual"
    )
    noise_pa: Sigma = 2.6
    lag_s: Sigma = Field(default=0.0, description="first-order lag of the tubing")
    die_above_air_k: float = 3.0


class StaticModel(SimulatorTable):
    """[sensors.static]: BMP390. position_error: (measured - true static pressure) / dynamic pressure."""

    position_error: float = 0.0
    offset_pa: float = 0.0
    noise_pa: Sigma = 1.5
    noise_k: Sigma = 0.02
    die_above_air_k: float = 0.0


class ThrustModel(SimulatorTable):
    """[sensors.thrust]: load cell behind a NAU7802 at gain 128."""

    counts_per_newton: float = COUNTS_PER_NEWTON
    zero_n: float = 0.0
    noise_n: Sigma = 0.05


class CaptureModel(SimulatorTable):
    """[sensors.capture]: the pulse-measuring co-processor."""

    jitter_us: Sigma = 0.1


class GnssModel(SimulatorTable):
    """[sensors.gnss]: u-blox receiver."""

    position: Vector = (0.10, 0.0, -0.03)
    configured: bool = Field(default=False, description="NAV-PVT at rate_hz is saved in it; else it waits to be told")
    pulse: bool = Field(default=False, description="its pulse-per-second line is wired")
    rate_hz: Annotated[float, Field(gt=0.0, le=20.0)] = 10.0
    latency_ms: Annotated[float, Field(ge=0.0, le=500.0)] = 50.0
    first_fix_s: Sigma = 0.0
    horizontal_m: Sigma = Field(default=0.8, description="slow position error, one sigma")
    vertical_m: Sigma = 1.5
    drift_time_s: Positive = Field(default=60.0, description="correlation time of the slow error")
    velocity_m_s: Sigma = 0.05
    time_accuracy_s: Positive = 30e-9
    clock_drift_ppm: float = Field(
        default=4.0, description="how much slower the logger's oscillator runs than GPS time"
    )


class SensorModels(SimulatorTable):
    """The whole table `[sensors]`, with `[sensors.bus]` and `[sensors.delays]`."""

    unit: Annotated[int, Field(ge=0)] = 0
    imu: ImuModel = ImuModel()
    mag: MagModel = MagModel()
    alpha_vane: VaneModel = VaneModel(position=(-0.16, -0.75, 0.0), noise_rad=0.0052)
    beta_vane: VaneModel = VaneModel(position=(-0.16, 0.75, 0.0))
    elevon_left: PotentiometerModel = PotentiometerModel()
    elevon_right: PotentiometerModel = PotentiometerModel()
    rudder: PotentiometerModel = PotentiometerModel()
    supply: SupplyModel = SupplyModel()
    analog_v: tuple[float, float, float, float, float] = (0.5, 1.0, 1.5, 2.0, 2.5)
    analog_noise_v: Sigma = 0.0003
    pitot: PitotModel = PitotModel()
    static: StaticModel = StaticModel()
    thrust: ThrustModel = ThrustModel()
    capture: CaptureModel = CaptureModel()
    gnss: GnssModel = GnssModel()
    bus: BusModel = BusModel()
    delays: Mapping[str, Annotated[float, Field(ge=0.0, le=2.0)]] = Field(
        default_factory=dict, description="transport delay of single signals, to the nearest 5 ms [s]"
    )

    @field_validator("delays")
    @classmethod
    def _known_signals(cls, delays: Mapping[str, float]) -> Mapping[str, float]:
        for name in delays:
            if name not in SIGNALS:
                raise ValueError(f"no signal named {name!r}; known are {', '.join(SIGNALS)}")
        return delays

    def altered(self, **tables: Any) -> "SensorModels":
        """A copy with some keys of some tables replaced, e.g. altered(imu={"position": (0.1, 0, 0)}); checked."""
        return SensorModels.model_validate(merged(self.model_dump(), tables))


def parse_sensors(table: Mapping[str, Any], where: str) -> SensorModels:
    """The `[sensors]` table of a scenario; raises ScenarioError naming the key.

    A table given in part keeps the defaults of its instrument for the rest.
    """
    return checked(SensorModels, merged(SensorModels().model_dump(), table), where, "sensors")
