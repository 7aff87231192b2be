"""Standard messages: what they show agrees with independent numbers, and what cannot be known is not sent."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from daq.contract.scan import GroupStatus, Scan, SensorState
from daq.telemetry.config import DisplayConfig, DownlinkConfig
from daq.telemetry.display import WindMean, calibrated_airspeed, standard_density
from daq.telemetry.standard_messages import StandardMessages, autopilot_version, heartbeat, sys_status
from daq.transport.mavlink_codec import message_types
from daq.utilities.constants import SEA_LEVEL_PRESSURE, SEA_LEVEL_TEMPERATURE
from firmware_sim.hardware.registers.bmp390 import calibration_bytes
from groundstation.calibration import conversions
from tests.support.link_rig import random_scan

DISPLAY = DisplayConfig(
    pitot_zero_count=8191.5,
    pitot_pa_per_count=1.0521206283,
    alpha_zero_count=20000,
    alpha_rad_per_count=1e-4,
    beta_zero_count=20000,
    beta_rad_per_count=1e-4,
    sensor_supply_count=20000,
)
CONFIG = DownlinkConfig(display=DISPLAY, supply_volts_per_count=0.000625)
GROUPS = ("imu", "attitude", "analog_a", "analog_b", "pitot", "static", "capture", "gnss")
LEVEL_NORTH = {"quaternion_w": 32767, "quaternion_x": 0, "quaternion_y": 0, "quaternion_z": 0}
FIX = {
    "gnss_fix": 3,
    "gnss_satellites": 11,
    "latitude_e7": 473977420,
    "longitude_e7": 85455940,
    "height_msl_mm": 488_000,
    "velocity_north_mm": 15_000,
    "velocity_east_mm": -2000,
    "velocity_down_mm": -500,
}


def scan(time_s: float = 10.0, **values: float) -> Scan:
    """A scan of healthy sensors, level and heading north."""
    groups = {g: GroupStatus(SensorState.OK, 300) for g in GROUPS}
    time_ns = round(time_s * 1e9)
    return Scan(round(time_s * 20), time_ns, 0, 0, 0, groups, {**LEVEL_NORTH, "sensor_supply": 20000, **values})


def faulty(one: Scan, group: str) -> Scan:
    """The same with a sensor that does not vouch for what it says."""
    return replace(one, groups={**one.groups, group: GroupStatus(SensorState.FAULT, 300)})


def messages(config: DownlinkConfig = CONFIG, nvm: str = "") -> StandardMessages:
    return StandardMessages(config, lambda: True, lambda: {"static.nvm": nvm} if nvm else {})


def fields(made: Any) -> dict[str, Any]:
    assert made is not None
    return message_types()[made.msg_id].unpack(made.payload)


def shown(about: StandardMessages, name: str, *scans: Scan) -> dict[str, Any] | None:
    for one in scans:
        about.offer(one)
    made = about.make(name)
    return None if made is None else fields(made)


@pytest.mark.parametrize("speed", [0.0, 5.0, 15.0, 40.0, 200.0])
def test_airspeed_is_that_of_the_ground_s_calibration(speed: float) -> None:
    pressure = conversions.impact_pressure(speed, SEA_LEVEL_PRESSURE, SEA_LEVEL_TEMPERATURE)
    assert calibrated_airspeed(pressure) == pytest.approx(speed, abs=1e-6)
    assert calibrated_airspeed(-pressure) == 0.0


def test_density_is_that_of_the_standard_atmosphere() -> None:
    # ICAO Doc 7488/3, geopotential heights
    assert standard_density(0) == pytest.approx(1.225, abs=1e-4)
    assert standard_density(1000) == pytest.approx(1.1116, abs=1e-4)
    assert standard_density(5000) == pytest.approx(0.73612, abs=1e-4)


def test_vfr_hud_has_airspeed_ground_speed_height_heading_throttle_and_climb() -> None:
    count = round(8191.5 + 0.5 * 1.225 * 15**2 / 1.0521206283)
    hud = shown(messages(), "VFR_HUD", scan(**FIX, pitot_pressure=count, pwm_4=16_000))
    assert hud is not None
    assert hud["airspeed"] == pytest.approx(15.0, abs=0.05)
    assert hud["groundspeed"] == pytest.approx(math.hypot(15, 2), abs=1e-4)
    assert (hud["alt"], hud["climb"]) == (pytest.approx(488.0), pytest.approx(0.5))
    assert (hud["heading"], hud["throttle"]) == (0, 60)


def test_without_a_fix_ground_speed_and_height_are_not_numbers() -> None:
    hud = shown(messages(), "VFR_HUD", scan(9.0, **FIX), scan(20.0, pitot_pressure=8300))
    assert hud is not None
    assert math.isnan(hud["groundspeed"])
    assert math.isnan(hud["alt"])
    assert math.isnan(hud["climb"])
    assert hud["airspeed"] > 0


def test_angles_follow_the_vanes_whatever_their_supply_is() -> None:
    five_degrees = 20000 + math.radians(5) / 1e-4
    for supply in (1.0, 0.97):
        values = {"alpha_vane": five_degrees * supply, "beta_vane": 20000 * supply, "sensor_supply": 20000 * supply}
        flow = shown(messages(), "AOA_SSA", scan(**values))
        assert flow is not None
        assert (flow["AOA"], flow["SSA"]) == (pytest.approx(5.0, abs=1e-4), pytest.approx(0.0, abs=1e-4))


EVERYTHING = {
    **FIX,
    "pitot_pressure": 8300,
    "alpha_vane": 20500,
    "beta_vane": 20100,
    "supply": 18400,
    "pwm_4": 16000,
    "pwm_1": 15000,
    "static_pressure": 6_400_000,
    "static_temperature": 8_400_000,
}


@pytest.mark.parametrize(
    ("name", "bad"),
    [
        ("VFR_HUD", "pitot"),
        ("AOA_SSA", "analog_a"),
        ("AOA_SSA", "analog_b"),
        ("BATTERY_STATUS", "analog_b"),
        ("SERVO_OUTPUT_RAW", "capture"),
        ("SCALED_PRESSURE", "static"),
    ],
)
def test_what_a_sensor_does_not_vouch_for_is_not_sent(name: str, bad: str) -> None:
    nvm = calibration_bytes().hex()
    assert shown(messages(nvm=nvm), name, scan(**EVERYTHING)) is not None
    assert shown(messages(nvm=nvm), name, faulty(scan(**EVERYTHING), bad)) is None


@pytest.mark.parametrize("name", ["VFR_HUD", "AOA_SSA", "BATTERY_STATUS", "SCALED_PRESSURE", "WIND_COV"])
def test_what_the_configuration_has_no_numbers_for_is_not_sent(name: str) -> None:
    about = messages(DownlinkConfig())
    for i in range(300):
        about.offer(scan(i * 0.1, **EVERYTHING))
    assert about.make(name) is None
    assert about.make("GLOBAL_POSITION_INT") is not None


def test_nothing_is_sent_before_the_first_scan() -> None:
    about = messages()
    assert all(about.make(name) is None for name in about.names)


def test_height_is_above_the_first_fix_which_is_home() -> None:
    about = messages()
    low, high = scan(5.0, **FIX), scan(60.0, **{**FIX, "height_msl_mm": 520_000, "latitude_e7": 473990000})
    assert about.make("HOME_POSITION") is None
    bad = scan(4.5, **{**FIX, "height_msl_mm": 3_000_000})
    again = [scan(5.0 + 0.1 * n, **FIX) for n in range(5)]
    here = shown(about, "GLOBAL_POSITION_INT", scan(4.0, gnss_fix=0), bad, low, *again, high)
    assert here is not None
    assert (here["alt"], here["relative_alt"], here["lat"]) == (520_000, 32_000, 473990000)
    assert (here["vx"], here["vy"], here["vz"], here["hdg"]) == (1500, -200, -50, 0)
    home = fields(about.make("HOME_POSITION"))
    assert (home["latitude"], home["altitude"]) == (473977420, 488_000)


def test_an_old_fix_is_no_position() -> None:
    assert shown(messages(), "GLOBAL_POSITION_INT", scan(5.0, **FIX), scan(8.5)) is None


def test_pressure_is_that_of_the_ground_s_calibration() -> None:
    nvm = calibration_bytes()
    found = shown(messages(nvm=nvm.hex()), "SCALED_PRESSURE", scan(**EVERYTHING))
    pressure, temperature = conversions.Bmp390Compensation.from_nvm(nvm).compensate(6_400_000.0, 8_400_000.0)
    assert found is not None
    assert found["press_abs"] == pytest.approx(pressure / 100, rel=1e-6)
    assert found["temperature"] == round((temperature - 273.15) * 100)
    assert found["press_diff"] == pytest.approx((8300 - 8191.5) * 1.0521206283 / 100, rel=1e-5)


def test_the_battery_is_its_voltage_and_nothing_else() -> None:
    about = messages()
    battery = shown(about, "BATTERY_STATUS", scan(supply=18400))
    assert battery is not None
    assert battery["voltages"] == (11_500, *(65535,) * 9)
    assert (battery["current_battery"], battery["battery_remaining"], battery["temperature"]) == (-1, -1, 32767)
    status = shown(about, "SYS_STATUS")
    assert status is not None
    assert status["voltage_battery"] == 11_500


def test_servo_outputs_are_pulse_widths_in_microseconds() -> None:
    servos = shown(messages(), "SERVO_OUTPUT_RAW", scan(pwm_1=15_000, pwm_4=11_234))
    assert servos is not None
    assert [servos[f"servo{i}_raw"] for i in range(1, 9)] == [1500, 0, 0, 1123, 0, 0, 0, 0]


def test_status_tells_a_filter_without_an_ekf_and_blames_only_what_is_there() -> None:
    groups = {"imu": GroupStatus(SensorState.FAULT, 0), "attitude": GroupStatus(SensorState.OK, 0)}
    groups["gnss"] = GroupStatus(SensorState.OFF, 0)
    found = fields(sys_status(Scan(0, 0, 0, 0, 0, groups, {}), True, None))
    present, health = found["onboard_control_sensors_present"], found["onboard_control_sensors_health"]
    assert present == 3 | 1 << 21 | 1 << 24
    assert health == 2**32 - 1 - 3
    assert health >> 20 & 1, "MAVProxy says 'fence breach' where the geofence is not healthy, fitted or not"


def test_the_heartbeat_is_an_aeroplane_without_an_autopilot() -> None:
    found = fields(heartbeat(True))
    assert (found["type"], found["autopilot"], found["base_mode"]) == (1, 8, 0)


def _blown(wind: tuple[float, float, float], psi: float) -> dict[str, float]:
    """Raw values of an aircraft that flies level at 20 m/s calibrated through a wind, heading psi, without sideslip."""
    density = standard_density(500.0)
    true = 20.0 * math.sqrt(1.225 / density)
    alpha = math.radians(3)
    body = (true * math.cos(alpha), 0.0, true * math.sin(alpha))
    pitch = alpha  # level flight: the path is horizontal
    forward = body[0] * math.cos(pitch) + body[2] * math.sin(pitch)
    down = -body[0] * math.sin(pitch) + body[2] * math.cos(pitch)
    north, east = forward * math.cos(psi), forward * math.sin(psi)
    q = 101325 * ((1 + 0.2 * (20.0 / 340.294) ** 2) ** 3.5 - 1)
    half_pitch, half_yaw = pitch / 2, psi / 2
    turn = (
        math.cos(half_pitch) * math.cos(half_yaw),
        -math.sin(half_pitch) * math.sin(half_yaw),
        math.sin(half_pitch) * math.cos(half_yaw),
        math.cos(half_pitch) * math.sin(half_yaw),
    )
    quaternion = {f"quaternion_{n}": round(32767 * c) for n, c in zip("wxyz", turn, strict=True)}
    velocity = (north + wind[0], east + wind[1], down + wind[2])
    names = ("velocity_north_mm", "velocity_east_mm", "velocity_down_mm")
    return {
        **quaternion,
        "gnss_fix": 3,
        "height_msl_mm": 500_000,
        "pitot_pressure": 8191.5 + q / 1.0521206283,
        "alpha_vane": 20000 + alpha / 1e-4,
        "beta_vane": 20000,
        **{n: round(v * 1000) for n, v in zip(names, velocity, strict=True)},
    }


def test_wind_is_ground_velocity_less_air_velocity_in_every_heading() -> None:
    about, wind = messages(), (-3.0, 4.0, 0.5)
    for i in range(400):
        about.offer(scan(i * 0.1, **_blown(wind, i * 0.02)))
    told = shown(about, "WIND_COV")
    assert told is not None
    assert (told["wind_x"], told["wind_y"], told["wind_z"]) == pytest.approx(wind, abs=0.02)
    assert max(told["var_horiz"], told["var_vert"]) < 0.02
    assert told["wind_alt"] == pytest.approx(500.0)


def test_no_wind_is_told_on_the_ground_or_too_early_or_long_after() -> None:
    parked, fresh, old = messages(), messages(), messages()
    flying: Callable[[float], Scan] = lambda t: scan(t, **_blown((1.0, 0.0, 0.0), 0.0))  # noqa: E731
    for i in range(400):
        parked.offer(scan(i * 0.1, **{**_blown((1.0, 0.0, 0.0), 0.0), "pitot_pressure": 8195}))
        old.offer(flying(i * 0.1))
    for i in range(100):
        fresh.offer(flying(i * 0.1))
    assert parked.make("WIND_COV") is None
    assert fresh.make("WIND_COV") is None
    assert old.make("WIND_COV") is not None
    old.offer(scan(70.0))
    assert old.make("WIND_COV") is None


def test_variability_is_the_spread_of_what_was_seen() -> None:
    mean = WindMean(time_s=20.0)
    for i in range(4000):
        mean.add(i * 0.1, (2.0 + (1 if i % 2 else -1), 5.0, 0.0))
    found = mean.estimate(400.0)
    assert found is not None
    assert found.mean == pytest.approx((2.0, 5.0, 0.0), abs=0.02)
    assert found.horizontal == pytest.approx(math.sqrt(1 / 2), rel=0.01)


def test_named_values_take_turns_and_are_bounded() -> None:
    about = messages()
    about.offer(scan())
    assert about.make("NAMED_VALUE_FLOAT") is None
    for i in range(100):
        about.set_named(f"n{i}", float(i))
    about.set_named("n1", -1.5)
    told = [fields(about.make("NAMED_VALUE_FLOAT")) for _ in range(66)]
    assert [t["name"] for t in told] == [*(f"n{i}" for i in range(64)), "n0", "n1"]
    assert told[1]["value"] == -1.5


def test_a_value_that_no_message_can_hold_is_not_a_number() -> None:
    about = messages()
    about.set_named("huge", 1e300)
    told = shown(about, "NAMED_VALUE_FLOAT", scan())
    assert told is not None
    assert math.isnan(told["value"])


@pytest.mark.parametrize("seed", range(5))
def test_whatever_sensors_and_chips_say_never_raises(seed: int) -> None:
    rng = np.random.default_rng(seed)
    steep = DisplayConfig(
        pitot_zero_count=-(2.0**31),
        pitot_pa_per_count=1e4,
        alpha_zero_count=2.0**32,
        alpha_rad_per_count=-1e4,
        beta_zero_count=0,
        beta_rad_per_count=1e4,
        sensor_supply_count=1e-9,
    )
    about = messages(
        DownlinkConfig(display=steep if seed % 2 else DISPLAY, supply_volts_per_count=1e4), rng.bytes(21).hex()
    )
    for i in range(200):
        about.offer(random_scan(i, rng, gnss=True))
        for name in about.names:
            about.make(name)


@pytest.mark.parametrize("nvm", ["", "zz", "00" * 21, "ff" * 21, "01" * 20])
def test_without_the_chip_s_coefficients_there_is_no_pressure(nvm: str) -> None:
    assert shown(messages(nvm=nvm), "SCALED_PRESSURE", scan(**EVERYTHING)) is None


@pytest.mark.parametrize(
    "bad", [{"pitot_pa_per_count": math.inf}, {"alpha_zero_count": math.nan}, {"sensor_supply_count": 0}]
)
def test_numbers_that_are_none_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(ValidationError):
        DisplayConfig(**bad)


def test_version_is_told_without_capabilities_that_we_have_not() -> None:
    found = fields(autopilot_version())
    assert found["capabilities"] == 8192 | 131072
    assert found["flight_sw_version"] & 255 == 255
