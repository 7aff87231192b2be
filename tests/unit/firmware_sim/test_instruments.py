"""Instruments against closed forms: lever arms, local flow at a vane, delays, pressures, individual units."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from firmware_sim.hardware.sensing.instruments import GRID_S, HISTORY_S, Instruments, _VaneDynamics
from firmware_sim.hardware.sensing.sensor_models import AT, SensorModels, parse_sensors
from firmware_sim.hardware.sensing.units import calibration_truth, individual
from firmware_sim.tables import ScenarioError
from tests.unit.firmware_sim.hardware import Still, truth_at_rest

NO_TURN_ON = {"imu": {"accel": {"turn_on": 0.0}, "gyro": {"turn_on": 0.0}}}


def shown(truth: SimpleNamespace, time_s: float = 0.5, **tables: object) -> dict[str, float]:
    """What the chips are shown of a steady truth."""
    models = SensorModels().altered(**NO_TURN_ON).altered(**tables)
    row = Instruments(Still(truth), models, 1).at(round(time_s * 1e9))
    return {name: float(row[i]) for name, i in AT.items()}


def test_standing_still() -> None:
    seen = shown(truth_at_rest())
    assert [seen[f"accel_{a}"] for a in "xyz"] == pytest.approx([0.0, 0.0, -9.80665])
    assert [seen[f"gyro_{a}"] for a in "xyz"] == [0.0, 0.0, 0.0]
    assert seen["pitot_pressure"] == 0.0
    assert seen["static_pressure"] == 101325.0
    assert seen["alpha_vane"] == pytest.approx(2.5)
    assert seen["elevon_left_pot"] == pytest.approx(2.5)


def test_lever_arm_in_a_steady_roll_and_in_roll_acceleration() -> None:
    """At radius y a roll rate p is felt as -p^2 y along y, a roll acceleration as p_dot y along z."""
    seen = shown(
        truth_at_rest(rates=(2.0, 0.0, 0.0), rate_derivatives=(3.0, 0.0, 0.0)), imu={"position": (0.0, 0.1, 0.0)}
    )
    assert seen["accel_y"] == pytest.approx(-4.0 * 0.1)
    assert seen["accel_z"] == pytest.approx(-9.80665 + 3.0 * 0.1)


def test_vane_at_the_wing_tip_in_a_roll() -> None:
    """Right wing going down at p meets the air from below: atan(w + p y, u), with y = -0.75 at the left tip."""
    speed, alpha, p = 17.0, 0.1, 1.0
    seen = shown(truth_at_rest(V=speed, alpha=alpha, rates=(p, 0.0, 0.0)))
    local = math.atan2(speed * math.sin(alpha) - 0.75 * p, speed * math.cos(alpha))
    assert seen["alpha_vane"] == pytest.approx(2.5 + 1.25 * local)


def test_beta_vane_reads_the_flank_angle_and_yaw() -> None:
    speed, alpha, beta, r = 15.0, 0.2, 0.1, 0.5
    seen = shown(truth_at_rest(V=speed, alpha=alpha, beta=beta, rates=(0.0, 0.0, r)))
    u = speed * math.cos(alpha) * math.cos(beta)
    local = math.atan2(speed * math.sin(beta) + r * -0.16, u - r * 0.75)
    assert seen["beta_vane"] == pytest.approx(2.5 + 1.25 * local)


def test_wash() -> None:
    seen = shown(truth_at_rest(V=15.0, alpha=0.1), alpha_vane={"wash_factor": 1.3, "wash_offset": 0.02})
    assert seen["alpha_vane"] == pytest.approx(2.5 + 1.25 * (1.3 * 0.1 + 0.02))


def test_impact_pressure() -> None:
    """Subsonic impact pressure, written out; at 20 m/s it is 0.09 % above rho V^2 / 2."""
    seen = shown(truth_at_rest(V=20.0))
    mach = 20.0 / math.sqrt(1.4 * 287.05287 * 288.15)
    exact = 101325.0 * ((1.0 + 0.2 * mach**2) ** 3.5 - 1.0)
    assert seen["pitot_pressure"] == pytest.approx(exact, rel=1e-9)
    assert exact == pytest.approx(0.5 * 1.225 * 400.0 * 1.00087, rel=1e-4)


def test_supply_moves_the_ratiometric_sensors_and_the_pitot_zero() -> None:
    seen = shown(truth_at_rest(alpha=0.1, V=15.0), supply={"sensor_v": 4.9}, pitot={"offset_pa_per_v": 65.0})
    assert seen["alpha_vane"] == pytest.approx(4.9 / 5.0 * (2.5 + 1.25 * 0.1))
    assert seen["sensor_supply"] == pytest.approx(2.45)
    still = shown(truth_at_rest(alpha=0.1, V=15.0))
    assert seen["pitot_pressure"] - still["pitot_pressure"] == pytest.approx(-6.5)


def test_static_position_error_is_seen_by_both_pressure_sensors() -> None:
    truth = truth_at_rest(V=20.0, p_dynamic=245.0)
    plain, seen = shown(truth), shown(truth, static={"position_error": 0.05})
    assert seen["static_pressure"] - plain["static_pressure"] == pytest.approx(12.25)
    assert seen["pitot_pressure"] - plain["pitot_pressure"] == pytest.approx(-12.25)


def test_vane_follows_a_slow_ramp_late_by_its_declared_delay() -> None:
    vane = _VaneDynamics(20.0, 0.5)
    rate = 0.1
    for k in range(400):
        out = vane.step(rate * k * GRID_S)
    declared = calibration_truth(SensorModels())["beta_vane"]["delay"]
    # Prewarping keeps the natural frequency, not the delay: 3.4 % at 20 Hz on a 200 Hz grid.
    assert 399 * GRID_S - out / rate == pytest.approx(declared, rel=0.05)


def test_signals_between_grid_points_are_straight_and_switches_hold() -> None:
    class Moving:
        def advance(self, to_time: float) -> SimpleNamespace:
            return truth_at_rest(q=to_time, digital=(float(to_time > 0.004), 0.0, 0.0, 0.0, 0.0))

    instruments = Instruments(Moving(), SensorModels().altered(**NO_TURN_ON), 1)
    assert instruments.at(7_000_000)[AT["gyro_y"]] == pytest.approx(0.007)
    assert instruments.at(4_900_000)[AT["digital_1"]] == 0.0
    assert instruments.at(5_100_000)[AT["digital_1"]] == 1.0


def test_a_delayed_signal_comes_late_and_alone() -> None:
    class Ramp:
        def advance(self, to_time: float) -> SimpleNamespace:
            return truth_at_rest(arm_r=to_time, arm_left=to_time)

    instruments = Instruments(Ramp(), SensorModels().altered(delays={"rudder_pot": 0.06}), 1)
    row = instruments.at(500_000_000)
    assert (row[AT["rudder_pot"]] - 2.5) / 1.6 == pytest.approx(0.5 - 0.06)
    assert (row[AT["elevon_left_pot"]] - 2.5) / 1.6 == pytest.approx(0.5)


def test_looking_back_is_limited() -> None:
    instruments = Instruments(Still(), SensorModels(), 1)
    instruments.at(20_000_000_000)
    instruments.at(round((20.0 - HISTORY_S + 0.1) * 1e9))
    with pytest.raises(ValueError, match="kept"):
        instruments.at(0)


def test_streams_do_not_depend_on_each_other() -> None:
    instruments = Instruments(Still(), SensorModels(), 3)
    first = instruments.generator("pitot").standard_normal(5)
    instruments.generator("thrust").standard_normal(100)
    assert np.array_equal(first, Instruments(Still(), SensorModels(), 3).generator("pitot").standard_normal(5))
    assert not np.array_equal(first, Instruments(Still(), SensorModels(), 4).generator("pitot").standard_normal(5))


def test_unit_zero_is_nominal_and_others_stay_what_they_are() -> None:
    nominal = SensorModels()
    assert individual(nominal) is nominal
    seven = individual(nominal.altered(unit=7))
    assert seven == individual(nominal.altered(unit=7))
    assert seven != individual(nominal.altered(unit=8))
    assert seven.beta_vane.volts_per_rad == pytest.approx(1.25, rel=0.15)


def test_calibration_truth_undoes_the_instruments() -> None:
    """What the chips are shown, put through the declared calibration, is the truth again."""
    models = SensorModels().altered(unit=11).altered(**NO_TURN_ON)
    truth = truth_at_rest(
        ax=1.0, ay=-2.0, az=-9.0, p=0.5, q=-0.3, r=0.2, rates=(0.5, -0.3, 0.2), arm_left=0.2, arm_r=-0.15, thrust=6.0
    )
    row = Instruments(Still(truth), models, 1).at(500_000_000)
    exact = calibration_truth(models)
    die = row[AT["imu_temperature"]]
    for name, first, wanted in (("accelerometer", "accel_x", (1.0, -2.0, -9.0)), ("gyro", "gyro_x", (0.5, -0.3, 0.2))):
        triad = exact[name]
        free = (
            row[AT[first] : AT[first] + 3]
            - triad["bias"]
            - triad["bias_per_kelvin"] * (die - triad["reference_temperature"])
        )
        assert triad["matrix"] @ free == pytest.approx(wanted)
    for name, signal, angle in (("elevon_left", "elevon_left_pot", 0.2), ("rudder", "rudder_pot", -0.15)):
        curve = exact[name]
        volts = curve["centre_v"] + curve["volts_per_rad"] * angle + curve["cubic_v_per_rad3"] * angle**3
        assert row[AT[signal]] == pytest.approx(volts)
    counts = row[AT["thrust_bridge"]] * 128 / 0.5 * 2**23
    assert (counts - exact["thrust"]["zero_count"]) * exact["thrust"]["newton_per_count"] == pytest.approx(6.0)


@pytest.mark.parametrize(
    ("table", "key"),
    [
        ({"imu": {"position": [0.1, 0.2]}}, "sensors.imu.position"),
        ({"beta_vane": {"wash_factor": -1.0}}, "sensors.beta_vane.wash_factor"),
        ({"barometer": {}}, "sensors.barometer"),
        ({"delays": {"beta": 0.06}}, "sensors.delays"),
    ],
)
def test_mistakes_in_the_table_are_named(table: dict[str, object], key: str) -> None:
    with pytest.raises(ScenarioError, match=key.replace(".", r"\.")):
        parse_sensors(table, "test")


def test_a_table_given_in_part_keeps_the_rest() -> None:
    models = parse_sensors({"beta_vane": {"wash_factor": 1.1}}, "test")
    assert models.beta_vane.position == (-0.16, 0.75, 0.0)
    assert models.beta_vane.wash_factor == 1.1
