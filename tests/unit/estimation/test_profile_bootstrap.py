"""Profile likelihood and parametric bootstrap against closed forms of a linear model with Gaussian noise."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.signal import lfilter

from estimation.errors import EstimationError, ModelError
from estimation.estimators.output_error import OutputErrorOptions, output_error
from estimation.estimators.refits import parametric_bootstrap, profile_likelihood
from estimation.models import Model, Parameter, Signal, write_model
from estimation.prepare.flight_data import Preparation
from groundstation.flight import Flight
from sideslip.verbs.estimate import estimate

SIGMA = 0.05
GIVEN = OutputErrorOptions(sigma={"x": SIGMA}, substeps=4, preparation=Preparation(denoise=False))
COUNT, STEP, POLE = 1600, 0.05, -2.0
LINEAR = Model(
    name="linear",
    states=(Signal("x"),),
    inputs=(Signal("u"),),
    outputs=(Signal("x"),),
    parameters=(Parameter("gain"), Parameter("trim")),
    equations=("x_dot = -2.0*x + gain*u + trim",),
)
TRUE = (1.5, 0.3, 0.2)  # gain, trim, initial state


def columns() -> tuple[np.ndarray, np.ndarray]:
    """(input (N,), responses to unit gain, trim and initial state (N, 3)): exact for inputs straight between samples."""
    t = np.arange(COUNT) * STEP
    u = np.sin(0.8 * t) + 0.5 * np.sin(2.7 * t)
    E = math.exp(POLE * STEP)
    held = (E - 1) / POLE
    ramp = (held - STEP) / (POLE * STEP)
    drive = held * u[:-1] + ramp * np.diff(u)
    H = np.zeros((COUNT, 3))
    H[1:, 0] = lfilter([1.0], [1.0, -E], drive)
    H[1:, 1] = lfilter([1.0], [1.0, -E], np.full(COUNT - 1, held))
    H[:, 2] = E ** np.arange(COUNT)
    return u, H


def record(rng: np.random.Generator, colour: float = 0.0) -> Flight:
    """A flight of known truth; colour: pole of first-order noise of the same standard deviation."""
    u, H = columns()
    white = rng.normal(size=COUNT + 100) * SIGMA * math.sqrt(1 - colour**2)
    noise = lfilter([1.0], [1.0, -colour], white)[100:]
    x = H @ TRUE + noise
    return Flight.build("linear", np.arange(COUNT) * STEP, {"u": u, "x": x})


def options(**changes: Any) -> OutputErrorOptions:
    return replace(GIVEN, **changes)


def test_profile_of_a_linear_model_is_the_closed_form() -> None:
    """Deviance a parabola, interval estimate -+ 1.96 bounds, from the normal equations of an exact discretisation."""
    flight = record(np.random.default_rng(3))
    result = output_error(LINEAR, flight, options=options())
    _, H = columns()
    covariance = np.linalg.inv(H.T @ H) * SIGMA**2
    estimate_ = np.linalg.solve(H.T @ H, H.T @ flight["x"])
    for i, name in enumerate(("gain", "trim")):
        curve = profile_likelihood(LINEAR, flight, name, result, 9, options())
        std = math.sqrt(covariance[i, i])
        wanted = estimate_[i] + 1.959964 * std * np.array([-1, 1])
        assert np.abs(np.array(curve.interval) - wanted).max() < 2e-3 * std
        assert np.allclose(curve.deviance, ((curve.values - estimate_[i]) / std) ** 2, atol=0.02)
        assert curve.text == ""
        ratio = result.std_coloured[name] / result.std[name]
        assert np.ptp(curve.interval_coloured) == pytest.approx(2 * 1.959964 * ratio * std, rel=2e-3)


def test_profile_with_noise_found_from_the_residuals() -> None:
    """R follows: deviance n log(1 + z^2 / n), a hair wider than the bound says."""
    flight = record(np.random.default_rng(4))
    result = output_error(LINEAR, flight, options=options(sigma=None))
    curve = profile_likelihood(LINEAR, flight, "gain", result, 9, options(sigma=None))
    z = (curve.values - curve.estimate) / result.std["gain"]
    assert np.allclose(curve.deviance, COUNT * np.log1p(z**2 / COUNT), atol=1e-3)


def test_profile_respects_limits_and_priors() -> None:
    flight = record(np.random.default_rng(5))
    free = output_error(LINEAR, flight, options=options())
    top = free.values["gain"] + free.std["gain"]
    limited = LINEAR.with_limits(gain=(-9.0, top))
    result = output_error(limited, flight, options=options())
    assert profile_likelihood(limited, flight, "gain", result, 9, options()).interval[1] == pytest.approx(top)
    held = LINEAR.with_prior(gain=(1.5, free.std["gain"]))
    result = output_error(held, flight, options=options())
    assert result.std["gain"] < 0.8 * free.std["gain"]
    curve = profile_likelihood(held, flight, "gain", result, 9, options())
    assert np.ptp(curve.interval) == pytest.approx(2 * 1.959964 * result.std["gain"], rel=5e-3)


def test_profile_of_what_the_data_cannot_see_has_no_end() -> None:
    flight = record(np.random.default_rng(6))
    still = flight.with_columns(u=np.zeros(COUNT))
    result = output_error(LINEAR, still, options=options())
    curve = profile_likelihood(LINEAR, still, "gain", result, 9, options())
    assert curve.interval == (-math.inf, math.inf)
    assert curve.text
    assert json.loads(json.dumps(curve.to_json(), allow_nan=False))["interval"] == [None, None]


@pytest.mark.parametrize("colour", [0.0, 0.8])
def test_bootstrap_spread_is_the_closed_form(colour: float) -> None:
    """Against H+ C H+' with the true noise covariance C, within what 1600 samples tell of its colour (8 %), and against
    the bound made of the same colour, within the Monte-Carlo error of 200 replicates (5 %)."""
    flight = record(np.random.default_rng(7), colour)
    result = output_error(LINEAR, flight, options=options(sigma=None))
    found = parametric_bootstrap(LINEAR, flight, result, 200, np.random.default_rng(1), options(sigma=None))
    _, H = columns()
    lag = np.abs(np.subtract.outer(np.arange(COUNT), np.arange(COUNT)))
    P = np.linalg.pinv(H)[:2]
    true = np.sqrt(np.diag(P @ (SIGMA**2 * np.where(lag == 0, 1.0, colour**lag)) @ P.T))
    white = np.sqrt(np.diag(P @ P.T)) * SIGMA
    for i, name in enumerate(("gain", "trim")):
        spread = found.parameters[name]
        assert spread.std == pytest.approx(true[i], rel=0.25)
        assert spread.std == pytest.approx(result.std_coloured[name], rel=0.15)
        assert np.ptp(spread.interval) == pytest.approx(2 * 1.96 * spread.std, rel=0.2)
        assert abs(spread.bias) < 4 * spread.std / math.sqrt(200)
        assert (spread.std > 1.8 * white[i]) == (colour > 0)
    assert found.failed == 0


def test_same_seed_same_bootstrap() -> None:
    flight = record(np.random.default_rng(8))
    result = output_error(LINEAR, flight, options=options())
    a, b, c = (
        parametric_bootstrap(LINEAR, flight, result, 10, np.random.default_rng(s), options()).estimates
        for s in (1, 1, 2)
    )
    assert np.array_equal(a, b)
    assert np.abs(a - c).min() > 0


def test_too_little_is_refused() -> None:
    flight = record(np.random.default_rng(9))
    result = output_error(LINEAR, flight, options=options())
    with pytest.raises(ModelError, match="no parameter 'gian'"):
        profile_likelihood(LINEAR, flight, "gian", result)
    with pytest.raises(EstimationError, match="at least 5"):
        profile_likelihood(LINEAR, flight, "gain", result, 2)
    with pytest.raises(EstimationError, match="at least 10"):
        parametric_bootstrap(LINEAR, flight, result, 1, np.random.default_rng(0))


def run(*arguments: str | Path) -> Any:
    return CliRunner().invoke(estimate, [str(a) for a in arguments], standalone_mode=False)


def test_from_the_command_line(tmp_path: Path) -> None:
    from groundstation.flight import write_flight

    flight, model, answer = tmp_path / "f.csv", tmp_path / "m.toml", tmp_path / "e.json"
    write_flight(record(np.random.default_rng(10)), flight)
    write_model(LINEAR, model)
    texts = []
    for _ in range(2):
        out = run(
            flight, "--model", model, "--profile", "gain,trim", "--bootstrap", "12", "--seed", "5", "--json", answer
        )
        assert out.exception is None
        assert "profile gain: 95 %" in out.output
        assert "bootstrap, 12 replicates" in out.output
        texts.append(answer.read_text())
    assert texts[0] == texts[1]
    ml = json.loads(texts[0])["flights"][0]["methods"]["ml"]
    assert set(ml["profile"]) == {"gain", "trim"}
    assert ml["bootstrap"]["replicates"] == 12
    assert set(ml["bootstrap"]["parameters"]["gain"]) == {"std", "bias", "interval"}
    for wrong, said in (
        (("--profile", "gian"), "no parameter 'gian'"),
        (("--bootstrap", "3"), "at least 10"),
        (("--method", "ls", "--profile", "gain"), "add ml to --method"),
    ):
        error = run(flight, "--model", model, *wrong).exception
        assert isinstance(error, EstimationError)
        assert said in str(error)
        assert "\n" not in str(error)
