"""Output error against truth, an independent optimiser, and the cases that break estimators."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from estimation.errors import DataError, ModelError
from estimation.estimators.equation_error import equation_error
from estimation.estimators.filter_error import filter_error
from estimation.estimators.gauss_newton import LoopOptions, Status
from estimation.estimators.output_error import OutputErrorOptions, output_error
from estimation.estimators.result import Result
from estimation.models import Parameter, load_model
from estimation.models.base import Model, Signal
from estimation.prepare.pipeline import prepare
from groundstation.flight import Flight
from tests.support.paths import ROOT
from tests.unit.estimation.truth import DEG, NOISE, STRONG, TRUE, Case, fly

LATERAL = load_model("lateral", "cdfp")
PLAIN = {k: v for k, v in NOISE.items() if k in ("beta", "p", "r", "phi", "ay")}


def errors(result: Result, true: dict[str, float] = TRUE) -> np.ndarray:
    """Error over corrected bound of the well-excited derivatives."""
    return np.array([(result.values[n] - true[n]) / result.std_coloured[n] for n in STRONG])


def test_exact_data_gives_the_exact_answer(clean_flight: Flight) -> None:
    result = output_error(LATERAL, clean_flight)
    assert result.converged
    for name in STRONG:
        assert result.values[name] == pytest.approx(TRUE[name], rel=4e-3)


def test_estimates_lie_within_their_bounds(made_flights: list[Flight]) -> None:
    z = np.concatenate([errors(output_error(LATERAL, f)) for f in made_flights])
    assert np.abs(z).max() < 4.0
    assert 0.5 < np.sqrt(np.mean(z**2)) < 1.8


def test_white_noise_bounds_are_right() -> None:
    """Ratio of error to Cramer-Rao bound over seeds; the full statistics are a study."""
    flights, _ = fly(Case(noise=PLAIN, servo=None), np.random.default_rng(2), 12)
    z = []
    for flight in flights:
        r = output_error(LATERAL, flight)
        z.append([(r.values[n] - TRUE[n]) / r.std[n] for n in STRONG])
        # the corrected bound also holds what no sample tells of a control's timing: the derivatives of fast motion have a share
        assert np.median([r.std_coloured[n] / r.std[n] for n in ("CY_beta", "Cn_beta", "Cn_r")]) < 1.25
        assert np.median([r.std_coloured[n] / r.std[n] for n in STRONG]) < 1.6
    assert 0.75 < np.sqrt(np.mean(np.square(z))) < 1.3


def test_coloured_residuals_widen_the_corrected_bound() -> None:
    flights, _ = fly(Case(noise=NOISE, servo=None, gust=0.3), np.random.default_rng(5), 6)
    plain, corrected = [], []
    for flight in flights:
        r = output_error(LATERAL, flight)
        plain.append([(r.values[n] - TRUE[n]) / r.std[n] for n in STRONG])
        corrected.append(errors(r))
    assert np.sqrt(np.mean(np.square(plain))) > 2.5  # Cramer-Rao bounds believe the residuals white
    assert 0.6 < np.sqrt(np.mean(np.square(corrected))) < 1.5


def test_joint_estimate_pools_the_flights(made_flights: list[Flight]) -> None:
    model = LATERAL.with_local("CY_0", "Cl_0", "Cn_0")
    joint = output_error(model, made_flights)
    one = output_error(LATERAL, made_flights[0])
    assert joint.converged
    assert np.abs(errors(joint)).max() < 4.0
    for name in STRONG:
        assert joint.std[name] == pytest.approx(one.std[name] / 2, rel=0.25)  # four flights alike: half the bound
    assert all(set(f.local) == {"CY_0", "Cl_0", "Cn_0"} for f in joint.flights)


def test_arrow_elimination_equals_the_dense_solution(made_flights: list[Flight]) -> None:
    """Covariance of a joint fit against the inverse of the full information matrix."""
    from estimation.engine.simulate import simulate_with_sensitivities

    model = LATERAL.with_local("Cn_0")
    result = output_error(model, made_flights[:2], options=OutputErrorOptions(substeps=4, paths=False))
    shared = [n for n in model.free_names if n != "Cn_0"]
    blocks = []
    for i, flight in enumerate(made_flights[:2]):
        fit = result.flights[i]
        values = {**result.values, "Cn_0": fit.local["Cn_0"].estimate}
        _, dy, dx0 = simulate_with_sensitivities(
            model, prepare(model, flight), values, fit.initial_states[0], substeps=4
        )
        own = np.concatenate([dy[:, :, [model.free_names.index("Cn_0")]], dx0], axis=2)
        wide = np.zeros((*dy.shape[:2], len(shared) + 10))
        wide[:, :, : len(shared)] = dy[:, :, [model.free_names.index(n) for n in shared]]
        wide[:, :, len(shared) + 5 * i : len(shared) + 5 * i + 5] = own
        blocks.append((wide / np.sqrt(np.diag(result.R))[None, :, None]).reshape(-1, wide.shape[2]))
    J = np.concatenate(blocks)
    scale = 1 / np.sqrt(np.sum(J**2, axis=0))
    covariance = np.linalg.inv((J * scale).T @ (J * scale)) * scale[:, None] * scale[None, :]
    for j, name in enumerate(shared):
        assert result.std[name] == pytest.approx(math.sqrt(covariance[j, j]), rel=1e-5)
    assert result.flights[0].local["Cn_0"].std == pytest.approx(
        math.sqrt(covariance[len(shared), len(shared)]), rel=1e-5
    )


def test_full_covariance_fits_at_least_as_well(made_flights: list[Flight]) -> None:
    full = output_error(LATERAL, made_flights[0], options=OutputErrorOptions(noise="full"))
    assert full.converged
    assert np.abs(errors(full)).max() < 4.0
    assert np.abs(full.R - np.diag(np.diag(full.R))).max() > 0


def test_priors_bounds_and_fixed_values_are_respected(made_flights: list[Flight]) -> None:
    flight = made_flights[0]
    fixed = output_error(LATERAL.fixed(Cl_dr=0.0), flight)
    assert fixed.values["Cl_dr"] == 0.0
    assert "Cl_dr" not in fixed.parameters
    tight = output_error(LATERAL.with_prior(Cl_dr=(0.0, 1e-6)), flight)
    assert abs(tight.values["Cl_dr"]) < 1e-5
    assert tight.values["Cl_p"] == pytest.approx(fixed.values["Cl_p"], rel=1e-3)
    limited = output_error(LATERAL.with_starts(Cn_r=-0.02).with_limits(Cn_r=(-0.03, 0.0)), flight)
    assert limited.values["Cn_r"] == pytest.approx(-0.03)
    assert limited.converged


# ------------------------------------------------------------------------------------- independent solutions


def roll_yaw_record(rng: np.random.Generator, count: int = 1500) -> tuple[Flight, dict[str, float]]:
    """A linear two-state record made by scipy, 50 Hz, inputs straight between samples."""
    t = np.arange(count) * 0.02
    u = {
        "beta": 0.05 * np.sin(0.9 * t) + 0.02 * np.sin(2.3 * t + 1),
        "delta_a": np.interp(t, np.arange(0, 31, 0.7), 0.08 * rng.choice([-1, 0, 1], 45)),
        "delta_r": np.interp(t, np.arange(0, 31, 0.9), 0.07 * rng.choice([-1, 0, 1], 35)),
        "beta_dot": 0.045 * np.cos(0.9 * t) + 0.046 * np.cos(2.3 * t + 1) + 0.03 * np.sin(5 * t),
    }
    p = {
        "L_0": 0.02, "L_beta": -12.0, "L_p": -6.0, "L_r": 1.5, "L_da": -40.0, "L_dr": 4.0, "L_betadot": 0.4,
        "N_0": -0.01, "N_beta": 6.0, "N_p": -0.4, "N_r": -0.9, "N_da": 1.0, "N_dr": -7.0, "N_betadot": -0.3,
        "Y_0": 0.05, "Y_beta": -5.0, "Y_p": -0.1, "Y_r": 0.3, "Y_da": 0.2, "Y_dr": 6.0, "bias_p_dot": 0.05,
        "bias_r_dot": -0.03,
    }  # fmt: skip

    def linear(letter: str, x: np.ndarray, v: list[np.ndarray]) -> np.ndarray:
        terms = zip(("beta", "p", "r", "da", "dr", "betadot"), (v[0], x[0], x[1], *v[1:]), strict=True)
        return p[f"{letter}_0"] + sum(p.get(f"{letter}_{n}", 0.0) * q for n, q in terms)

    def rates(time: float, x: np.ndarray) -> list[np.ndarray]:
        v = [np.interp(time, t, w) for w in u.values()]
        return [linear("L", x, v), linear("N", x, v)]

    x = solve_ivp(rates, (0, t[-1]), [0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-11, max_step=0.02).y
    v = list(u.values())
    columns = {
        "p_dot": linear("L", x, v) + p["bias_p_dot"] + 0.05 * rng.normal(size=count),
        "r_dot": linear("N", x, v) + p["bias_r_dot"] + 0.05 * rng.normal(size=count),
        "ay": linear("Y", x, v) + 0.03 * rng.normal(size=count),
        "p": x[0] + 0.005 * rng.normal(size=count),
        "r": x[1] + 0.005 * rng.normal(size=count),
    }
    return Flight.build("roll_yaw", t, {**u, **columns}), p


def test_own_linear_model_equals_an_independent_solution() -> None:
    """Two states, 22 parameters, five outputs: to 0.01 of a bound against scipy with exact discretisation."""
    flight, true = roll_yaw_record(np.random.default_rng(8))
    model = load_model("docs.examples.roll_yaw:RollYaw")
    assert len(model.parameters) == 22
    result = output_error(model, flight, options=OutputErrorOptions(substeps=4))
    assert result.converged
    z = [(e.estimate - true[n]) / e.std for n, e in result.parameters.items()]
    assert np.sqrt(np.mean(np.square(z))) < 1.6
    names = model.parameter_names
    data = prepare(model, flight)
    u, zm = data.segments[0].u, data.segments[0].z
    sigma = np.sqrt(np.diag(result.R))

    def outputs(theta: np.ndarray) -> np.ndarray:
        from scipy.linalg import expm

        q = dict(zip(names, theta, strict=False))
        A = np.array([[q["L_p"], q["L_r"]], [q["N_p"], q["N_r"]]])
        B = np.array([[q[f"{a}_{n}"] for n in ("0", "beta", "da", "dr", "betadot")] for a in "LN"])
        h = 0.02
        block = np.zeros((12, 12))  # x, input, slope of the input: exact for inputs straight between samples
        block[:2, :2], block[:2, 2:7], block[2:7, 7:12] = A, B, np.eye(5) / h
        E = expm(block * h)
        v = np.column_stack([np.ones(len(u)), u])
        x = np.empty((len(u), 2))
        x[0] = theta[-2:]
        for k in range(len(u) - 1):
            x[k + 1] = E[:2, :2] @ x[k] + E[:2, 2:7] @ v[k] + E[:2, 7:12] @ (v[k + 1] - v[k])
        rates = x @ A.T + v @ B.T
        side = v[:, :4] @ np.array([q[f"Y_{n}"] for n in ("0", "beta", "da", "dr")]) + x @ np.array(
            [q["Y_p"], q["Y_r"]]
        )
        biases = [q["bias_p_dot"], q["bias_r_dot"], 0.0, 0.0, 0.0]
        return np.column_stack([rates, side, x]) + biases

    start = np.array([result.values[n] for n in names] + list(result.flights[0].initial_states[0]))
    bounds = np.array([result.std[n] for n in names] + [1e-3, 1e-3])
    nudged = start + 0.5 * bounds * np.random.default_rng(0).choice([-1, 1], start.size)
    found = least_squares(lambda s: ((zm - outputs(s * bounds)) / sigma).ravel(), nudged / bounds, "3-point")
    off = (found.x * bounds - start)[: len(names)] / bounds[: len(names)]
    assert np.abs(off).max() < 0.01


def test_own_longitudinal_model_equals_an_independent_solution() -> None:
    """Four nonlinear states with a drag polar, against scipy's integrator and optimiser."""
    rng = np.random.default_rng(9)
    count, h = 241, 0.05
    t = np.arange(count) * h
    de = np.interp(t, np.arange(0, 13, 0.5), -0.04 + 0.06 * rng.choice([-1, 0, 1], 26))
    u = {"delta_e": de, "thrust": 5.0 + 1.5 * np.sin(0.4 * t), "p_dynamic": 150 + 8 * np.sin(0.5 * t)}
    true = {
        "CL_0": 0.02,
        "CL_alpha": 3.1,
        "CL_q": 2.5,
        "CL_de": 0.9,
        "CD_0": 0.03,
        "CD_k": 0.22,
        "Cm_0": 0.005,
        "Cm_alpha": -0.17,
        "Cm_q": -1.1,
        "Cm_de": -0.33,
    }
    m, S, c, Iyy, g = 3.5, 0.787, 0.61, 0.23, 9.80665

    def coefficients(x: np.ndarray, e: np.ndarray, q: dict[str, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        qh = x[3] * c / 2 / x[0]
        CL = q["CL_0"] + q["CL_alpha"] * x[1] + q["CL_q"] * qh + q["CL_de"] * e
        return CL, q["CD_0"] + q["CD_k"] * CL**2, q["Cm_0"] + q["Cm_alpha"] * x[1] + q["Cm_q"] * qh + q["Cm_de"] * e

    def outputs(q: dict[str, float], x0: np.ndarray) -> np.ndarray:
        def rates(time: float, x: np.ndarray) -> list[float]:
            e, T, pd = (np.interp(time, t, u[n]) for n in ("delta_e", "thrust", "p_dynamic"))
            CL, CD, Cm = coefficients(x, e, q)
            return [
                (T * np.cos(x[1]) - pd * S * CD) / m - g * np.sin(x[2] - x[1]),
                x[3] - (pd * S * CL + T * np.sin(x[1])) / m / x[0] + g / x[0] * np.cos(x[2] - x[1]),
                x[3],
                pd * S * c * Cm / Iyy,
            ]

        x = np.empty((count, 4))
        x[0] = x0
        for k in range(count - 1):  # Runge-Kutta 3/8 rule, four steps a sample: not the engine's formula
            now, step = x[k], h / 4
            for i in range(4):
                at = t[k] + i * step
                k1 = np.array(rates(at, now))
                k2 = np.array(rates(at + step / 3, now + step / 3 * k1))
                k3 = np.array(rates(at + 2 * step / 3, now + step * (k2 - k1 / 3)))
                k4 = np.array(rates(at + step, now + step * (k1 - k2 + k3)))
                now = now + step / 8 * (k1 + 3 * k2 + 3 * k3 + k4)
            x[k + 1] = now
        CL, CD, _ = coefficients(x.T, u["delta_e"], q)
        a = x[:, 1]
        f = u["p_dynamic"] * S / m
        ax = f * (CL * np.sin(a) - CD * np.cos(a)) + u["thrust"] / m
        return np.column_stack([x, ax, -f * (CL * np.cos(a) + CD * np.sin(a))])

    x0 = np.array([16.0, 0.1, 0.1, 0.0])
    noise = np.array([0.1, 0.004, 0.004, 0.006, 0.05, 0.08])
    z = outputs(true, x0) + noise * rng.normal(size=(count, 6))
    columns = dict(zip(("V", "alpha", "theta", "q", "ax", "az"), z.T, strict=True))
    model = load_model("docs.examples.pitch:Pitch", "cdfp")
    result = output_error(model, Flight.build("pitch", t, {**u, **columns}), options=OutputErrorOptions(substeps=4))
    assert result.converged
    assert max(abs(e.estimate - true[n]) / e.std for n, e in result.parameters.items()) < 4.0
    names, sigma = model.parameter_names, np.sqrt(np.diag(result.R))
    used = prepare(model, Flight.build("pitch", t, {**u, **columns})).segments[0].u
    u.update(zip(("delta_e", "thrust", "p_dynamic"), used.T, strict=True))
    bounds = np.array([result.std[n] for n in names] + [0.03, 1e-3, 1e-3, 2e-3])
    start = np.array([result.values[n] for n in names] + list(result.flights[0].initial_states[0])) / bounds

    def misfit(s: np.ndarray) -> np.ndarray:
        v = s * bounds
        return ((z - outputs(dict(zip(names, v, strict=False)), v[-4:])) / sigma).ravel()

    # one exact Gauss-Newton step of the independent residuals must find nothing left to move
    J = np.column_stack([(misfit(start + d) - misfit(start - d)) / 2e-3 for d in 1e-3 * np.eye(start.size)])
    step = np.linalg.lstsq(J, -misfit(start), rcond=None)[0]
    assert np.abs(step[: len(names)]).max() < 0.01


# ------------------------------------------------------------------------------------------- hard cases


def short_period(**starts: float) -> Model:
    """Two states, one of them running away at 0.77 1/s with the true values below."""
    names = ("Z_alpha", "Z_de", "M_alpha", "M_q", "M_de")
    return Model(
        name="short-period",
        states=(Signal("alpha", "rad", "angle of attack"), Signal("q", "rad/s", "pitch rate")),
        inputs=(Signal("delta_e", "rad", "elevator", control=True),),
        outputs=(
            Signal("alpha", "rad", "angle of attack"),
            Signal("q", "rad/s", "pitch rate"),
            Signal("az", "m/s2", "acceleration"),
        ),
        parameters=tuple(Parameter(n, "1/s", start=starts.get(n, 0.0)) for n in names),
        equations=(
            "alpha_dot = q + Z_alpha*alpha + Z_de*delta_e",
            "q_dot = M_alpha*alpha + M_q*q + M_de*delta_e",
            "az = 16.0*(Z_alpha*alpha + Z_de*delta_e)",
        ),
    )


RUNAWAY = {"Z_alpha": -1.2, "Z_de": -0.1, "M_alpha": 3.5, "M_q": -1.0, "M_de": -9.0}


def runaway_flight(rng: np.random.Generator, seconds: float = 24.0) -> Flight:
    """An unstable aircraft held by its pilot (elevator from alpha and q through a servo), every sensor noisy."""
    h, fine = 0.05, 20
    count = round(seconds / h) + 1
    A = np.array([[-1.2, 1.0], [3.5, -1.0]])
    x, e, rows = np.zeros(2), 0.0, []
    for k in range((count - 1) * fine + 1):
        t = k * h / fine
        push = 0.04 * sum(s * (a <= t < a + 0.6) for a, s in ((1, 1), (1.6, -1), (6, -1), (6.6, 1), (13, 1), (18, -1)))
        e += h / fine / 0.06 * (push + 0.9 * x[0] + 0.35 * x[1] - e)
        if k % fine == 0:
            rows.append([x[0], x[1], 16.0 * (-1.2 * x[0] - 0.1 * e), e])
        x = x + h / fine * (A @ x + np.array([-0.1, -9.0]) * e)
    noisy = np.array(rows) + np.array([0.005, 0.007, 0.1, 0.001]) * rng.normal(size=(count, 4))
    columns = dict(zip(("alpha", "q", "az", "delta_e"), noisy.T, strict=True))
    return Flight.build("runaway", np.arange(count) * h, columns)


def test_an_unstable_aircraft_from_nothing_and_from_wrong_signs() -> None:
    flight = runaway_flight(np.random.default_rng(11))
    few = OutputErrorOptions(loop=LoopOptions(iterations=30))
    found = [
        output_error(short_period(**starts), flight, options=few)
        for starts in ({}, {n: -v for n, v in RUNAWAY.items()})
    ]
    for result in found:
        assert result.status is Status.CUT
        for name, value in RUNAWAY.items():
            e = result.parameters[name]
            assert abs(e.estimate - value) < 4.0 * e.std_coloured
            assert e.estimate == pytest.approx(found[0].values[name], abs=0.3 * e.std)


def test_wrong_signs_at_start_end_in_the_right_answer(made_flights: list[Flight]) -> None:
    right = output_error(LATERAL, made_flights[0])
    wrong = output_error(LATERAL, made_flights[0], start={"Cl_p": 0.5, "Cn_beta": -0.03, "Cl_da": 0.1})
    assert wrong.converged
    for name in STRONG:
        assert wrong.values[name] == pytest.approx(right.values[name], abs=0.01 * right.std[name])


def test_parameter_without_effect_is_named(made_flights: list[Flight]) -> None:
    result = output_error(LATERAL.plus(parameters=[Parameter("useless")]), made_flights[0])
    assert result.status is Status.NOT_IDENTIFIABLE
    assert result.parameters["useless"].why == "has no effect on any output in this data"
    assert result.to_json()["parameters"]["useless"]["std"] is None
    assert np.abs(errors(result)).max() < 4.0


def test_tied_parameters_are_not_inverted_silently(made_flights: list[Flight]) -> None:
    """A sideslip output bias is exactly collinear with CY_0, Cl_0 and Cn_0 where the kinematics drop everything else."""
    result = output_error(load_model("lateral-simple", "cdfp").with_biases("beta"), made_flights[0])
    assert result.status is Status.NOT_IDENTIFIABLE
    tied = {n for n, e in result.parameters.items() if "tied exactly" in e.why}
    assert {"bias_beta", "Cl_0"} <= tied <= {"bias_beta", "CY_0", "Cl_0", "Cn_0"}
    assert result.parameters["Cl_p"].identifiable


def test_what_is_five_bounds_from_zero_is_told_however_small_it_was_believed_to_be() -> None:
    """Beliefs a hundred times too small, and noisy sensors: strong derivatives are told, vague ones are not."""
    noise = {name: 8.0 * sigma for name, sigma in NOISE.items()}
    flight = fly(Case(noise=noise), np.random.default_rng(6))[0][0]
    beliefs = [replace(p, reference=0.01 * p.reference if p.reference else p.reference) for p in LATERAL.parameters]
    result = output_error(replace(LATERAL, parameters=tuple(beliefs)), flight)
    told = {n for n, e in result.parameters.items() if e.reference and e.identifiable}
    for name in told:
        assert 0.3 * 0.01 * abs(TRUE[name]) < result.std_coloured[name] <= 0.2 * abs(result.values[name])
    assert {"CY_beta", "CY_dr", "Cl_beta", "Cl_p", "Cl_da", "Cn_beta", "Cn_r", "Cn_dr"} <= told
    assert not told & {"CY_p", "CY_r"}


def test_a_still_rudder_is_said_to_be_still() -> None:
    flight = fly(Case(noise=NOISE, servo=None, rudder=0.0), np.random.default_rng(6))[0][0]
    result = output_error(LATERAL, flight)
    for name in ("CY_dr", "Cl_dr", "Cn_dr"):
        assert not result.parameters[name].identifiable
        assert "delta_r moved only" in result.parameters[name].why
    assert result.parameters["Cl_da"].identifiable


def test_gap_holes_and_dead_channels(made_flights: list[Flight]) -> None:
    f = made_flights[1]
    keep = (f.time < 8) | (f.time > 11)
    columns = {k: v[keep].copy() for k, v in f.columns.items()}
    columns["beta"][100:180] = np.nan
    columns["r"][:] = 0.02
    result = output_error(LATERAL, Flight.build("battered", f.time[keep], columns))
    assert result.converged
    assert len(result.flights[0].initial_states) == 2
    assert "r" not in result.flights[0].fit
    assert any("r stands still" in n.text for n in result.flights[0].notes)
    assert np.abs(errors(result)).max() < 5.0


def test_too_short_a_flight_is_refused_in_words(made_flights: list[Flight]) -> None:
    with pytest.raises(DataError, match="fly longer"):
        output_error(LATERAL.with_biases("p", "r", "phi", "ay"), made_flights[0].part(slice(0, 9)))


def test_unstable_aircraft() -> None:
    true = dict(TRUE, Cn_beta=-0.002, Cn_r=-0.03)
    case = Case(noise=NOISE, servo=None, true=true, aileron=1.5 * DEG, rudder=1.0 * DEG, seconds=9.0)
    flight = fly(case, np.random.default_rng(4))[0][0]
    result = output_error(LATERAL, flight)
    assert result.status.usable
    assert abs(result.values["Cn_beta"] - true["Cn_beta"]) < 4 * result.std_coloured["Cn_beta"] + 3e-4


def test_filter_error_beats_output_error_in_turbulence() -> None:
    flights, _ = fly(Case(noise=NOISE, servo=None, gust=0.8), np.random.default_rng(3), 2)
    off: dict[str, list[float]] = {"ml": [], "fem": []}
    for flight in flights:
        for name, result in (("ml", output_error(LATERAL, flight)), ("fem", filter_error(LATERAL, flight))):
            assert result.converged
            off[name] += [result.values[n] / TRUE[n] - 1 for n in STRONG]
            if name == "fem":
                assert np.abs(errors(result)).max() < 4.5
                assert set(result.extra["gain"]) == {"beta", "p", "r", "phi"}
    assert np.sqrt(np.mean(np.square(off["fem"]))) < 0.5 * np.sqrt(np.mean(np.square(off["ml"])))


def test_equation_error_and_stepwise(made_flights: list[Flight]) -> None:
    result = equation_error(LATERAL, made_flights)
    for name in STRONG:
        assert result.values[name] == pytest.approx(TRUE[name], rel=0.25)
    model = LATERAL.plus(
        terms={"Cn": "Cn_da*delta_a", "Cl": "Cl_beta3*beta^3"}, parameters=[Parameter("Cn_da"), Parameter("Cl_beta3")]
    )
    chosen = equation_error(model, made_flights[0], stepwise=True)
    assert {n for n in STRONG if chosen.std[n] > 0} == set(STRONG)
    assert chosen.values["Cn_da"] == 0.0


def test_finer_steps_are_taken_where_needed() -> None:
    """A mode of 120 rad/s at 20 Hz cannot be integrated with two steps a sample."""
    from estimation.models import Model, Signal

    model = Model(
        "stiff",
        (Signal("x"),),
        (Signal("u"),),
        (Signal("x"),),
        (Parameter("a", "1/s", -60.0), Parameter("g", "1", 1.0)),
        ("x_dot = a*(x - g*u)",),
    )
    t = np.arange(300) * 0.05
    u = np.interp(t, np.arange(0, 16, 0.5), np.random.default_rng(1).normal(size=32))
    fine = np.arange(0, t[-1] + 1e-9, 0.0005)
    uf, x = np.interp(fine, t, u), np.zeros(fine.size)
    for k in range(fine.size - 1):
        x[k + 1] = x[k] + 0.0005 * -120.0 * (x[k] - 2.0 * 0.5 * (uf[k] + uf[k + 1]))
    z = x[::100] + 0.002 * np.random.default_rng(2).normal(size=300)
    result = output_error(model, Flight.build("stiff", t, {"x": z, "u": u}))
    assert result.converged
    assert abs(result.values["a"] + 120.0) < 4 * result.std["a"] + 3.0
    assert result.values["g"] == pytest.approx(2.0, rel=2e-3)


FOREIGN = ROOT / "recordings" / "foreign"


@pytest.mark.skipif(not (FOREIGN / "ordinary_0.csv").is_file(), reason="flights of the other simulator are not here")
def test_flights_of_another_simulator() -> None:
    import json

    from groundstation.flight import read_flight

    key = json.loads((FOREIGN / "key.json").read_text())["ordinary"]["derivatives"]
    flights = [read_flight(p) for p in sorted(FOREIGN.glob("ordinary_*.csv"))]
    each = np.concatenate([errors(output_error(LATERAL, f), key) for f in flights])
    assert np.abs(each).max() < 4.0
    assert np.sqrt(np.mean(each**2)) < 1.4
    joint = output_error(LATERAL.with_local("CY_0", "Cl_0", "Cn_0"), flights)
    assert np.abs(errors(joint, key)).max() < 4.0


def test_names_that_a_model_does_not_have_are_refused(made_flights: list[Flight]) -> None:
    with pytest.raises(ModelError, match=r"free_states: no state 'q'; it has beta, p, r, phi"):
        output_error(LATERAL, made_flights[0], options=OutputErrorOptions(free_states=("p", "q")))
    with pytest.raises(ModelError, match="sigma: none given for output 'p'"):
        output_error(LATERAL, made_flights[0], options=OutputErrorOptions(sigma={"beta": 0.01}))
