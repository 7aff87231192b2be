"""Sensors that fail in mid-air: named with the times, on the columns alone; sound flights are not."""

from collections.abc import Callable

import numpy as np
import pytest

from groundstation.flight import Flight
from groundstation.flight.contradictions import Contradiction, contradictions, contradictions_of, no_airspeed
from groundstation.flight.stretches import airborne
from tests.unit.groundstation.turning import GRAVITY, Columns, turning_flight

Failure = Callable[[np.ndarray, np.random.Generator], np.ndarray]


def swaying_flight(seed: int) -> Columns:
    """The turning flight with a vane that swings as side force and yaw rate make it."""
    c = turning_flight(seed, seconds=60.0, sway=0.25)
    t, rng = c["time"], np.random.default_rng(seed)
    beta = 0.06 * np.sin(2 * np.pi * 0.45 * t) + 0.03 * np.sin(2 * np.pi * 0.31 * t + 1.0)
    sideways = np.gradient(21.0 * beta, t) + 21.0 * c["r"] - GRAVITY * np.sin(c["phi"]) * np.cos(c["theta"])
    return c | {"ay": sideways + 0.1 * rng.standard_normal(t.size), "beta": beta + 0.004 * rng.standard_normal(t.size)}


def holds(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return np.full(values.size, values[0])


def sticks(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A sensor that hears its own noise alone."""
    return values[0] + float(np.std(np.diff(values))) * 0.3 * rng.standard_normal(values.size)


def falls(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """To zero, and a little noise."""
    return 0.3 * float(np.std(np.diff(values))) * rng.standard_normal(values.size)


def failing(columns: Columns, names: str, failure: Failure, begin: float, end: float) -> list[Contradiction]:
    rng, time = np.random.default_rng(4), columns["time"]
    rows = (time >= begin) & (time <= end)
    for name in names.split():
        columns[name][rows] = failure(columns[name][rows], rng)
    return [c for c in contradictions_of(time, {n: v for n, v in columns.items() if n != "time"}) if c.spans]


@pytest.mark.parametrize("seed", range(12))
def test_nothing_fails_in_a_sound_flight(seed: int) -> None:
    assert failing(swaying_flight(seed), "", holds, 0.0, 0.0) == []
    assert failing(turning_flight(seed, hz=10.0, seconds=90.0, sway=0.1), "", holds, 0.0, 0.0) == []


def test_nothing_fails_across_the_gaps_between_manoeuvres() -> None:
    """What is cut out and joined, a second apart: heading jumps there, and no gyro shows it."""
    cut = []
    for k in range(12):
        made = turning_flight(k, hz=20.0, seconds=30.0 + 5.0 * k, sway=0.25)
        part = {n: v[-600:] for n, v in made.items()}
        cut.append(part | {"time": part["time"] - part["time"][0] + 31.0 * k})
    assert failing({n: np.concatenate([c[n] for c in cut]) for n in cut[0]}, "", holds, 0.0, 0.0) == []


@pytest.mark.parametrize(("begin", "end"), [(22.0, 41.0), (33.0, 60.0)])
@pytest.mark.parametrize(
    ("names", "failure"),
    [
        ("V", holds), ("V", falls), ("beta", holds), ("beta", sticks), ("vn ve vd", holds), ("vn ve vd", sticks),
        ("p q r", holds), ("p", sticks), ("beta", falls), ("ax ay az", holds), ("ax ay az", falls), ("phi theta psi", sticks),
    ],
)  # fmt: skip
def test_what_fails_is_named_with_its_times(names: str, failure: Failure, begin: float, end: float) -> None:
    columns = swaying_flight(3) if names == "beta" else turning_flight(3, seconds=60.0, sway=0.25)
    del columns["p_dynamic"]
    found = [c for c in failing(columns, names, failure, begin, end) if set(c.failed) & set(names.split())]
    assert found, (names, failure)
    (first, last) = found[0].spans[0]
    assert abs(first - begin) < 1.5
    assert abs(last - min(end, columns["time"][-1])) < 1.5
    assert found[0].stops
    assert "--segments 0.0:" in found[0].text


@pytest.mark.parametrize("seed", range(3))
def test_a_pitot_that_ices_in_is_told_by_the_change_of_the_speed_over_ground(seed: int) -> None:
    columns = turning_flight(seed, seconds=120.0)
    t = columns["time"]
    faster = 3.0 * np.sin(0.25 * t)  # along the nose, so that the wind stays
    columns["V"] = columns["V"] + faster
    for name, share in (("vn", np.cos(columns["psi"])), ("ve", np.sin(columns["psi"]))):
        columns[name] = columns[name] + faster * share
    bare = {n: v for n, v in columns.items() if n in ("time", "V", "vn", "ve", "vd", "psi", "theta")}
    assert failing({n: v.copy() for n, v in bare.items()}, "", holds, 0.0, 0.0) == []
    (found,) = failing(bare, "V", sticks, 55.0, 120.0)
    assert found.failed == ("V",)
    assert abs(found.spans[0][0] - 55.0) < 8.0


@pytest.mark.parametrize("with_fixes", [True, False])
def test_a_pitot_that_fails_in_flight_leaves_nothing_on_the_ground_and_the_refusal_says_so(with_fixes: bool) -> None:
    columns = turning_flight(seconds=90.0)
    t = columns.pop("time")
    rest, noise = t < 20.0, np.random.default_rng(2).standard_normal((2, t.size))
    for name, value in (
        ("V", 0.4),
        ("p_dynamic", 0.5),
        ("vn", 0.0),
        ("ve", 0.0),
        ("vd", 0.0),
        ("ax", 0.0),
        ("theta", 0.0),
    ):
        columns[name][rest] = value
    columns["V"][rest], columns["p_dynamic"][rest] = np.abs(0.2 * noise[0][rest]), noise[1][rest]
    lost = t > 55.0
    columns["V"][lost], columns["p_dynamic"][lost] = np.abs(0.2 * noise[0][lost]), noise[1][lost]
    dropped = () if with_fixes else ("vn", "ve", "vd")
    flight = Flight.build("f", t, {n: v for n, v in columns.items() if n not in dropped})
    assert airborne(flight).flying[lost].all()
    assert not airborne(flight).flying[rest].any()
    texts = [c.text for c in contradictions(flight) if "V" in c.failed]
    assert len(texts) == 1
    assert "from 55.0 to 90.0 s" in texts[0]
    assert "--segments 20.0:55.0" in texts[0]
    assert "lost its tube" in no_airspeed(flight)


def test_a_landing_after_the_fix_froze_is_no_failed_pitot() -> None:
    columns = turning_flight(seconds=90.0)
    t = columns.pop("time")
    landed = t > 60.0
    columns["V"][landed] = np.abs(0.2 * np.random.default_rng(2).standard_normal(landed.sum()))
    columns["ax"][landed] = 0.0
    for name in ("vn", "ve", "vd"):
        columns[name][t > 50.0] = columns[name][t > 50.0][0]
    slows = (t > 57.0) & ~landed
    columns["V"][slows] = np.linspace(20.0, 0.2, slows.sum())
    columns["ax"][slows] = -6.6
    flight = Flight.build("f", t, columns)
    assert not airborne(flight).flying[landed].any()
    assert all("V" not in c.failed for c in contradictions(flight))


def test_a_push_over_is_no_failed_accelerometer() -> None:
    columns = {n: v for n, v in turning_flight(2, seconds=40.0).items() if n not in ("vn", "ve", "vd")}
    over = (columns["time"] > 20.0) & (columns["time"] < 24.0)
    rng = np.random.default_rng(3)
    for axis in ("ax", "ay", "az"):
        columns[axis][over] = 0.1 * rng.standard_normal(over.sum())
    denied = dict(columns)
    columns["q"] = np.where(over, -GRAVITY / columns["V"], columns["q"])
    assert not [c for c in failing(columns, "", holds, 0.0, 0.0) if "ax" in c.failed]
    assert [c for c in failing(denied, "", holds, 0.0, 0.0) if "ax" in c.failed]


@pytest.mark.parametrize("seed", range(4))
def test_what_lies_between_two_stretches_is_no_failure(seed: int) -> None:
    """Velocity changes in the gap between them, and what is integrated of accelerations does not."""
    columns = turning_flight(seed, seconds=240.0, sway=0.02)
    flown = columns["time"] % 16.6 < 7.6
    assert failing({n: v[flown] for n, v in columns.items()}, "", holds, 0.0, 0.0) == []
