"""Fuel as a history of mass: an aircraft that burns a quarter of itself, by equations of its own."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sideslip as ss
from estimation.aircraft import Aircraft, PriorDerivative
from estimation.errors import DataError
from estimation.models import load_model
from estimation.performance.polar import fitted
from estimation.performance.samples import all_stretches, usable
from estimation.prepare.measured_mass import with_mass_history
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


def burning(seed: int, *, least: float = 0.72) -> Flight:
    """40 s of aileron and rudder at 50 Hz, mass falling from the file's to `least` of it; integrated by itself at 1 kHz."""
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
        CY, Cl, Cn = (
            TRUTH[f"{c}_beta"] * beta + TRUTH[f"{c}_p"] * ph + TRUTH[f"{c}_r"] * rh + TRUTH.get(f"{c}_da", 0.0) * da
            + TRUTH[f"{c}_dr"] * dr for c in ("CY", "Cl", "Cn")
        )  # fmt: skip
        ay = pressure * CY / mass
        if k % 20 == 0:
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


def test_fuel_that_is_read_seldom_is_filled_in_by_lines() -> None:
    flight = burning(2)
    seldom = np.where(np.arange(len(flight)) % 100 == 0, flight["mass"], np.nan)
    answer = ss.estimate(flight.with_columns(mass=seldom), "lateral", "ls", aircraft=JET, structure="off")
    whole = ss.estimate(flight, "lateral", "ls", aircraft=JET, structure="off")
    assert answer["CY_beta"].estimate == pytest.approx(whole["CY_beta"].estimate, rel=5e-3)


def test_what_a_model_of_ones_own_calls_m_is_left_alone() -> None:
    flight = burning(4)
    model = load_model("lateral", JET)
    for constant, changed in ((FULL, True), (1500.0, False)):
        other = replace(model, constants={**model.constants, "m": constant})
        found, flights, notes = with_mass_history(other, [flight], JET)
        assert (found is not other) == bool(notes) == changed
        assert flights[0].measured("mass")


@pytest.mark.parametrize(
    ("factor", "said"), [(2.2046, "is its unit right"), (0.1, "not its fuel"), (-1.0, "not above zero")]
)
def test_a_mass_that_is_none_is_refused(factor: float, said: str) -> None:
    flight = burning(3)
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
    flight = burning(5)
    write_flight(flight, tmp_path / "burning.csv")
    derivatives = "".join(f"{n} = {v}\n" for n, v in TRUTH.items())
    (tmp_path / "jet.toml").write_text(
        f'name = "jet"\n[geometry]\nspan = {B}\narea = {S}\nchord = {C}\n[mass]\nmass = {FULL}\nIxx = 2500.0\nIyy = 6000.0\n'
        f"Izz = 8000.0\nIxz = 0.0\n[derivatives]\n{derivatives}"
    )
    answer = ss.campaign(
        [tmp_path / "burning.csv"], methods="ls", aircraft=tmp_path / "jet.toml", out=tmp_path / "c", serial=True
    )
    table = answer.to_pandas()
    (told,) = table[(table.kind == "estimate") & (table.parameter == "CY_beta")].estimate
    assert told == pytest.approx(
        ss.estimate(flight, "lateral", "ls", aircraft=JET, structure="off")["CY_beta"].estimate, rel=1e-6
    )
    assert told == pytest.approx(TRUTH["CY_beta"], rel=0.03)
