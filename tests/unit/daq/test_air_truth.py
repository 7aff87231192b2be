"""Sensors that contradict each other at rest and in flight, from made-up counts of a known motion."""

import math
import random
from collections.abc import Iterator

import pytest

from daq.acquisition.air_truth import AirTruth, Scales, level, mounting_for, pitot_at_rest
from daq.contract.scan import GroupStatus, Scan, SensorState
from daq.sensors.config import SensorsConfig
from daq.sensors.icm20948 import ImuConfig
from daq.sensors.mounting import Axis
from daq.sensors.ms4525do import PitotConfig
from daq.sensors.standstill import motion_evidence, pitot_motion_evidence

PASCAL = 1.0520
G_COUNTS = 4096
CONFIG = SensorsConfig(imu=ImuConfig(), pitot=PitotConfig())


def scans(
    seconds: float,
    *,
    pascal: float = 0.0,
    noise_pa: float = 2.6,
    force: tuple[float, float, float] = (0.0, 0.0, -1.0),
    speed: float = 0.0,
    rate_noise: float = 0.002,
    vane_counts: float = 400.0,
    seed: int = 3,
    start: int = 0,
) -> Iterator[Scan]:
    """20 scans a second of an aircraft with this pressure [Pa], specific force [g] and ground speed [m/s]."""
    random_ = random.Random(seed)
    groups = {g: GroupStatus(SensorState.OK) for g in ("imu", "pitot", "gnss", "analog_a")}
    for n in range(start, start + round(20 * seconds)):
        values = {
            "pitot_pressure": round(8191.5 + (pascal + random_.gauss(0, noise_pa)) / PASCAL),
            **{f"accel_{a}": round(f * G_COUNTS + random_.gauss(0, 8)) for a, f in zip("xyz", force, strict=True)},
            **{f"gyro_{a}": round(random_.gauss(0, rate_noise) / (math.radians(1) / 65.5)) for a in "xyz"},
            "alpha_vane": round(9000 + vane_counts * math.sin(n / 7)),
            "beta_vane": round(9100 + vane_counts * math.sin(n / 9)),
        }
        if n % 2 == 0:
            values |= {"gnss_fix": 3, "velocity_north_mm": round(speed * 1000), "velocity_east_mm": 0}
        yield Scan(n, n * 50_000_000, 0, 0, 0, groups, values)


def said(truth: AirTruth, flight: Iterator[Scan]) -> list[str]:
    return [c.text for scan in flight for c in truth.check(scan)]


@pytest.mark.parametrize("offset", [-140.0, 37.0, 118.0])
def test_offset_at_rest_is_measured_and_zeroed_whatever_its_level(offset: float) -> None:
    still = list(scans(6, pascal=offset))
    assert motion_evidence(still) is None
    assert pitot_motion_evidence([s.values["pitot_pressure"] for s in still], check_level=False) is None
    rest = pitot_at_rest(still, Scales(CONFIG))
    assert rest is not None
    assert rest.offset_pa == pytest.approx(offset, abs=1.5)
    truth = AirTruth(CONFIG)
    zeros = [z for s in still if not truth.check(s) and (z := truth.zero()) is not None]
    assert len(zeros) == 1, "once"
    assert zeros[0].count == pytest.approx(8191.5 + offset / PASCAL, abs=1.5)


def test_a_zero_that_no_longer_holds_before_motion_is_told_once() -> None:
    truth = AirTruth(CONFIG)
    for scan in scans(6, pascal=37.0):
        truth.check(scan)
        truth.zero()
    assert said(truth, scans(8, pascal=40.0, start=120)) == []
    (sentence,) = said(truth, scans(8, pascal=62.0, start=280))
    assert sentence.endswith("Pa since it was zeroed (limit 10): zero it again")
    assert "rests at +1" in sentence or "rests at +2" in sentence
    assert said(truth, scans(8, pascal=62.0, noise_pa=30.0, start=440)) == []  # wind


@pytest.mark.parametrize(
    "kind",
    [
        {"pascal": 4.0},  # within the bound
        {"pascal": 18.0, "noise_pa": 9.0},  # wind
        {"pascal": 900.0},  # no zero but a fault
        {"pascal": 60.0, "rate_noise": 0.05},  # moved by hand
        {"pascal": 60.0, "speed": 5.0},
    ],
)
def test_what_is_no_offset_is_not_zeroed(kind: dict[str, float]) -> None:
    truth = AirTruth(CONFIG)
    assert not [1 for s in scans(8, **kind) if truth.check(s) or truth.zero()]  # type: ignore[arg-type]


def test_nothing_is_zeroed_once_it_has_flown_or_by_configuration() -> None:
    truth = AirTruth(CONFIG)
    said(truth, scans(8, pascal=200.0, speed=18.0))
    assert not [1 for s in scans(8, pascal=60.0, start=160) if truth.check(s) or truth.zero()]
    off = AirTruth(CONFIG, auto_zero=False)
    assert not [1 for s in scans(8, pascal=60.0) if off.check(s) or off.zero()]


@pytest.mark.parametrize(
    ("flight", "words"),
    [
        ({"pascal": -190.0}, "pitot pressure is negative in flight: -190 Pa at GPS 18 m/s (limit -20): tubes swapped?"),
        ({"pascal": 1.0}, "covered or blocked?"),
        ({"pascal": 1400.0}, "blocked with pressure in it?"),
        ({"pascal": 195.0, "vane_counts": 1.0}, "sideslip vane is frozen: moves by"),
        ({"pascal": 195.0, "force": (0.0, 0.0, 1.0)}, "IMU is turned: mean specific force on body z is +9.8 m/s2"),
        ({"pascal": 195.0, "force": (0.0, -1.0, 0.0)}, "IMU is turned"),
    ],
)
def test_each_contradiction_is_said_once_within_ten_seconds_of_motion(flight: dict[str, object], words: str) -> None:
    truth = AirTruth(CONFIG)
    assert said(truth, scans(6)) == []
    heard = said(truth, scans(10, speed=18.0, start=120, **flight))  # type: ignore[arg-type]
    assert sum(words in h for h in heard) == 1, heard


@pytest.mark.parametrize(
    ("push", "words"),
    [
        ((0.35, 0.0), None),
        ((0.35, 0.12), None),  # banked
        ((0.02, 0.02), None),  # too little to tell a direction
        ((-0.35, 0.0), "['-x', '-y', '+z']"),
        ((0.0, 0.35), "['+y', '-x', '+z']"),
        ((0.0, -0.35), "['-y', '+x', '+z']"),
    ],
)
def test_a_launch_that_does_not_push_along_body_x_names_the_mounting(
    push: tuple[float, float], words: str | None
) -> None:
    truth = AirTruth(CONFIG)
    assert said(truth, scans(6, force=(0.15, 0.0, -0.99))) == []  # a tail dragger at rest
    launch = [
        s for k in range(5) for s in scans(1, speed=3.4 * k, start=120 + 20 * k, force=(0.15 + push[0], push[1], -0.99))
    ]
    heard = [h for h in said(truth, launch) if "about z" in h]
    assert ([h[-len(words) :] for h in heard] == [words]) if words else not heard


def test_a_turn_out_of_the_wind_is_no_launch() -> None:
    truth = AirTruth(CONFIG)
    said(truth, scans(6, force=(0.17, 0.0, -0.98)))  # a tail dragger: in the air x reads less than at rest
    said(truth, scans(8, speed=12.0, start=120, pascal=120.0))
    turn = [
        s
        for k in range(6)
        for s in scans(1, speed=5.0 + 3.0 * k, start=280 + 20 * k, pascal=120.0, force=(0.0, 0.0, -1.2))
    ]
    assert not [h for h in said(truth, turn) if "about z" in h]


def test_a_healthy_flight_with_wind_is_not_accused() -> None:
    truth = AirTruth(CONFIG)
    for speed, wind in ((18.0, 7.0), (18.0, -7.0), (25.0, 0.0)):
        pressure = 0.6125 * (speed + wind) ** 2
        assert said(truth, scans(20, speed=speed, pascal=pressure, force=(0.05, 0.0, -1.15))) == []
        truth = AirTruth(CONFIG)


@pytest.mark.parametrize(
    ("mounting", "force", "right"),
    [
        (("+x", "+y", "+z"), (0.0, 0.0, 1.0), ("+x", "-y", "-z")),
        (("+x", "+y", "+z"), (0.0, -1.0, 0.0), ("+x", "-z", "+y")),
        (("+y", "-x", "+z"), (0.0, 0.0, 1.0), ("+y", "+x", "-z")),
    ],
)
def test_mounting_that_is_named_makes_gravity_lie_along_body_z(
    mounting: tuple[Axis, Axis, Axis], force: tuple[float, float, float], right: tuple[Axis, Axis, Axis]
) -> None:
    assert mounting_for(force, mounting) == right
    chip = dict.fromkeys("xyz", 0.0)
    for axis, f in zip(mounting, force, strict=True):
        chip[axis[1]] = f if axis[0] == "+" else -f
    assert chip[right[2][1]] * (1 if right[2][0] == "+" else -1) == -1.0


def test_level_names_what_it_sees() -> None:
    scales = Scales(CONFIG)
    assert (level(list(scans(3)), scales) or (False,))[0]
    turned = level(list(scans(3, force=(0.0, 0.0, 1.0))), scales)
    assert turned is not None
    assert not turned[0]
    assert "z +9.8 m/s2" in turned[1]
    assert "['+x', '-y', '-z']" in turned[1]
    wrong_range = level(list(scans(3, force=(0.0, 0.0, -2.0))), scales)
    assert wrong_range is not None
    assert "check accel_range_g" in wrong_range[1]
