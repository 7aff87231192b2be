"""What a flight says twice: each row of the table with a true flight, one side of it off, and nothing off."""

import numpy as np
import pytest

from groundstation.flight import Flight, Provenance, read_flight
from groundstation.flight.contradictions import CONTRADICTIONS, Contradiction, contradictions, contradictions_of

Columns = dict[str, np.ndarray]
GRAVITY = 9.80665
RHO = 1.104


def turning_flight(seed: int = 5, hz: float = 25.0, seconds: float = 50.0) -> Columns:
    """Left and right turns at 21 m/s in a wind of 6 m/s, kinematics exact by differences, noise on every channel."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1 / hz)
    psi = 0.7 + 1.9 * np.sin(0.17 * t)
    theta, phi = 0.05 + 0.03 * np.sin(0.6 * t), np.arctan(21.0 * 0.323 * np.cos(0.17 * t) / GRAVITY)
    speed = 21.0 + 0.8 * np.sin(0.3 * t)
    climb = speed * np.sin(theta - 0.05)
    flat = np.sqrt(speed**2 - climb**2)
    v = np.array([flat * np.cos(psi) + 4.1, flat * np.sin(psi) - 4.4, -climb])
    a = np.gradient(v, t, axis=1) - np.array([[0.0], [0.0], [GRAVITY]])
    c, s = np.cos, np.sin
    rows = np.array([
        [c(theta) * c(psi), c(theta) * s(psi), -s(theta)],
        [s(phi) * s(theta) * c(psi) - c(phi) * s(psi), s(phi) * s(theta) * s(psi) + c(phi) * c(psi), s(phi) * c(theta)],
        [c(phi) * s(theta) * c(psi) + s(phi) * s(psi), c(phi) * s(theta) * s(psi) - s(phi) * c(psi), c(phi) * c(theta)],
    ])  # fmt: skip
    force = np.einsum("ijn,jn->in", rows, a)
    dphi, dtheta, dpsi = (np.gradient(x, t) for x in (phi, theta, psi))
    p, q, r = (
        dphi - s(theta) * dpsi,
        c(phi) * dtheta + s(phi) * c(theta) * dpsi,
        -s(phi) * dtheta + c(phi) * c(theta) * dpsi,
    )
    field = np.einsum("ijn,j->in", rows, [2.1e-5, 1e-6, 4.3e-5])
    true = {
        "ax": force[0], "ay": force[1], "az": force[2], "p": p, "q": q, "r": r, "phi": phi, "theta": theta,
        "psi": (psi + np.pi) % (2 * np.pi) - np.pi, "V": speed, "vn": v[0], "ve": v[1], "vd": v[2],
        "p_dynamic": 0.5 * RHO * speed**2, "p_static": np.full(t.size, RHO * 287.05 * 281.0),
        "temperature": np.full(t.size, 281.0), "mx": field[0], "my": field[1], "mz": field[2],
    }  # fmt: skip
    noise = {"ax": 0.1, "ay": 0.1, "az": 0.1, "p": 0.005, "q": 0.005, "r": 0.005, "V": 0.2, "vn": 0.1, "ve": 0.1, "vd": 0.1,
             "p_dynamic": 2.0, "p_static": 8.0, "mx": 3e-7, "my": 3e-7, "mz": 3e-7}  # fmt: skip
    return {"time": t, **{n: x + noise.get(n, 0.002) * rng.standard_normal(t.size) for n, x in true.items()}}


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
