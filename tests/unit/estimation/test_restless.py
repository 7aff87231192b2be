"""Controls that never rest: their noise, whether de-noising helps, and how they are prepared.

The right answer is known here: the course without noise.
"""

import numpy as np
import pytest

from estimation.engine.kernel import Array
from estimation.estimators.input_path import clocked_controls
from estimation.prepare.flight_data import Preparation
from estimation.prepare.pipeline import prepare
from estimation.signals.denoise import (
    denoise_many,
    finest_noise_level,
    moving_share,
    noise_level,
    wiener,
    worth_denoising,
)
from groundstation.flight import Flight
from tests.unit.estimation.gap.roll import ROLL

RATE, SECONDS, NOISE = 20.0, 30.0, 0.07  # Hz, s, deg
TIME = np.arange(round(RATE * SECONDS)) / RATE


def servo(course: Array) -> Array:
    """A course sampled every millisecond, behind a servo of 35 ms, at the samples."""
    arm, result = 0.0, np.empty(course.size)
    for k, wanted in enumerate(course):
        result[k] = arm
        arm += 1e-3 / 0.035 * (wanted - arm)
    return result[:: round(1e3 / RATE)]


def course(kind: str, rng: np.random.Generator) -> Array:
    """(600,) a control [deg] as it moved."""
    time = np.arange(round(SECONDS * 1e3)) * 1e-3
    if kind == "multisine":
        lines = [np.sin(2.0 * np.pi * 0.1 * f * time + rng.uniform(0.0, 6.3)) for f in np.arange(1, 26, 2)]
        return servo(np.sum(lines, axis=0))
    if kind == "random steps":
        return servo(rng.choice([-4.0, 0.0, 4.0], 101)[(time / 0.3).astype(int)])
    doublets = np.zeros(time.size)
    for start in np.arange(2.0, 28.0, 5.0) + rng.uniform(-0.5, 0.5, 6):
        doublets += 4.0 * ((time >= start) & (time < start + 0.5)) - 4.0 * (
            (time >= start + 0.5) & (time < start + 1.0)
        )
    return servo(doublets)


KINDS = ("doublets", "multisine", "random steps")


@pytest.mark.parametrize(("kind", "highest"), [("doublets", 1.1), ("multisine", 1.1), ("random steps", 1.25)])
def test_the_noise_of_a_control_is_found_although_it_never_rests(kind: str, highest: float) -> None:
    rng = np.random.default_rng(5)
    found = [finest_noise_level(course(kind, rng) + NOISE * rng.standard_normal(TIME.size)) / NOISE for _ in range(8)]
    assert 0.9 < np.median(found) < highest
    if kind != "doublets":
        assert noise_level(course(kind, rng) + NOISE * rng.standard_normal(TIME.size)) > 1.3 * NOISE


def test_a_course_without_noise_has_hardly_any() -> None:
    assert finest_noise_level(course("multisine", np.random.default_rng(1))) < 0.05 * NOISE
    assert finest_noise_level(np.zeros(100)) == 0.0
    assert finest_noise_level(np.ones(3)) == 0.0


@pytest.mark.parametrize("kind", KINDS)
def test_de_noising_is_worth_it_where_it_comes_nearer_the_truth(kind: str) -> None:
    rng = np.random.default_rng(7)
    for _ in range(5):
        true = course(kind, rng)
        measured = true + NOISE * rng.standard_normal(true.size)
        (denoised,) = denoise_many([measured], draws=24, rng=rng)
        nearer = np.mean((denoised.values - true) ** 2) < np.mean((measured - true) ** 2)
        assert nearer is np.bool_(kind == "doublets")
        assert worth_denoising(denoised, finest_noise_level(measured)) == nearer


def test_a_control_that_rests_between_its_moves_does_so_in_half_of_its_samples() -> None:
    rng = np.random.default_rng(9)
    shares = {kind: moving_share(course(kind, rng) + NOISE * rng.standard_normal(TIME.size), NOISE) for kind in KINDS}
    assert shares["doublets"] < 0.45
    assert shares["random steps"] > 0.6
    assert shares["multisine"] > 0.95


def test_doublets_whose_noise_was_filtered_on_the_way_are_not_restless() -> None:
    """Filtered noise looks smaller than it is, and de-noising worse than nothing."""
    rng = np.random.default_rng(4)
    white = rng.standard_normal(TIME.size + 1)
    coloured = NOISE * (white[:-1] + white[1:]) / 2.0**0.5
    measured = course("doublets", rng) + coloured
    (denoised,) = denoise_many([measured], draws=24, rng=rng)
    assert not worth_denoising(denoised, finest_noise_level(measured))
    assert prepare(ROLL, flown("doublets").with_columns(delta_a=np.radians(measured))).restless == frozenset()


def flown(kind: str) -> Flight:
    rng = np.random.default_rng(11)
    aileron = np.radians(course(kind, rng) + NOISE * rng.standard_normal(TIME.size))
    return Flight.build("f", TIME, {"delta_a": aileron, "p": 0.1 * rng.standard_normal(TIME.size)})


@pytest.mark.parametrize("draws", [0, 24])
def test_a_control_that_never_rests_is_filtered_in_cosines(draws: int) -> None:
    restless, resting = flown("multisine"), flown("doublets")
    data = prepare(ROLL, restless, Preparation(draws=draws))
    assert data.restless == {"delta_a"}
    found = data.noise["delta_a"][0]
    np.testing.assert_array_equal(data.segments[0].u[:, 0], wiener(restless["delta_a"], found).values)
    assert found == pytest.approx(np.radians(NOISE), rel=0.1)
    other = prepare(ROLL, resting, Preparation(draws=draws))
    assert other.restless == frozenset()
    assert other.noise["delta_a"][1] > 0.5 * np.radians(NOISE)


@pytest.mark.parametrize(("kind", "most"), [("multisine", 0.85), ("random steps", 1.02)])
def test_the_filtered_control_is_nearer_the_truth_and_its_error_is_not_correlated_with_it(
    kind: str, most: float
) -> None:
    """As noise does to a measured input, an error that is correlated with it would make every derivative by it too small."""
    rng, errors, attenuation, drawn = np.random.default_rng(8), [], [], []
    for _ in range(20):
        true = course(kind, rng)
        measured = true + 2.0 * NOISE * rng.standard_normal(true.size)
        filtered = wiener(measured, 2.0 * NOISE, 24, rng)
        errors.append(np.std(filtered.values - true) / np.std(measured - true))
        attenuation.append((filtered.values - true) @ filtered.values / (filtered.values @ filtered.values))
        drawn.append(np.std(filtered.errors) / np.std(filtered.values - true))
    assert np.mean(errors) < most
    noise_alone = (2.0 * NOISE) ** 2 / np.mean(measured**2)
    assert abs(np.mean(attenuation)) < 0.2 * noise_alone
    assert np.mean(drawn) == pytest.approx(1.0, abs=0.15)


def test_a_signal_without_noise_or_motion_is_left_alone() -> None:
    true = course("multisine", np.random.default_rng(1))
    np.testing.assert_allclose(wiener(true, 0.0).values, true, atol=1e-12)
    np.testing.assert_allclose(wiener(np.full(200, 3.0), 0.1).values, 3.0)


def test_draws_of_the_error_of_a_prepared_control_have_its_size() -> None:
    data = prepare(ROLL, flown("random steps"), Preparation(draws=24))
    assert data.errors is not None
    assert np.std(data.errors[:, 0]) == pytest.approx(data.noise["delta_a"][0], rel=0.05)


def test_random_steps_on_the_clock_are_seen_to_begin_alike() -> None:
    """Otherwise the share of a step that a servo makes in its first interval bends all derivatives by the control alike."""
    rng = np.random.default_rng(3)
    clocked = prepare(ROLL, flown("random steps"))
    assert clocked.restless == {"delta_a"}
    assert clocked_controls(ROLL, [clocked]) == ("delta_a",)
    time = np.arange(round(SECONDS * 1e3)) * 1e-3
    anywhere = servo(rng.choice([-4.0, 0.0, 4.0], 101)[(time / 0.3137).astype(int)]) + NOISE * rng.standard_normal(
        TIME.size
    )
    free = prepare(ROLL, flown("random steps").with_columns(delta_a=np.radians(anywhere)))
    assert clocked_controls(ROLL, [free]) == ()
