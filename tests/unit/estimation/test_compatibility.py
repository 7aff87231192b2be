"""Planted instrument factors come back; what cannot be told is said; gaps are never integrated across."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp
from scipy.signal import savgol_filter

from estimation.compatibility.correct import correct_flight
from estimation.compatibility.problem import refuse_singular
from estimation.compatibility.reconstruction import Compatibility, compatibility
from estimation.compatibility.records import attitude_errors, attitude_jumps
from estimation.errors import EstimationError
from estimation.models.kinematic import compatibility_model
from groundstation.flight import Flight, MissingColumnError, write_flight
from groundstation.flight.airspeed import FLYING, flies_from
from sideslip.verbs.check import check

DEG = np.pi / 180
NOISE = {
    "ax": 0.05, "ay": 0.05, "az": 0.08, "p": 0.4 * DEG, "q": 0.4 * DEG, "r": 0.3 * DEG, "phi": 0.3 * DEG,
    "theta": 0.3 * DEG, "psi": 0.6 * DEG, "alpha": 0.3 * DEG, "beta": 0.25 * DEG, "V": 0.15,
}  # fmt: skip


def motion(seconds: float = 30.0, phase: float = 0.0) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Exact kinematics of a made-up flight: chosen rates and chosen air-relative velocity, forces from both.

    Nothing here uses the estimator's equations: attitude by scipy's integrator, specific force from the derivative of
    the velocity in the turning frame.
    """
    time = np.arange(0, seconds, 0.05)

    def rates(t: float) -> np.ndarray:
        return np.array([0.5 * np.sin(1.9 * t + phase), 0.10 * np.sin(1.1 * t), 0.20 * np.sin(1.4 * t + 0.7 + phase)])

    def attitude_rate(t: float, e: np.ndarray) -> list[float]:
        p, q, r = rates(t)
        phi, theta, _ = e
        turn = q * np.sin(phi) + r * np.cos(phi)
        return [p + np.tan(theta) * turn, q * np.cos(phi) - r * np.sin(phi), turn / np.cos(theta)]

    solution = solve_ivp(attitude_rate, (0, seconds), [0.0, 0.09, 0.4], t_eval=time, rtol=1e-10, atol=1e-12)
    phi, theta, psi = solution.y
    V = 16 + 0.8 * np.sin(0.5 * time)
    alpha, beta = 0.1 + 0.03 * np.sin(0.9 * time), 0.09 * np.sin(1.7 * time + phase)
    dV, da, db = 0.4 * np.cos(0.5 * time), 0.027 * np.cos(0.9 * time), 0.153 * np.cos(1.7 * time + phase)
    unit = np.array([np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)])
    along_a = np.array([-np.sin(alpha) * np.cos(beta), 0 * beta, np.cos(alpha) * np.cos(beta)])
    along_b = np.array([-np.cos(alpha) * np.sin(beta), np.cos(beta), -np.sin(alpha) * np.sin(beta)])
    velocity, change = V * unit, dV * unit + V * (da * along_a + db * along_b)
    omega = np.array([rates(t) for t in time]).T
    gravity = 9.80665 * np.array([-np.sin(theta), np.cos(theta) * np.sin(phi), np.cos(theta) * np.cos(phi)])
    force = change + np.cross(omega.T, velocity.T).T - gravity
    names = ("ax", "ay", "az", "p", "q", "r", "phi", "theta", "psi", "alpha", "beta", "V")
    return time, dict(zip(names, [*force, *omega, phi, theta, psi, alpha, beta, V], strict=True))


def flight(rng: np.random.Generator, *, seconds: float = 30.0, noise: float = 1.0, **planted: float) -> Flight:
    time, exact = motion(seconds, float(rng.uniform(0, 6)))
    columns = {n: v + planted.get(f"d{n}", 0.0) for n, v in exact.items()}
    late = np.interp(time - planted.get("tau_beta", 0.0), time, exact["beta"])
    columns["beta"] = planted.get("K_beta", 1.0) * late + planted.get("dbeta", 0.0)
    return Flight.build(
        "made", time, {n: v + noise * NOISE[n] * rng.standard_normal(len(v)) for n, v in columns.items()}
    )


PLANTED = {
    "dax": 0.03,
    "day": -0.05,
    "daz": 0.05,
    "dp": 0.002,
    "dq": -0.0015,
    "dr": 0.001,
    "K_beta": 1.08,
    "dbeta": 0.004,
}


def errors(result: Compatibility, planted: dict[str, float]) -> np.ndarray:
    neutral = {n: 1.0 if n.startswith("K") else 0.0 for n in result.factors}
    return np.array([(f.estimate - planted.get(n, neutral[n])) / f.std_coloured for n, f in result.factors.items()])


def test_table_2_factors_come_back_within_their_bounds(rng: np.random.Generator) -> None:
    ratios = []
    for _ in range(3):
        result = compatibility(flight(rng, **PLANTED))
        assert result.converged
        assert abs(result.factors["K_beta"].estimate - 1.08) < 0.01 * 1.08
        ratios.append(errors(result, PLANTED))
    every = np.concatenate(ratios)
    assert np.abs(every).max() < 4.0
    assert 0.5 < np.sqrt(np.mean(every**2)) < 1.5  # neither optimistic nor timid, over 24 draws


def test_innovations_are_white_and_noise_is_found(rng: np.random.Generator) -> None:
    results = [compatibility(flight(rng), ("K_beta", "dbeta")).flights[0] for _ in range(3)]
    for name in results[0].outputs:
        # 3 x 600 samples: the mean of a white series' lag-one autocorrelation has standard deviation 0.024
        assert abs(np.mean([r.whiteness[name] for r in results])) < 0.1, name
        assert np.mean([r.noise[name] for r in results]) == pytest.approx(NOISE[name], rel=0.08), name


def test_a_late_vane_is_found(rng: np.random.Generator) -> None:
    result = compatibility(flight(rng, tau_beta=0.06), ("K_beta", "dbeta", "dp", "dq", "dr", "tau_beta"))
    late = result.factors["tau_beta"]
    assert abs(late.estimate - 0.06) < 3 * late.std_coloured
    assert late.std_coloured < 0.01


def test_shared_factors_of_two_flights_have_smaller_bounds(rng: np.random.Generator) -> None:
    one, two = (flight(rng, seconds=20.0, **PLANTED) for _ in range(2))
    single, joint = compatibility(one), compatibility([one, two])
    assert joint.factors["K_beta"].std < 0.85 * single.factors["K_beta"].std
    assert np.abs(errors(joint, PLANTED)).max() < 4.0


def test_tied_factors_are_refused_by_name() -> None:
    model = compatibility_model(("K_beta", "dbeta", "x_vane"))
    tied = np.diag([1.0, 100.0, 1.0])
    tied[0, 2] = tied[2, 0] = 1.0 - 1e-12
    with pytest.raises(EstimationError, match="K_beta and x_vane cannot be told from each other"):
        refuse_singular(model, tied, "f")
    with pytest.raises(EstimationError, match="dbeta leaves no trace"):
        refuse_singular(model, np.diag([1.0, 0.0, 1.0]), "f")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"ax": 0.0}, "ax is 0 throughout"),
        ({"V": 0.0}, "V never reaches 5 m/s"),
        ({"p": 1e4}, "p is beyond"),
    ],
)
def test_dead_and_absurd_channels_are_refused_by_name(
    change: dict[str, float], words: str, rng: np.random.Generator
) -> None:
    f = flight(rng, seconds=5.0)
    (name, value), *_ = change.items()
    broken = f.with_columns(**{name: f[name] * value if value else np.zeros(len(f))})
    with pytest.raises(EstimationError, match=words):
        compatibility(broken, ("dp", "K_beta"))


def test_a_factor_of_a_missing_channel_is_named_and_the_rest_estimated(rng: np.random.Generator) -> None:
    f = flight(rng, seconds=10.0, dp=0.01)
    blind = Flight.build("f", f.time, {n: v for n, v in f.columns.items() if n != "beta"})
    found = compatibility(blind, ("dp", "dq", "dr", "K_beta"))
    assert not found.factors["K_beta"].identifiable
    assert "beta not measured" in found.factors["K_beta"].why
    assert abs(found.factors["dp"].estimate - 0.01) < 4 * found.factors["dp"].std_coloured
    with pytest.raises(MissingColumnError, match="column beta missing, needed for the factors K_beta"):
        compatibility(blind, ("K_beta",))


def test_attitude_of_a_filter_starts_late_and_is_not_believed_to_its_noise(rng: np.random.Generator) -> None:
    """An attitude filter integrates the same gyro: its noise is nil, its error slow, and it needs seconds to find level."""
    f = flight(rng, seconds=20.0, dp=0.002)
    drift = 0.01 * np.sin(2 * np.pi * f.time / 23.0 + 1.0)
    smooth = {a: np.interp(f.time, f.time, savgol_filter(f[a], 31, 3)) for a in ("phi", "theta")}
    filtered = f.with_columns(phi=smooth["phi"] + drift, theta=smooth["theta"] - drift)
    settled = f.time >= 3.0
    late = filtered.with_columns(**{a: np.where(settled, filtered[a], np.nan) for a in ("phi", "theta", "psi")})
    assert attitude_errors(late)["phi"] == 0.01
    result = compatibility(late, ("day", "dp", "K_beta"))
    assert any("t = 0.00 to 3.00 s left out" in n for n in result.flights[0].notes)
    assert np.isnan(result.flights[0].reconstructed[~settled]).all()
    assert result.factors["day"].std_coloured > 0.01  # 0.003 with an attitude measured by itself
    assert abs(result.factors["day"].estimate) < 3 * result.factors["day"].std_coloured


def test_an_attitude_that_is_set_anew_splits_the_record(rng: np.random.Generator) -> None:
    f = flight(rng, seconds=12.0)
    psi = f["psi"] + np.where(f.time < 5.0, 0.0, 2.0)
    psi[40] += 3.0  # a single wild value is no new heading
    jumps = attitude_jumps(f.with_columns(psi=psi))
    assert [float(f.time[j]) for j in jumps] == [5.0]
    assert "psi by 115 deg" in jumps[100]


def test_imu_and_vane_position_are_refused_together_and_one_may_be_given(rng: np.random.Generator) -> None:
    f = flight(rng)
    with pytest.raises(EstimationError, match="x_imu and x_vane cannot be told"):
        compatibility(f, ("x_imu", "x_vane"))
    late = compatibility(f, ("x_vane", "dr"), known={"x_imu": 0.0}).factors["x_vane"]
    assert abs(late.estimate) < 3 * late.std_coloured
    assert late.std_coloured < 0.2


def test_a_missing_channel_is_named(rng: np.random.Generator) -> None:
    f = flight(rng)
    without = Flight.build("f", f.time, {n: v for n, v in f.columns.items() if n != "ay"})
    with pytest.raises(MissingColumnError, match="ay missing"):
        compatibility(without)
    no_beta = Flight.build("f", f.time, {n: v for n, v in f.columns.items() if n not in ("psi", "theta")})
    assert compatibility(no_beta, ("dp", "K_beta")).flights[0].notes


def test_a_time_jump_is_not_integrated_across(rng: np.random.Generator) -> None:
    f = flight(rng, seconds=40.0, **PLANTED)
    jumped = f.time + np.where(f.time > 20.0, 30.0, 0.0)
    moved = {n: v.copy() for n, v in f.columns.items()}
    moved["psi"][f.time > 20.0] += 2.0  # whatever happened in the gap
    moved["V"][f.time > 20.0] += 0.0
    split = Flight.build("split", jumped, moved)
    assert len(split.segments) == 2
    assert np.abs(errors(compatibility(split), PLANTED)).max() < 4.0


def test_corrected_flight_has_no_factors_left(rng: np.random.Generator) -> None:
    f = flight(rng, **PLANTED)
    again = compatibility(correct_flight(f, compatibility(f)))
    for name, factor in again.factors.items():
        neutral = 1.0 if name.startswith("K") else 0.0
        assert abs(factor.estimate - neutral) < 0.3 * factor.std_coloured, name


def test_command_writes_json_as_the_interface_says(tmp_path: Path, rng: np.random.Generator) -> None:
    write_flight(flight(rng, seconds=15.0, **PLANTED), tmp_path / "f.csv")
    done = CliRunner().invoke(check, [str(tmp_path / "f.csv"), "--json", str(tmp_path / "c.json")])
    assert done.exit_code in (0, 1), done.output
    data = json.loads((tmp_path / "c.json").read_text())
    entry = data["flights"][0]
    assert {"dax", "day", "daz", "dp", "dq", "dr", "K_beta", "dbeta"} == set(entry["factors"])
    assert {"estimate", "std"} <= set(entry["factors"]["K_beta"])
    assert {"check", "verdict", "text"} == set(entry["quality"][0])
    assert "K_beta" in done.output


@pytest.mark.parametrize(
    ("speeds", "least"),
    [
        (np.full(200, 3.0), 1.5),  # a model of 50 g in a hall
        (np.linspace(2.2, 3.8, 200), 1.5),
        (np.full(200, 15.0), FLYING),
        (np.r_[np.full(150, 0.3), np.full(50, 3.0)], FLYING),  # a pitot at rest, with wind at times
        (np.full(200, 1.0), FLYING),
    ],
)
def test_a_slow_aircraft_flies_from_half_of_its_speed(speeds: np.ndarray, least: float) -> None:
    assert flies_from(speeds) == pytest.approx(least)
