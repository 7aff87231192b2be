"""What a flight says twice: each row of the table with a true flight, one side of it off, and nothing off."""

import numpy as np
import pytest

from daq.utilities.constants import GRAVITY
from groundstation.flight import Flight, Provenance, read_flight
from groundstation.flight.contradictions import (
    CONTRADICTIONS,
    Contradiction,
    contradictions,
    contradictions_of,
    no_airspeed,
)
from groundstation.flight.contradictions.fits import ratio_of
from tests.unit.groundstation.turning import RHO, Columns, turning_flight


def found_in(columns: Columns) -> dict[tuple[str, ...], Contradiction]:
    arrays = dict(columns)
    return {c.between: c for c in contradictions_of(arrays.pop("time"), arrays)}


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_true_flight_contradicts_itself_nowhere(seed: int) -> None:
    assert found_in(turning_flight(seed)) == {}


def test_the_pressure_of_another_ratio_is_told_and_the_airspeed_favoured() -> None:
    flight = turning_flight()
    flight["p_dynamic"] /= 1.27
    one = found_in(flight)["V", "p_dynamic"]
    assert one.ratio == pytest.approx(1.27, rel=0.01)
    assert one.favoured == "V"
    assert not one.stops
    assert "27%" in one.moves


def test_an_airspeed_of_another_ratio_is_told_and_the_pressure_favoured() -> None:
    flight = turning_flight()
    flight["V"] *= 1.15
    found = found_in(flight)
    assert found["V", "p_dynamic"].favoured == "p_dynamic"
    assert found["V", "p_dynamic"].stops
    assert found["V", "vn", "ve"].ratio == pytest.approx(1 / 1.15, rel=0.02)
    assert found["V", "vn", "ve"].stops


@pytest.mark.parametrize(("factor", "words"), [(-1.0, "tubes of the pitot are swapped"), (0.02, "covered or blocked")])
def test_a_pitot_that_the_speed_over_ground_refutes_is_told(factor: float, words: str) -> None:
    columns = turning_flight() | {"V": np.zeros(1250)}
    columns["p_dynamic"] *= factor
    assert words in found_in(columns)["p_dynamic", "vn", "ve"].text
    assert found_in(columns)["p_dynamic", "vn", "ve"].stops
    assert words in no_airspeed(Flight.build("f", columns.pop("time"), columns))


def test_standing_with_noise_in_the_pitot_says_nothing_of_its_scale() -> None:
    columns = turning_flight(seconds=90.0)
    rest = columns["time"] < 35.0
    for name, value in (("V", 2.0), ("vn", 0.0), ("ve", 0.0), ("vd", 0.0), ("psi", 0.7)):
        columns[name][rest] = value
    flight = Flight.build("f", columns.pop("time"), {n: columns[n] for n in ("V", "psi", "vn", "ve", "vd")})
    assert contradictions(flight) == ()


def test_without_turns_nobody_is_favoured_and_nothing_is_to_be_recommended() -> None:
    flight = turning_flight()
    flight["p_dynamic"] *= 1.3
    one = found_in({n: v for n, v in flight.items() if n not in ("vn", "ve")})["V", "p_dynamic"]
    assert one.favoured == ""
    assert one.stops


def test_equivalent_airspeed_taken_for_true_is_recognised() -> None:
    flight = turning_flight()
    rho = 0.88
    flight["p_static"] *= rho / RHO
    flight["V"] *= np.sqrt(rho / 1.225)
    flight["p_dynamic"] *= rho / RHO
    one = found_in(flight)["V", "vn", "ve"]
    assert "equivalent airspeed" in one.text
    assert one.stops


@pytest.mark.parametrize(
    ("column", "factor", "between"),
    [("p", 1.25, ("phi", "p")), ("ay", 1.0, ()), ("r", 0.8, ("psi", "r"))],
)
def test_a_gyro_of_another_scale_is_told(column: str, factor: float, between: tuple[str, ...]) -> None:
    flight = turning_flight()
    flight[column] *= factor
    found = found_in(flight)
    assert set(found) == ({between} if between else set())
    if between:
        assert found[between].ratio == pytest.approx(1 / factor, rel=0.08)
        assert found[between].stops


@pytest.mark.parametrize("seed", range(6))
def test_a_few_seconds_of_a_drifting_attitude_are_no_scale(seed: int) -> None:
    """8 s are one window: an attitude that wanders by a fifth of a small motion explains nine tenths of it."""
    flight = turning_flight(seed)
    rows = slice(0, int(np.searchsorted(flight["time"], flight["time"][0] + 8.0)))
    short = {n: v[rows].copy() for n, v in flight.items()}
    t = short["time"] - short["time"][0]
    turned = 0.05 * np.sin(2 * np.pi * t / 4.0 + seed)
    short["theta"], short["q"] = turned + 0.01 * np.cos(2 * np.pi * t / 1.3), np.gradient(turned, t) / 1.16
    short["phi"], short["p"], short["r"] = 0 * t, 0 * t, 0 * t
    assert ("theta", "q") not in found_in(short)


def test_accelerometers_of_another_scale_are_told() -> None:
    flight = turning_flight()
    for axis in ("ax", "ay", "az"):
        flight[axis] = flight[axis] * 1.3
    assert any(between[:1] == ("vn",) for between in found_in(flight))


def test_density_against_pressure_heading_against_course_and_a_field_that_is_none() -> None:
    flight = turning_flight()
    flight["rho"] = np.full_like(flight["V"], 0.93)
    flight["psi"] = flight["psi"] + 0.35
    for axis in ("mx", "my", "mz"):
        flight[axis] = flight[axis] * 2.4
    del flight["p_dynamic"]
    found = found_in(flight)
    assert found["rho", "p_static", "temperature"].ratio == pytest.approx(0.93 / RHO, rel=0.02)
    assert found["rho", "p_static", "temperature"].stops
    assert found["psi", "vn", "ve"].offset == pytest.approx(-0.35, abs=0.05)
    assert not found["psi", "vn", "ve"].stops
    assert any("magnetometer" in c.text for c in found.values())


@pytest.mark.parametrize("outside", [248.0, 311.0])
@pytest.mark.parametrize("witness", ["p_static", "altitude_gnss", "p_static and temperature"])
def test_a_right_density_on_a_cold_or_a_hot_day_is_no_contradiction_and_one_of_another_height_is(
    outside: float, witness: str
) -> None:
    flight = turning_flight()
    pressure = 90500.0
    flight |= {"p_static": np.full_like(flight["V"], pressure), "temperature": np.full_like(flight["V"], outside)}
    flight["altitude_gnss"] = np.full_like(flight["V"], 945.0)
    right = pressure / (287.05287 * outside)
    for name in {"p_static", "temperature", "altitude_gnss"} - set(witness.split(" and ")):
        del flight[name]
    flight["p_dynamic"] = 0.5 * right * flight["V"] ** 2
    for factor, stopped in ((1.0, False), (0.8, True), (1.35, True)):
        flight["rho"] = np.full_like(flight["V"], factor * right)
        found = [c for between, c in found_in(flight).items() if between[0] == "rho"]
        as_on_another_day = factor * outside == 0.8 * 248.0 and "temperature" not in witness
        assert bool(found) == (stopped and not as_on_another_day), (factor, found)


def test_pitot_and_guessed_density_name_the_air_that_would_make_them_agree() -> None:
    flight = turning_flight()
    flight["p_dynamic"] *= 1.13
    del flight["temperature"]
    assert "air some" in found_in(flight)["V", "p_dynamic"].text
    assert "K colder would make them agree" in found_in(flight)["V", "p_dynamic"].text


def test_an_altitude_above_the_field_is_held_against_the_height_by_gnss() -> None:
    flight = turning_flight()
    flight |= {"altitude": np.full_like(flight["V"], 80.0), "altitude_gnss": np.full_like(flight["V"], 1650.0)}
    del flight["p_static"], flight["temperature"]
    assert found_in(flight)["altitude", "altitude_gnss"].stops


def test_command_against_surface() -> None:
    flight = turning_flight()
    flight["cmd_a"] = 0.2 * np.sign(np.sin(2 * flight["time"]))
    flight["delta_a"] = 0.6 * flight["cmd_a"]
    assert found_in(flight)["delta_a", "cmd_a"].ratio == pytest.approx(0.6, rel=0.01)


def test_what_an_import_saw_travels_with_the_flight(tmp_path) -> None:  # type: ignore[no-untyped-def]
    columns = turning_flight()
    seen = Contradiction(("ARSP[0]", "ARSP[1]"), "two pitots differ", ratio=0.8, stops=True, moves="all")
    detail = {CONTRADICTIONS: [seen.to_json(), {"text": 3}, "nothing"]}
    flight = Flight.build("turns", columns.pop("time"), columns, provenance=Provenance(detail=detail))
    again = read_flight(flight.save(tmp_path / "turns.mcap"))
    told = contradictions(again)
    assert [(c.between, c.ratio, c.stops) for c in told] == [(("ARSP[0]", "ARSP[1]"), 0.8, True)]


def swinging(scale: float) -> Columns:
    """A motion of 1.1 Hz to the side on a slow turn; fixes of 5 Hz, filtered and late, on straight lines between."""
    rng = np.random.default_rng(8)
    t = np.arange(0.0, 40.0, 0.02)
    w, slow = 2 * np.pi * 1.1, 2 * np.pi * 0.13
    ay = 3.0 * np.sin(w * t) + 0.5 * np.sin(slow * t)
    ve = scale * (3.0 / w * (1 - np.cos(w * t)) + 0.5 / slow * (1 - np.cos(slow * t)))
    fix = np.arange(0.0, 40.0, 0.2)
    late = np.interp(t, fix, np.interp(fix, t, np.convolve(ve, np.ones(12) / 12, "full")[: t.size]))
    still = {n: np.zeros(t.size) for n in ("ax", "phi", "theta", "psi", "vd")}
    noise = 0.02 * rng.standard_normal((2, t.size))
    return {"time": t, **still, "az": np.full(t.size, -GRAVITY), "ay": ay + noise[0], "vn": 20.0 + noise[1], "ve": late}


def test_a_receiver_that_cannot_follow_a_dutch_roll_is_no_contradiction() -> None:
    force = ("vn", "ve", "vd", "ax", "ay", "az")
    assert force not in found_in(swinging(1.0))
    assert found_in(swinging(0.75))[force].ratio == pytest.approx(0.75, abs=0.04)


@pytest.mark.filterwarnings("error")
def test_a_ratio_of_what_was_never_measured_is_none_and_no_warning() -> None:
    assert ratio_of(np.full(9, np.nan), np.full(9, np.nan)) is None


@pytest.mark.parametrize(("gyro", "step"), [("p", 0.03), ("q", -0.025), ("r", 0.04)])
def test_a_gyro_whose_zero_jumps_is_told_with_its_time(gyro: str, step: float) -> None:
    """Beside a constant zero and a wrong scale of each, which tell nothing."""
    columns = turning_flight(4, seconds=100.0, sway=0.1)
    time = columns.pop("time")
    for name, scale in (("p", 1.03), ("q", 0.97), ("r", 1.03)):
        columns[name] = scale * columns[name] + 0.02
    assert not [c for c in contradictions_of(time, columns) if set(c.between) & set("pqr")]
    columns[gyro] = columns[gyro] + step * (time > 61.0)
    (found,) = (c for c in contradictions_of(time, columns) if gyro in c.between)
    assert found.offset == pytest.approx(step, abs=0.006)
    assert "s on: its zero jumped; estimate either part, --segments 0.0:" in found.text
    assert abs(float(found.text.partition(" s on")[0].rpartition(" ")[2]) - 61.0) < 4.0
    assert not found.stops


def test_exchanged_gyros_are_told() -> None:
    columns = turning_flight(6, seconds=60.0, sway=0.1)
    time = columns.pop("time")
    columns["p"], columns["q"] = columns["q"], columns["p"]
    texts = [c.text for c in contradictions_of(time, columns) if c.stops]
    assert any("are the axes of the gyros exchanged?" in text for text in texts)
