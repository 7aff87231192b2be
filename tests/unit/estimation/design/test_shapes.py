"""Input shapes against closed forms."""

import math

import numpy as np
import pytest

from estimation.design.shapes import (
    Multisine,
    chirp,
    deal,
    equal_shares,
    low_peak_multisine,
    pattern,
    relative_peak_factor,
    shifted_to_zero_crossings,
    wave_columns,
)

FINE = np.linspace(0.0, 20.0, 20_001)[:-1]


@pytest.fixture(scope="module")
def waves() -> list[Multisine]:
    rng = np.random.default_rng(1)
    return [low_peak_multisine(20.0, h, equal_shares(h.size), rng) for h in deal(3, 20.0, (0.1, 1.5))]


class TestMultisines:
    def test_peaks_are_as_low_as_the_best_published(self, waves: list[Multisine]) -> None:
        for wave in waves:
            assert relative_peak_factor(wave.values(FINE)) < 1.1

    def test_controls_are_orthogonal_over_a_period(self, waves: list[Multisine]) -> None:
        u = wave_columns(waves, FINE)
        product = u.T @ u / len(u)
        np.testing.assert_allclose(product, np.eye(3), atol=1e-9)

    def test_no_harmonic_is_shared_and_power_stays_within_three_decibels(self, waves: list[Multisine]) -> None:
        harmonics = np.concatenate([w.harmonics for w in waves])
        assert np.unique(harmonics).size == harmonics.size
        assert (harmonics.min(), harmonics.max()) == (2, 30)
        for wave in waves:
            assert wave.amplitudes.max() / wave.amplitudes.min() <= 10 ** (6.01 / 20)

    def test_they_begin_and_end_at_zero(self, waves: list[Multisine]) -> None:
        for wave in waves:
            np.testing.assert_allclose(wave.values(np.array([0.0, 20.0])), 0.0, atol=1e-9)

    def test_every_shift_begins_at_zero_and_keeps_the_peak(self, waves: list[Multisine]) -> None:
        before = relative_peak_factor(waves[0].values(FINE))
        for shifted in shifted_to_zero_crossings(waves[0])[:5]:
            assert abs(float(shifted.values(np.zeros(1))[0])) < 1e-9
            assert relative_peak_factor(shifted.values(FINE)) == pytest.approx(before, abs=2e-3)

    def test_slope_is_the_derivative(self, waves: list[Multisine]) -> None:
        up, down = waves[1].values(np.array([3.7 + 1e-6])), waves[1].values(np.array([3.7 - 1e-6]))
        assert waves[1].slope(3.7) == pytest.approx(float(up[0] - down[0]) / 2e-6, rel=1e-6)

    def test_too_short_a_time_is_said(self) -> None:
        with pytest.raises(ValueError, match="only 1 harmonics"):
            deal(2, 1.0, (0.5, 1.5))


def test_peak_factor_of_one_sine_is_one() -> None:
    assert relative_peak_factor(np.sin(2 * math.pi * 0.05 * FINE)) == pytest.approx(1.0, abs=1e-6)
    assert math.isnan(relative_peak_factor(np.zeros(5)))


def test_doublet_has_its_areas_whatever_the_rate() -> None:
    time = np.arange(0.0, 5.0, 1e-3)
    for rate in (1e6, 2.0, 1.0):
        u = pattern("doublet", time, 1.0, 0.5, 0.1, rate)
        lost = 0.1**2 / (2 * rate)  # the ramp through zero takes a triangle of each lobe
        assert np.trapezoid(u[time < 1.5], time[time < 1.5]) == pytest.approx(0.05 - lost, abs=2e-4)
        assert np.trapezoid(u, time) == pytest.approx(0.0, abs=1e-9)
        assert np.abs(np.diff(u)).max() <= rate * 1e-3 * 1.001
        assert np.abs(u).max() == pytest.approx(0.1)


def test_three_two_one_one_has_widths_in_its_name() -> None:
    time = np.arange(0.0, 9.0, 1e-3)
    u = pattern("3211", time, 1.0, 1.0, 1.0, 1e6)
    signs = np.sign(u[np.abs(u) > 0.5])
    lengths = np.diff(np.flatnonzero(np.concatenate([[1], np.diff(signs), [1]]))) * 1e-3
    np.testing.assert_allclose(lengths, [3.0, 2.0, 1.0, 1.0], atol=5e-3)


def test_chirp_sweeps_its_band_and_fades() -> None:
    time = np.arange(0.0, 30.0, 1e-3)
    u = chirp(time, 2.0, 25.0, (0.1, 2.0), 0.05)
    assert np.all(u[(time < 2.0) | (time > 27.0)] == 0.0)
    assert np.abs(u).max() == pytest.approx(0.05, rel=1e-3)
    crossings = time[1:][np.diff(np.signbit(u)) & (np.abs(u[1:]) + np.abs(u[:-1]) > 0)]
    periods = 2.0 * np.diff(crossings[1:])
    assert periods[0] > 3.5
    assert np.all(np.diff(periods) < 0.0)
    assert 1.0 / periods[-1] == pytest.approx(2.0, rel=0.1)
