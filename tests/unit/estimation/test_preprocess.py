"""De-noising: noise goes, edges stay where they were."""

import numpy as np
import pytest

from estimation.signals.denoise import BLOCK, denoise, denoise_many, noise_level

DEG = np.pi / 180


def steps(rng: np.random.Generator) -> np.ndarray:
    levels = np.repeat([0.0, 5.0, -5.0, 0.0, 4.0, -4.0, 4.0, 0.0], [60, 20, 20, 100, 30, 20, 10, 140]) * DEG
    return levels + np.interp(np.arange(400), np.arange(0, 420, 40), 0.3 * DEG * rng.normal(size=11))


def test_noise_level_of_what_was_measured() -> None:
    """Across lost samples a signal that moves looks noisy; where few are in a row nothing better is known."""
    rng = np.random.default_rng(3)
    values = np.sin(0.6 * np.arange(600)) + 0.02 * rng.standard_normal(600)
    lost = rng.random(600) < 0.3
    whole, seen = noise_level(values), noise_level(np.where(lost, np.nan, values))
    assert seen == pytest.approx(whole, rel=0.15)
    assert noise_level(values[~lost]) > 2.0 * whole
    quiet = 0.02 * rng.standard_normal(600)
    every_other = np.where(np.arange(600) % 2 == 0, quiet, np.nan)
    assert noise_level(every_other) == pytest.approx(0.02, rel=0.15)
    assert noise_level(np.full(600, np.nan)) == 0.0
    assert noise_level(np.array([])) == 0.0


def test_noise_level_ignores_edges() -> None:
    rng = np.random.default_rng(1)
    for sigma in (0.03, 0.07, 0.3):
        assert noise_level(steps(rng) + sigma * DEG * rng.normal(size=400)) == pytest.approx(sigma * DEG, rel=0.2)


@pytest.mark.parametrize("order", [1, 2])
def test_no_step_is_shifted_or_smeared(order: int) -> None:
    rng = np.random.default_rng(2)
    truth = steps(rng)
    noise = 0.1 * DEG
    for _ in range(5):
        done = denoise(truth + noise * rng.normal(size=400), order=order)
        error = done.values - truth
        edges = np.flatnonzero(np.abs(np.diff(truth)) > 2 * DEG)
        near = np.unique(np.concatenate([edges, edges + 1]))
        assert np.abs(error[near]).max() < 3.5 * noise
        assert np.sqrt(np.mean(error**2)) < 0.55 * noise
        # shift of each edge in samples: error summed across it over its height
        for k in edges:
            height = truth[k + 1] - truth[k]
            assert abs(error[k - 2 : k + 4].sum() / height) < 0.15


def test_a_signal_without_noise_is_untouched() -> None:
    truth = np.repeat([0.0, 1.0, -1.0, 0.0], 50)
    assert np.array_equal(denoise(truth).values, truth)
    assert denoise(np.full(40, 3.0)).removed == 0.0


def test_smooth_motion_keeps_its_phase_and_size() -> None:
    rng = np.random.default_rng(3)
    t = np.arange(600) * 0.05
    truth = 3.0 * np.sin(2 * np.pi * 0.5 * t) + 0.5 * np.sin(2 * np.pi * 1.5 * t)
    values = denoise(truth + 0.2 * rng.normal(size=600), order=2).values
    assert np.sqrt(np.mean((values - truth) ** 2)) < 0.19
    gain = values @ truth / (truth @ truth)
    lag = (values - truth) @ np.gradient(truth, t) / (np.gradient(truth, t) @ np.gradient(truth, t))
    assert abs(gain - 1) < 0.02
    assert abs(lag) < 0.004  # s


def test_blocks_join_without_a_seam() -> None:
    rng = np.random.default_rng(4)
    noisy = np.tile(steps(rng), 6) + 0.1 * DEG * rng.normal(size=2400)
    assert noisy.size > 2 * BLOCK
    whole = denoise(noisy).values
    again = denoise_many([noisy[900:1400], noisy])
    assert np.allclose(again[1].values, whole)
    assert np.abs(again[0].values[150:350] - whole[1050:1250]).max() < 0.05 * DEG


def test_noise_removed_is_reported() -> None:
    rng = np.random.default_rng(5)
    done = denoise(steps(rng) + 0.1 * DEG * rng.normal(size=400))
    assert done.noise == pytest.approx(0.1 * DEG, rel=0.2)
    assert 0.7 * done.noise < done.removed < 1.1 * done.noise
