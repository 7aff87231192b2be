"""Centre of gravity as a history: an aircraft whose load moves in flight, by equations of its own about a point of its body.

The truth is flown about the file's CG as a fixed point P of a rigid body whose centre of mass moves away from it: Newton for the
centre of mass, Euler about it, instruments at P.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

import sideslip as ss
from daq.identification.airframe import Airframe
from daq.identification.moved_cg import at_moved_cg
from estimation.aircraft import PriorDerivative
from estimation.errors import DataError
from estimation.models import load_model
from estimation.prepare.measured_cg import at_stated_cg, with_cg_history
from estimation.resolve import resolve
from groundstation.flight import Flight
from tests.unit.estimation.test_measured_mass import COEFFICIENTS, FULL, JET, PITCH, RHO, TRUTH, B, C, G, S, V

AFT = -0.25  # m, of the CG at the end: 16 % of the chord


def yawing(seed: int) -> Flight:
    """40 s of aileron and rudder at 50 Hz while the CG goes aft; integrated at 1 kHz about the moving CG, shown at the file's."""
    rng, step = np.random.default_rng([seed, 487]), 0.001
    beta = p = r = phi = da = dr = 0.0
    pressure, rows = 0.5 * RHO * V**2 * S, []
    for k in range(40_000):
        t, d = k * step, AFT * k / 40_000
        hands = (math.copysign(1.0, math.sin(2 * math.pi * t / period)) for period in (3.1, 2.3))
        aileron, rudder = (h * ((t // 5) % 2 == i) for i, h in enumerate(hands))
        da, dr = da + step * (0.05 * aileron - da) / 0.08, dr + step * (0.06 * rudder - dr) / 0.08
        ph, rh, at_p = p * B / (2 * V), r * B / (2 * V), beta - d * r / V  # the flow at P, where derivatives hold
        CY, Cl, Cn = (c[0] * at_p + c[1] * ph + c[2] * rh + c[3] * da + c[4] * dr for c in COEFFICIENTS)
        ay = pressure * CY / FULL
        p_dot, r_dot = pressure * B * Cl / JET.Ixx, (pressure * B * Cn - d * pressure * CY) / JET.Izz
        if k % 20 == 0:
            n = rng.normal(size=5) * [1e-3, 1e-3, 1e-3, 1e-3, 0.02]
            rows.append((t, at_p + n[0], p + n[1], r + n[2], phi + n[3], ay - d * r_dot + n[4], da, dr, d))
        beta += step * (ay / V + G / V * math.sin(phi) - r)
        phi, p, r = phi + step * p, p + step * p_dot, r + step * r_dot
    names = ("beta", "p", "r", "phi", "ay", "delta_a", "delta_r", "cg_x")
    table = np.array(rows)
    steady = {"V": (V, 0.05), "rho": (RHO, 1e-5), "alpha": (0.0, 2e-4), "theta": (0.0, 2e-4), "q": (0.0, 2e-4)}
    still = {n: value + noise * rng.standard_normal(len(table)) for n, (value, noise) in steady.items()}
    return Flight.build(f"yawing{seed}", table[:, 0], {n: table[:, i + 1] for i, n in enumerate(names)} | still)


def pitching(seed: int) -> Flight:
    """40 s of elevator at 25 Hz at constant airspeed while the CG goes aft, likewise."""
    rng, step, d = np.random.default_rng([seed, 488]), 0.001, PITCH
    alpha, q, theta, de, rows = 0.12, 0.0, 0.12, 0.0, []
    pressure = 0.5 * RHO * V**2 * S
    for k in range(40_000):
        t, x = k * step, AFT * k / 40_000
        hands = 0.035 * math.copysign(1.0, math.sin(2 * math.pi * t / 2.7)) * (1 if (t // 4) % 2 == 0 else 0)
        de += step * (hands - 0.04 + 0.4 * (theta - 0.12) + 0.2 * q - de) / 0.08
        at_p, qh = alpha + x * q / V, q * C / (2 * V)
        CL = d["CL_0"] + d["CL_alpha"] * at_p + d["CL_q"] * qh + d["CL_de"] * de
        CD = d["CD_0"] + d["CD_k"] * CL**2
        Cm = d["Cm_0"] + d["Cm_alpha"] * at_p + d["Cm_q"] * qh + d["Cm_de"] * de
        X, Z = (
            pressure * (CL * math.sin(at_p) - CD * math.cos(at_p)),
            -pressure * (CL * math.cos(at_p) + CD * math.sin(at_p)),
        )
        thrust = pressure * CD / math.cos(alpha) + FULL * G * math.sin(theta - alpha)
        ax, az, q_dot = (X + thrust) / FULL, Z / FULL, (pressure * C * Cm + x * Z) / JET.Iyy
        if k % 40 == 0:
            n = rng.normal(size=5) * [1e-3, 1e-3, 1e-3, 0.02, 0.02]
            shown = (at_p + n[0], q + n[1], theta + n[2], ax + x * q**2 + n[3], az + x * q_dot + n[4])
            rows.append((t, *shown, de, thrust, x))
        gx, gz = ax - G * math.sin(theta), az + G * math.cos(theta)
        alpha += step * (q + (gz * math.cos(alpha) - gx * math.sin(alpha)) / V)
        theta, q = theta + step * q, q + step * q_dot
    names = ("alpha", "q", "theta", "ax", "az", "delta_e", "thrust", "cg_x")
    table = np.array(rows)
    steady = {"V": (V, 0.05), "rho": (RHO, 1e-5), **dict.fromkeys(("beta", "p", "r", "phi", "ay"), (0.0, 2e-4))}
    still = {n: value + noise * rng.standard_normal(len(table)) for n, (value, noise) in steady.items()}
    return Flight.build(f"pitching{seed}", table[:, 0], {n: table[:, i + 1] for i, n in enumerate(names)} | still)


def bare(flight: Flight) -> Flight:
    """Without a record of its centre of gravity."""
    return Flight.build("bare", flight.time, {n: v for n, v in flight.columns.items() if n != "cg_x"})


@pytest.fixture(scope="module")
def lateral() -> Flight:
    return yawing(1)


@pytest.fixture(scope="module")
def longitudinal() -> Flight:
    return pitching(2)


@pytest.mark.parametrize("method", ["ls", "live"])
def test_yawing_moments_are_about_the_cg_of_the_moment(method: str, lateral: Flight) -> None:
    """Side force has an arm to the file's CG: with the CG held there the weathercock is a fifth too weak."""
    answer = ss.estimate(lateral, "lateral", method, aircraft=JET, structure="off")
    other = ss.estimate(bare(lateral), "lateral", method, aircraft=JET, structure="off")
    assert any("centre of gravity as measured, -0.25 to +0 m" in line for line in answer.lines())
    assert answer["Cn_beta"].estimate == pytest.approx(TRUTH["Cn_beta"], rel=0.02)
    assert answer["Cn_dr"].estimate == pytest.approx(TRUTH["Cn_dr"], rel=0.02)
    assert answer["Cl_r"].estimate == pytest.approx(TRUTH["Cl_r"], rel=0.012)  # by the flow at the moved CG 2 % off
    assert other["Cn_beta"].estimate < 0.95 * TRUTH["Cn_beta"]
    assert "cg_x" not in answer.model.input_names


@pytest.mark.parametrize("method", ["ls", "live"])
def test_pitching_moments_are_about_the_cg_of_the_moment(method: str, longitudinal: Flight) -> None:
    """Lift has one too: held at the file's CG stiffness, elevator and trim are off."""
    craft = replace(JET, derivatives={n: PriorDerivative(v) for n, v in PITCH.items()})
    answer = ss.estimate(longitudinal, "longitudinal", method, aircraft=craft, structure="off")
    other = ss.estimate(bare(longitudinal), "longitudinal", method, aircraft=craft, structure="off")
    for name in ("Cm_alpha", "Cm_de", "Cm_0"):
        assert answer[name].estimate == pytest.approx(PITCH[name], rel=0.03), name
    assert answer["CL_q"].estimate == pytest.approx(PITCH["CL_q"], rel=0.08)  # by the flow at the moved CG 15 % off
    assert max(abs(other[n].estimate / PITCH[n] - 1.0) for n in ("Cm_alpha", "Cm_de", "Cm_0")) > 0.1


def test_a_model_predicts_a_flight_with_its_cg(lateral: Flight) -> None:
    """Output error, with the model about the moving CG and without."""
    rms = [ss.match("lateral", f, aircraft=JET).proofs[0].fit["r"].rms for f in (lateral, bare(lateral))]
    assert rms[0] < 2e-3 < 1e-2 < rms[1]  # the noise is 1e-3 rad/s


def test_what_instruments_show_is_carried_to_the_cg(lateral: Flight) -> None:
    """Closed form: a yaw of r = 0.3 sin 2t about a CG 0.2 m ahead of the instruments."""
    time = np.arange(0.0, 3.0, 0.01)
    r, ahead = 0.3 * np.sin(2 * time), np.full(time.size, 0.2)
    columns = {
        "r": r,
        "V": np.full(time.size, 20.0),
        "beta": 0.05 - 0.2 * r / 20.0,
        "ay": -0.2 * 0.6 * np.cos(2 * time),
    }
    moved = at_moved_cg(columns, time, ahead)
    np.testing.assert_allclose(moved["beta"], 0.05)
    np.testing.assert_allclose(moved["ay"][1:-1], 0.0, atol=1e-4)
    assert set(moved) == {"beta", "ay"}


def test_every_verb_is_given_the_cg_by_the_front_door(lateral: Flight) -> None:
    problem = resolve([lateral, bare(yawing(3))], "lateral", JET)
    assert "cg_x" in problem.model.input_names
    np.testing.assert_allclose(problem.flights[1]["cg_x"], 0.0)
    plain = load_model("lateral", JET)
    assert "CY_beta*cg_x*r/V" in problem.model.definitions["CY"]
    assert at_stated_cg(problem.model).definitions == plain.definitions
    untouched = with_cg_history(plain, [bare(lateral)])
    assert untouched[0] is plain
    assert untouched[2] == ()


def test_a_cg_that_is_none_is_refused(lateral: Flight) -> None:
    wrong = lateral.with_columns(cg_x=1000.0 * lateral["cg_x"])
    with pytest.raises(DataError, match="in metres"):
        ss.estimate(wrong, "lateral", "ls", aircraft=JET)
    airframe = Airframe(B, S, FULL, JET.Ixx, JET.Iyy, JET.Izz, JET.Ixz)
    assert [airframe.cg_ahead(x) for x in (0.3, -0.3, 5.0, math.nan)] == [0.3, -0.3, 0.0, 0.0]
