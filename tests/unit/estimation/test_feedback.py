"""Controls that follow the motion: gains found between steps, kept through de-noising, and only where the model pitches."""

import numpy as np
import pytest

from estimation.engine.kernel import Array
from estimation.models import load_model
from estimation.prepare.flight_data import Preparation
from estimation.prepare.pipeline import prepare
from estimation.signals.controls import ControlStretch, feedback_gains, with_feedback
from estimation.signals.denoise import denoise
from groundstation.flight import Flight

NOISE, GAIN = 0.001, 0.1
TIME = np.arange(600) / 20.0


def control(rng: np.random.Generator, gain: float) -> tuple[Array, Array, Array]:
    """(control with noise, without, pitch rate): doublets, and a rate that rings after each of them by three noises."""
    u, q = np.zeros(TIME.size), np.zeros(TIME.size)
    for start in (2.0, 9.0, 16.0, 23.0):
        after = np.maximum(TIME - start, 0.0)
        u += 0.03 * ((after > 0.0) & (after < 0.4)) - 0.03 * ((after >= 0.4) & (after < 0.8))
        q += 0.03 * np.sin(6.0 * after) * np.exp(-0.6 * after)
    true = u + gain * q
    return true + NOISE * rng.standard_normal(true.size), true, q


def test_what_follows_the_motion_is_kept() -> None:
    slopes, kept, sizes = [], [], []
    for seed in range(10):
        values, true, q = control(np.random.default_rng(seed), GAIN)
        smooth = denoise(values).values
        piece = ControlStretch(values, smooth, q[:, None])
        found = feedback_gains([piece], NOISE)
        assert found is not None
        back, errors = with_feedback(piece, found, NOISE, 24, np.random.default_rng(1))
        slopes.append([float((v - true) @ q / (q @ q)) for v in (smooth, back)])
        kept.append([np.std(v - true) for v in (smooth, back)])
        sizes.append(np.std(errors) / np.std(back - true))
    lost, left = np.mean(slopes, axis=0)
    assert lost < -0.15 * GAIN
    assert abs(left) < 0.05 * GAIN
    assert np.mean(kept, axis=0)[1] < np.mean(kept, axis=0)[0]
    assert 0.6 < np.mean(sizes) < 1.6


def test_a_control_that_follows_nothing_is_left_alone() -> None:
    found = 0
    for seed in range(40):
        values, _, q = control(np.random.default_rng(seed), 0.0)
        found += feedback_gains([ControlStretch(values, denoise(values).values, q[:, None])], NOISE) is not None
    assert found <= 1  # one in a thousand by chance


def test_nothing_to_go_by() -> None:
    flat = np.zeros(30)
    assert feedback_gains([ControlStretch(flat, flat, np.zeros((30, 2)))], NOISE) is None
    assert feedback_gains([], NOISE) is None
    short = np.random.default_rng(1).standard_normal(7) * NOISE
    assert feedback_gains([ControlStretch(short, short, short[:, None])], NOISE) is None


@pytest.mark.parametrize("draws", [0, 24])
def test_only_where_the_model_pitches(draws: int) -> None:
    rng = np.random.default_rng(3)
    values, _, q = control(rng, GAIN)
    still = np.zeros(TIME.size)
    small = {
        n: still + 1e-3 * rng.standard_normal(TIME.size)
        for n in ("beta", "p", "r", "phi", "theta", "alpha", "ax", "ay", "az")
    }
    flight = Flight.build("made", TIME, {
        **small, "q": q + 1e-3 * rng.standard_normal(TIME.size), "V": still + 17.0, "rho": still + 1.2, "thrust": still,
        "delta_e": values, "delta_a": values, "delta_r": still,
    })  # fmt: skip
    for name, column, changes in (("longitudinal", "delta_e", True), ("lateral", "delta_a", False)):
        model = load_model(name, "cdfp")
        at = model.input_names.index(column)
        usual, smooth = (prepare(model, flight, Preparation(draws=draws, feedback=f)) for f in (True, False))
        assert np.array_equal(usual.segments[0].u[:, at], smooth.segments[0].u[:, at]) != changes
        if usual.errors is not None and smooth.errors is not None:
            assert np.array_equal(usual.errors[:, at], smooth.errors[:, at]) != (changes and draws > 0)
        others = [i for i in range(len(model.inputs)) if i != at]
        assert np.array_equal(usual.segments[0].u[:, others], smooth.segments[0].u[:, others])
