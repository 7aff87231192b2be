"""The quality of a test point: what was flown is measured, and what spoils it is named, each by a flight that has just that."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from daq.identification.airframe import Sample
from daq.identification.point_quality import FlownPoint, PointMeter

DEG = math.pi / 180.0
Bend = Callable[[float, dict[str, float]], None]


def flown(
    bend: Bend = lambda t, s: None, rate: float = 20.0, seconds: float = 14.0, begin: float = 5.0
) -> list[FlownPoint]:
    """Each state of the meter over a flight with an aileron doublet of 6 deg a second long at 5 s. bend: changes a sample."""
    meter, rng, points = PointMeter(("delta_a", "delta_r"), {"delta_a": (-0.3, 0.3)}), np.random.default_rng(3), []
    for k in range(round(seconds * rate)):
        t = k / rate
        s = dict(
            zip(Sample._fields, [t, *rng.normal(0.0, 0.15 * DEG, 12), 0, 0, 0, 0, math.nan, math.nan], strict=True)
        )
        s |= {"V": 16.0 + 0.1 * rng.standard_normal(), "rho": 1.2, "alpha": s["alpha"] + 0.08}
        s["delta_a"] += 0.02 + 6.0 * DEG * ((begin <= t < begin + 0.5) - 1.0 * (begin + 0.5 <= t < begin + 1.0))
        bend(t, s)
        meter.add(Sample(**s))
        if meter.point is not None:
            points.append(meter.point)
    return points


@pytest.mark.parametrize("rate", [12.0, 20.0, 100.0])
def test_a_clean_point_is_measured_and_is_over_some_seconds_after_its_input(rate: float) -> None:
    points = flown(rate=rate)
    first, last = points[0], points[-1]
    assert first.moving
    assert first.begin == pytest.approx(5.0, abs=0.1)
    assert not last.moving
    assert last.faults == ()
    assert last.seconds == pytest.approx(2.0, abs=0.25)  # a movement counts for the second that it is looked at
    assert last.peaks["delta_a"] == pytest.approx(6.0 * DEG, abs=0.6 * DEG)
    assert last.peaks["delta_r"] < 0.8 * DEG
    assert last.speed == pytest.approx(16.0, abs=0.1)
    assert max(last.gusts.values()) < 0.3 * DEG
    assert {p.begin for p in points} == {first.begin}


def shift(**changes: float) -> Bend:
    return lambda t, s: s.update({n: s[n] + v for n, v in changes.items()})


def slow(t: float, s: dict[str, float]) -> None:
    s["V"] += 1.2 * t


def gusty(t: float, s: dict[str, float]) -> None:
    s["beta"] += 2.0 * DEG * math.sin(3.0 * t)


def swinging(t: float, s: dict[str, float]) -> None:
    """A Dutch roll in still air: the nose swings about a path that stays straight."""
    s["beta"] += 2.0 * DEG * math.sin(3.0 * t)
    s["r"] -= 6.0 * DEG * math.cos(3.0 * t)


def both(t: float, s: dict[str, float]) -> None:
    s["delta_r"] -= 0.6 * (s["delta_a"] - 0.02)


def at_its_stop(t: float, s: dict[str, float]) -> None:
    s["delta_a"] += 0.3 if 5.0 <= t < 5.5 else 0.0


def rolled(t: float, s: dict[str, float]) -> None:
    s["phi"] += 60.0 * DEG * math.exp(-((t - 6.0) ** 2))


@pytest.mark.parametrize(
    ("bend", "words"),
    [
        (shift(phi=20.0 * DEG), "bank 20 deg before it"),
        (shift(r=9.0 * DEG), "turning at 9 deg/s before it"),
        (slow, "airspeed changed by"),
        (gusty, "gusts of "),
        (swinging, "sideslip unsteady by 1.4 deg before it (0."),
        (both, "aileron and rudder moved together (-1.00)"),
        (at_its_stop, "aileron at its stop for 0.5 s"),
        (rolled, "bank 60 deg from trim"),
    ],
)
def test_what_spoils_a_point_is_named(bend: Bend, words: str) -> None:
    faults = flown(bend)[-1].faults
    assert any(words in f for f in faults), faults
    assert len(faults) == 1


def test_of_an_angle_whose_accelerometers_are_not_there_nobody_says_whether_it_is_gusts() -> None:
    def unknown(t: float, s: dict[str, float]) -> None:
        s |= {"az": math.nan}
        s["alpha"] += 2.0 * DEG * math.sin(3.0 * t)

    last = flown(unknown)[-1]
    assert "alpha" not in last.gusts
    assert "angle of attack unsteady by 1.4 deg before it (its own motion or gusts)" in last.faults[0]


def test_an_input_at_once_has_no_steady_seconds_before_it() -> None:
    assert "hold still for two" in flown(begin=0.1)[-1].faults[0]


def test_another_input_is_another_point() -> None:
    def again(t: float, s: dict[str, float]) -> None:
        s["delta_r"] += 3.0 * DEG * (11.0 <= t < 12.0)

    last = flown(again, seconds=18.0)[-1]
    assert last.begin == pytest.approx(11.0, abs=0.1)
    assert last.peaks["delta_r"] > 2.0 * DEG > last.peaks["delta_a"]
