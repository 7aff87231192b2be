"""What noisy inputs add to a prediction: closed forms, and what must hold whatever the aircraft."""

import math
from dataclasses import replace

import numpy as np
import pytest

from estimation.aircraft import load_aircraft
from estimation.design import measured_inputs
from estimation.design.design import DesignTask, InputDesign, design
from estimation.design.measured_inputs import _scatter, expected_errors
from estimation.models import load_model

AIRCRAFT = load_aircraft("cdfp")
LATERAL = load_model("lateral", AIRCRAFT)


@pytest.fixture(scope="module")
def steps() -> InputDesign:
    return design(LATERAL, AIRCRAFT, DesignTask("doublet", 12.0, 16.0, draws=10))


def test_one_gain_with_a_noisy_input_scatters_as_the_closed_form() -> None:
    """y = k u, u measured with noise s: the estimate's variance is (sigma^2 + k^2 s^2) / sum u^2."""
    rng = np.random.default_rng(3)
    gain, sigma, noise = 2.0, 0.3, 0.25
    u = rng.normal(size=500)
    shown = [(gain * noise * rng.normal(size=u.size))[:, None] for _ in range(4000)]
    within = np.mean([d.T @ d / len(d) for d in shown], axis=0)
    std = _scatter(u[:, None, None], np.array([[sigma**2]]), within, shown)
    assert std[0] == pytest.approx(math.sqrt((sigma**2 + (gain * noise) ** 2) / np.sum(u**2)), rel=0.03)


def test_what_wanders_slowly_hurts_what_is_slow() -> None:
    """The same variance within a sample, the same in all samples of a flight: a constant is told 20 times worse, not a sine."""
    rng = np.random.default_rng(5)
    t = np.arange(400) / 20
    sensitivities = np.stack([np.ones(t.size), np.sin(2 * np.pi * t)], axis=-1)[:, None, :]
    offsets = [np.full((t.size, 1), rng.normal()) for _ in range(3000)]
    white = [rng.normal(size=(t.size, 1)) for _ in range(3000)]
    own, within = np.array([[1e-6]]), np.array([[1.0]])
    slow, fast = _scatter(sensitivities, own, within, offsets), _scatter(sensitivities, own, within, white)
    assert slow[0] / fast[0] == pytest.approx(math.sqrt(t.size), rel=0.05)
    assert slow[1] < 0.01 * fast[1]


def test_exact_inputs_leave_the_bound(steps: InputDesign, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measured_inputs, "input_noise", lambda setting, signal: 0.0)
    bounds = steps.best.information.std
    exact = expected_errors(steps.setting, steps.best.motion, bounds, seed=1, draws=3)
    for name, bound in bounds.items():
        assert exact[name] == pytest.approx(bound, rel=0.03), name


def test_noisy_inputs_are_told_and_more_of_them_is_worse(steps: InputDesign) -> None:
    usual = steps.expected
    rough = replace(steps.setting, noise={"delta_a": math.radians(0.7), "delta_r": math.radians(0.7)})
    worse = expected_errors(rough, steps.best.motion, steps.best.information.std, seed=1, draws=10)
    for name, bound in steps.best.information.std.items():
        assert usual[name] > 0.97 * bound, name
    assert worse["Cl_da"] > 3.0 * usual["Cl_da"]


def test_noise_that_residuals_showed_is_not_counted_twice(steps: InputDesign) -> None:
    """A flight's residuals hold the noise of its inputs already."""
    found = replace(steps.setting, noise_of_residuals=True)
    once = expected_errors(found, steps.best.motion, steps.best.information.std, seed=1, draws=10)
    assert once["Cl_p"] < steps.expected["Cl_p"]
