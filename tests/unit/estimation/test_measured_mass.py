"""Fuel as a history of mass: an aircraft that burns a quarter of itself, by equations of its own."""

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import sideslip as ss
from estimation.aircraft import Aircraft, PriorDerivative
from estimation.errors import DataError
from estimation.models import load_model
from estimation.performance.polar import fitted
from estimation.performance.samples import all_stretches, usable
from estimation.prepare.measured_mass import at_mean_mass, with_mass_history
from estimation.resolve import resolve
from groundstation.flight import Flight, write_flight
from tests.unit.estimation.test_performance import CD_0, CD_K, CRAFT, MASS, glide

S, B, C, FULL = 14.0, 9.0, 1.6, 2000.0
TRUTH = {
    "CY_0": 0.0, "CY_beta": -0.6, "CY_p": 0.05, "CY_r": 0.2, "CY_dr": 0.15,
    "Cl_0": 0.0, "Cl_beta": -0.09, "Cl_p": -0.45, "Cl_r": 0.12, "Cl_da": -0.15, "Cl_dr": 0.01,
    "Cn_0": 0.0, "Cn_beta": 0.09, "Cn_p": -0.04, "Cn_r": -0.14, "Cn_dr": -0.07,
}  # fmt: skip
JET = Aircraft("jet", B, S, C, FULL, 2500.0, 6000.0, 8000.0, 0.0, {n: PriorDerivative(v) for n, v in TRUTH.items()})
G, V, RHO = 9.80665, 70.0, 1.0


COEFFICIENTS = [[TRUTH.get(f"{c}_{n}", 0.0) for n in ("beta", "p", "r", "da", "dr")] for c in ("CY", "Cl", "Cn")]


@cache
def burning(seed: int, *, least: float = 0.72) -> Flight:
    """40 s of aileron and rudder at 25 Hz, mass falling from the file's to `least` of it; integrated by itself at 1 kHz."""
    rng, step = np.random.default_rng([seed, 485]), 0.001
    beta = p = r = phi = da = dr = 0.0
    rows = []
    pressure = 0.5 * RHO * V**2 * S
    for k in range(40_000):
        t = k * step
        mass = FULL * (1.0 - (1.0 - least) * t / 40.0)
        wanted_a = 0.05 * math.copysign(1.0, math.sin(2 * math.pi * t / 3.1)) * (1 if (t // 5) % 2 == 0 else 0)
        wanted_r = 0.06 * math.copysign(1.0, math.sin(2 * math.pi * t / 2.3)) * (1 if (t // 5) % 2 == 1 else 0)
        da, dr = da + step * (wanted_a - da) / 0.08, dr + step * (wanted_r - dr) / 0.08
        ph, rh = p * B / (2 * V), r * B / (2 * V)
        CY, Cl, Cn = (c[0] * beta + c[1] * ph + c[2] * rh + c[3] * da + c[4] * dr for c in COEFFICIENTS)
        ay = pressure * CY / mass
        if k % 40 == 0:
            n = rng.normal(size=5)
            rows.append(
                (
                    t,
                    beta + 2e-3 * n[0],
                    p + 2e-3 * n[1],
                    r + 2e-3 * n[2],
                    phi + 2e-3 * n[3],
                    ay + 0.03 * n[4],
                    da,
                    dr,
                    mass,
                )
            )
        beta_dot = ay / V + G / V * math.sin(phi) - r
        p_dot, r_dot = pressure * B * Cl / JET.Ixx, pressure * B * Cn / JET.Izz
        beta, phi, p, r = beta + step * beta_dot, phi + step * p, p + step * p_dot, r + step * r_dot
    names = ("beta", "p", "r", "phi", "ay", "delta_a", "delta_r", "mass")
    table = np.array(rows)
    steady = {"V": (V, 0.05), "rho": (RHO, 1e-5), "alpha": (0.0, 2e-4), "theta": (0.0, 2e-4), "q": (0.0, 2e-4)}
    still = {n: value + noise * rng.standard_normal(len(table)) for n, (value, noise) in steady.items()}
    return Flight.build(f"burning{seed}", table[:, 0], {n: table[:, i + 1] for i, n in enumerate(names)} | still)


def test_the_mass_of_the_flight_is_in_the_equations() -> None:
    """Side force is mass times acceleration: with the file's mass CY_beta is a sixth too large, with the flight's it is right."""
    flight = burning(1)
    answer = ss.estimate(flight, "lateral", "ml", aircraft=JET, structure="off")
    told = answer["CY_beta"]
    assert abs(told.estimate - TRUTH["CY_beta"]) < 3 * told.std_coloured
    assert any("mass as measured, 1440" in line and "in place of 2000 kg" in line for line in answer.lines())
    assert answer.model.constants["m"] == pytest.approx(1720.0, rel=0.01)
    columns = {n: v for n, v in flight.columns.items() if n != "mass"}
    other = ss.estimate(Flight.build("bare", flight.time, columns), "lateral", "ml", aircraft=JET, structure="off")
    assert abs(other["CY_beta"].estimate - TRUTH["CY_beta"]) > 0.05
    assert not any("mass as measured" in line for line in other.lines())


PITCH = {
    "CL_0": 0.25, "CL_alpha": 4.8, "CL_q": 6.0, "CL_de": 0.4, "CD_0": 0.03, "CD_k": 0.05,
    "Cm_0": 0.02, "Cm_alpha": -0.7, "Cm_q": -14.0, "Cm_de": -1.1,
}  # fmt: skip


def burning_in_pitch(seed: int) -> Flight:
    """40 s of elevator at 20 Hz at constant airspeed, mass falling by 28 %; integrated by itself at 1 kHz."""
    rng, step, d = np.random.default_rng([seed, 486]), 0.001, PITCH
    alpha, q, theta, de, rows = 0.12, 0.0, 0.12, 0.0, []
    pressure = 0.5 * RHO * V**2 * S
    for k in range(40_000):
        t = k * step
        mass = FULL * (1.0 - 0.28 * t / 40.0)
        hands = 0.035 * math.copysign(1.0, math.sin(2 * math.pi * t / 2.7)) * (1 if (t // 4) % 2 == 0 else 0)
        trim = (mass * G / pressure - d["CL_0"]) / d["CL_alpha"]
        wanted = hands - 0.04 - 0.6 * (trim - 0.12) + 0.4 * (theta - trim) + 0.2 * q
        de += step * (wanted - de) / 0.08
        qh = q * C / (2 * V)
        CL = d["CL_0"] + d["CL_alpha"] * alpha + d["CL_q"] * qh + d["CL_de"] * de
        CD = d["CD_0"] + d["CD_k"] * CL**2
        Cm = d["Cm_0"] + d["Cm_alpha"] * alpha + d["Cm_q"] * qh + d["Cm_de"] * de
        lift, drag, path = pressure * CL, pressure * CD, theta - alpha
        thrust = (drag + mass * G * math.sin(path)) / math.cos(alpha)
        ax = (lift * math.sin(alpha) - drag * math.cos(alpha) + thrust) / mass
        az = (-lift * math.cos(alpha) - drag * math.sin(alpha)) / mass
        if k % 50 == 0:
            n = rng.normal(size=5) * [2e-3, 2e-3, 2e-3, 0.03, 0.03]
            rows.append((t, alpha + n[0], q + n[1], theta + n[2], ax + n[3], az + n[4], de, thrust, mass))
        alpha += step * (q - (lift + thrust * math.sin(alpha)) / (mass * V) + G * math.cos(path) / V)
        theta, q = theta + step * q, q + step * pressure * C * Cm / JET.Iyy
    names = ("alpha", "q", "theta", "ax", "az", "delta_e", "thrust", "mass")
    table = np.array(rows)
    steady = {"V": (V, 0.05), "rho": (RHO, 1e-5), **dict.fromkeys(("beta", "p", "r", "phi", "ay"), (0.0, 2e-4))}
    still = {n: value + noise * rng.standard_normal(len(table)) for n, (value, noise) in steady.items()}
    return Flight.build(f"pitching{seed}", table[:, 0], {n: table[:, i + 1] for i, n in enumerate(names)} | still)


def bare(flight: Flight) -> Flight:
    """Without a record of its mass."""
    return Flight.build("bare", flight.time, {n: v for n, v in flight.columns.items() if n != "mass"})


@pytest.mark.parametrize("seed", [6, 7])
def test_the_live_estimator_follows_the_mass(seed: int) -> None:
    """With the file's mass CY_beta came out a quarter too large, by more than ten of its bounds."""
    flight = burning(seed)
    answer = ss.estimate(flight, "lateral", "live", aircraft=JET, structure="off")
    for name in ("CY_beta", "CY_dr", "Cl_beta", "Cl_p", "Cl_da", "Cn_beta", "Cn_r", "Cn_dr"):
        assert abs(answer[name].estimate - TRUTH[name]) < 3.5 * answer[name].std_coloured, name
    other = ss.estimate(bare(flight), "lateral", "live", aircraft=JET, structure="off")["CY_beta"]
    assert abs(other.estimate - TRUTH["CY_beta"]) > 8.0 * other.std_coloured


def test_the_pitching_plane_follows_the_mass_live() -> None:
    """Lift and drag are masses times accelerations; with the file's, lift at the end is a third too large."""
    flight = burning_in_pitch(12)
    craft = replace(JET, derivatives={n: PriorDerivative(v) for n, v in PITCH.items()})
    answer = ss.estimate(flight, "longitudinal", "live", aircraft=craft, structure="off")
    other = ss.estimate(bare(flight), "longitudinal", "live", aircraft=craft, structure="off")
    wrong = {n: (other[n].estimate - PITCH[n]) / other[n].std_coloured for n in ("CL_alpha", "CL_0", "CD_0", "CD_k")}
    for name in ("CL_alpha", "CL_0", "CD_0", "CD_k", "Cm_alpha", "Cm_q", "Cm_de"):
        assert abs(answer[name].estimate - PITCH[name]) < 3.5 * answer[name].std_coloured, name
    assert max(abs(w) for w in wrong.values()) > 5.0


def test_a_match_is_judged_with_the_mass_of_the_flight(tmp_path: Path) -> None:
    """Also for a model file, which knows of no aircraft; what was saved of such a flight predicts one without a record."""
    flight = burning(8)
    rms = {}
    for name, flown in (("mass", flight), ("bare", bare(flight))):
        proof = ss.match("lateral", flown, aircraft=JET)
        rms[name] = proof.proofs[0].fit["ay"].rms
        assert any("mass as measured" in line for line in proof.lines()) == (name == "mass")
    assert rms["mass"] < 0.04 < 0.1 < rms["bare"]  # the noise is 0.03 m/s2
    estimated = ss.estimate(flight, "lateral", "ls", aircraft=JET, structure="off")
    estimated.save(tmp_path / "jet.toml")
    again = ss.match(tmp_path / "jet.toml", [burning(9), bare(burning(9))])
    assert again.proofs[0].fit["ay"].rms < 0.04
    assert again.proofs[1].fit["ay"].rms > 0.05  # without a record, one mass for all of it


def test_every_verb_is_given_the_mass_by_the_front_door() -> None:
    """`gap` and `watch` work on what `resolve` gives."""
    problem = resolve([burning(1), bare(burning(9))], "lateral", JET)
    assert "mass" in problem.model.input_names
    assert "mass as measured" in problem.notes[0]
    np.testing.assert_allclose(problem.flights[1]["mass"], FULL)
    assert at_mean_mass(problem.model).definitions == load_model("lateral", JET).definitions


def test_fuel_that_is_read_seldom_is_filled_in_by_lines() -> None:
    flight = burning(1)
    seldom = np.where(np.arange(len(flight)) % 50 == 0, flight["mass"], np.nan)
    answer = ss.estimate(flight.with_columns(mass=seldom), "lateral", "ls", aircraft=JET, structure="off")
    whole = ss.estimate(flight, "lateral", "ls", aircraft=JET, structure="off")
    assert answer["CY_beta"].estimate == pytest.approx(whole["CY_beta"].estimate, rel=5e-3)


def test_what_a_model_of_ones_own_calls_m_is_left_alone() -> None:
    flight = burning(1)
    """A built-in line has the mass in it, whatever the file says by now; of another line only its value tells."""
    model = load_model("lateral", JET)
    of_its_own = model.plus(replaced={"ay": "S*q_dyn*CY/m"})
    for base, constant, changed in (
        (model, FULL, True),
        (model, 1500.0, True),
        (of_its_own, FULL, True),
        (of_its_own, 1500.0, False),
    ):
        other = replace(base, constants={**base.constants, "m": constant})
        found, flights, notes = with_mass_history(other, [flight], JET)
        assert (found is not other) == bool(notes) == changed
        assert flights[0].measured("mass")


@pytest.mark.parametrize(
    ("factor", "said"), [(2.2046, "is its unit right"), (0.1, "not its fuel"), (-1.0, "not above zero")]
)
def test_a_mass_that_is_none_is_refused(factor: float, said: str) -> None:
    flight = burning(1)
    wrong = flight.with_columns(mass=factor * flight["mass"])
    with pytest.raises(DataError, match=said):
        ss.estimate(wrong, "lateral", "ls", aircraft=JET)


def test_a_polar_of_an_aircraft_that_grew_lighter() -> None:
    """Accelerations of a glider at 80 % of its mass are a quarter larger; with its mass the polar is the true one."""
    flight = glide(9)
    lighter = flight.with_columns(ax=flight["ax"] / 0.8, az=flight["az"] / 0.8, mass=np.full(len(flight), 0.8 * MASS))
    polar = fitted(all_stretches([usable(lighter, CRAFT, throttle_off=True)]))
    for name, truth in (("CD_0", CD_0), ("CD_k", CD_K)):
        low, high = polar[name].ends
        assert low < truth < high
    wrong = fitted(
        all_stretches([usable(lighter.with_columns(mass=np.full(len(flight), MASS)), CRAFT, throttle_off=True)])
    )
    assert not wrong["CD_0"].ends[0] < CD_0 < wrong["CD_0"].ends[1]


def test_a_campaign_has_the_mass_of_each_flight(tmp_path: Path) -> None:
    flight = burning(1)
    write_flight(flight, tmp_path / "burning.csv")
    derivatives = "".join(f"{n} = {v}\n" for n, v in TRUTH.items())
    (tmp_path / "jet.toml").write_text(
        f'name = "jet"\n[geometry]\nspan = {B}\narea = {S}\nchord = {C}\n[mass]\nmass = {FULL}\nIxx = 2500.0\nIyy = 6000.0\n'
        f"Izz = 8000.0\nIxz = 0.0\n[derivatives]\n{derivatives}"
    )
    answer = ss.campaign(
        [tmp_path / "burning.csv"],
        methods="ls",
        aircraft=tmp_path / "jet.toml",
        out=tmp_path / "c",
        serial=True,
        no_report=True,
    )
    table = answer.to_pandas()
    (told,) = table[(table.kind == "estimate") & (table.parameter == "CY_beta")].estimate
    assert told == pytest.approx(
        ss.estimate(flight, "lateral", "ls", aircraft=JET, structure="off")["CY_beta"].estimate, rel=1e-6
    )
    assert told == pytest.approx(TRUTH["CY_beta"], rel=0.03)
