"""Whitening, projection and gap arithmetic against closed forms and brute force."""

import numpy as np
import pytest

from estimation.gap.answer.result import Gap
from estimation.gap.criteria import AS_SET
from estimation.gap.effects import catalogue
from estimation.gap.fit.noise import (
    NoiseModel,
    NoisePart,
    NoiseSource,
    Shapes,
    estimate_noise,
    spectral_matrix,
    whitener,
)
from estimation.gap.fit.whitener import Slack, Whitener, spectrum_of
from estimation.gap.search.select import credible_set, leading
from estimation.gap.significance.calibration import upper_quantile
from estimation.gap.significance.screen import Hypothesis, HypothesisColumn, Screen, equivalent_z

A = NoisePart(NoiseSource.RATE, "a")


def low_pass_shape(count: int, step: float, tau: float) -> np.ndarray:  # type: ignore[type-arg]
    s = 2j * np.pi * np.fft.rfftfreq(count, step)
    return np.stack([1 / (1 + tau * s), 0.5 / (1 + tau * s)], axis=1)


def draw(noise: NoiseModel, shapes: Shapes, rng: np.random.Generator) -> np.ndarray:  # type: ignore[type-arg]
    """A record with exactly the spectral matrix of the model (circular)."""
    root = np.linalg.cholesky(spectral_matrix(noise, shapes))
    white = np.fft.rfft(rng.standard_normal((shapes.count, 2)), axis=0)[:, :, None]
    return np.fft.irfft((root @ white)[:, :, 0], n=shapes.count, axis=0)


def test_whitened_rows_keep_length_and_whitened_series_are_white() -> None:
    rng = np.random.default_rng(0)
    noise = NoiseModel(np.array([1.0, 4.0]), {A: 30.0})
    shapes = Shapes({A: low_pass_shape(400, 0.05, 0.5)}, 400, 0.05)
    w = whitener(noise, shapes)
    rows = np.concatenate([w.rows(draw(noise, shapes, rng)) for _ in range(40)])
    assert np.mean(rows**2) * rows.shape[0] / (40 * 800) == pytest.approx(1.0, abs=0.02)
    series = w.series(draw(noise, shapes, rng))
    lag = np.mean(series[1:] * series[:-1], axis=0) / np.mean(series**2, axis=0)
    assert np.all(np.abs(lag) < 0.15)


def test_identity_whitener_is_parseval() -> None:
    rng = np.random.default_rng(1)
    for count in (40, 41):
        w = Whitener(np.tile(np.eye(3, dtype=complex), (count // 2 + 1, 1, 1)), count)
        x = rng.standard_normal((count, 3))
        assert np.sum(w.rows(x) ** 2) == pytest.approx(np.sum(x**2))


@pytest.mark.parametrize("shape", [(601, 5, 31), (40, 3, 2), (41, 1, 1), (7, 2, 70), (40, 3, 0)])
def test_spectra_of_columns_in_pairs_are_those_of_each(shape: tuple[int, int, int]) -> None:
    x = np.random.default_rng(2).standard_normal(shape)
    expected = np.fft.rfft(x, axis=0)
    np.testing.assert_allclose(spectrum_of(x), np.concatenate([expected.real, expected.imag], axis=1), atol=1e-12)


def test_a_column_keeps_its_digits_beside_a_large_one_and_zeros_stay_zeros() -> None:
    x = np.random.default_rng(6).standard_normal((61, 1, 4)) * np.array([1e9, 1e6, 1e-9, 0.0])
    expected, found = np.fft.rfft(x, axis=0)[:, 0], spectrum_of(x)
    for column, size in enumerate((1e9, 1e6, 1e-9)):
        np.testing.assert_allclose(found[:, 0, column], expected[:, column].real, atol=1e-13 * size)
        np.testing.assert_allclose(found[:, 1, column], expected[:, column].imag, atol=1e-13 * size)
    assert not found[:, :, 3].any()


def test_what_was_not_measured_counts_as_zero() -> None:
    x = np.random.default_rng(3).standard_normal((20, 2))
    holed = x.copy()
    holed[5, 1], x[5, 1] = np.nan, 0.0
    np.testing.assert_array_equal(spectrum_of(holed), spectrum_of(x))


def test_noise_strengths_are_recovered() -> None:
    rng = np.random.default_rng(2)
    truth = NoiseModel(np.array([1.0, 2.0]), {A: 20.0})
    shapes = [Shapes({A: low_pass_shape(600, 0.05, 0.5)}, 600, 0.05)] * 6
    found = estimate_noise([draw(truth, s, rng) for s in shapes], shapes, np.array([3.0, 3.0]), np.array([0.1, 0.1]))
    np.testing.assert_allclose(found.measurement, truth.measurement, rtol=0.1)
    assert found.process[A] == pytest.approx(20.0, rel=0.25)


def test_what_is_known_of_a_control_is_not_estimated_and_what_else_there_is_is_not_booked_on_it() -> None:
    """Two parts of the same shape, one of which has a known strength: the free one gets what is beyond it."""
    rng = np.random.default_rng(4)
    known, shape = NoisePart(NoiseSource.PREPARED, "u"), low_pass_shape(600, 0.05, 0.5)
    truth = NoiseModel(np.array([1.0, 2.0]), {A: 20.0, known: 1.0})
    shapes = [Shapes({A: shape, known: np.sqrt(30.0) * shape}, 600, 0.05)] * 6
    found = estimate_noise([draw(truth, s, rng) for s in shapes], shapes, np.array([3.0, 3.0]), np.array([0.1, 0.1]))
    assert found.process[known] == 1.0
    assert found.process[A] == pytest.approx(20.0, rel=0.4)


def screen_of(rows: list[np.ndarray], n: int, k: int, flights: tuple[int, ...]) -> Screen:  # type: ignore[type-arg]
    columns = tuple(HypothesisColumn(i, None) for i in range(k))  # type: ignore[arg-type]
    reduced = tuple(r.T @ r for r in rows)
    size = rows[0].shape[1]
    return Screen(tuple(f"t{i}" for i in range(n)), (None,) * k, columns, reduced, np.zeros((size, size)), flights)  # type: ignore[arg-type]


def test_gain_equals_brute_force_least_squares() -> None:
    rng = np.random.default_rng(3)
    n, k = 4, 3
    rows = [rng.standard_normal((120, n + k + 1)) for _ in range(3)]
    rows = [np.column_stack([r[:, :-1], r[:, -1] + 0.4 * r[:, n]]) for r in rows]
    projected = screen_of(rows, n, k, (0, 1, 2)).projected()
    X, y = np.concatenate(rows)[:, :-1], np.concatenate(rows)[:, -1]

    def cost(index: list[int]) -> float:
        return float(np.sum((y - X[:, index] @ np.linalg.lstsq(X[:, index], y, rcond=None)[0]) ** 2))

    base = list(range(n))
    for subset in ([0], [1], [0, 2], [0, 1, 2]):
        assert projected.gain(subset) == pytest.approx(cost(base) - cost(base + [n + i for i in subset]), rel=1e-6)
    assert projected.scores()[0, 0] ** 2 == pytest.approx(projected.gain([0]), rel=1e-6)


def test_cross_gain_is_positive_for_what_repeats_and_not_for_chance() -> None:
    rng = np.random.default_rng(4)
    real, chance = [], []
    for _ in range(60):
        rows = [rng.standard_normal((200, 4)) for _ in range(3)]
        chance.append(screen_of(rows, 2, 1, (0, 1, 2)).cross_gain(0))
        with_effect = [np.column_stack([r[:, :3], r[:, 3] + 0.5 * r[:, 2]]) for r in rows]
        real.append(screen_of(with_effect, 2, 1, (0, 1, 2)).cross_gain(0))
    assert min(r for r in real if r is not None) > 0
    assert np.mean([c for c in chance if c is not None]) < 0
    assert screen_of([rows[0]], 2, 1, (0,)).cross_gain(0) is None


def test_equivalent_z_of_several_unknowns_keeps_the_probability() -> None:
    assert equivalent_z(9.0, 1) == pytest.approx(3.0)
    assert equivalent_z(5.991, 2) == pytest.approx(1.96, abs=1e-3)  # chi-square with 2, 95 %
    assert equivalent_z(400.0, 2) == pytest.approx(19.8, abs=0.2)


def test_gap_closed_by_hand() -> None:
    assert Gap(5.1, 1.1, 1.0).closed == pytest.approx(1 - 0.21 / 25.01)
    assert Gap(2.0, 0.9, 1.0).closed == 1.0
    assert Gap(2.0, 2.5, 1.0).closed == 0.0
    assert Gap(0.95, 0.9, 1.0).closed == 1.0
    assert Gap(0.9, 0.95, 1.0).closed == 0.0
    assert Gap(0.9, 1.2, 1.0).closed == 0.0


def test_credible_set_is_the_smallest_with_the_share() -> None:
    assert credible_set({"a": 0.97, "b": 0.03}, AS_SET) == [("a", 0.97)]
    assert [n for n, _ in credible_set({"a": 0.6, "b": 0.36, "c": 0.04}, AS_SET)] == ["a", "b"]


def test_upper_quantile_is_never_below_the_samples_own() -> None:
    values = np.random.default_rng(5).gumbel(3.0, 0.3, 4000)
    assert upper_quantile(values, 0.95) >= np.quantile(values, 0.95)
    assert upper_quantile(values, 0.95) == pytest.approx(3.0 - 0.3 * np.log(-np.log(0.95)), abs=0.08)


def test_of_the_catalogue_the_lag_of_the_air_alone_gets_a_full_fit_whatever_it_promises() -> None:
    """And nothing else does: a stall far from any would be bent to the noise of every flight."""
    hypotheses = tuple(Hypothesis(e, f) for e in catalogue() for f in e.forms)
    columns = tuple(HypothesisColumn(h, p) for h, x in enumerate(hypotheses) for p in x.form.parameters)
    k = len(columns)
    screen = Screen((), hypotheses, columns, (np.eye(k + 1),), np.zeros((k + 1, k + 1)), (0,))
    (lag,) = (h for h, x in enumerate(hypotheses) if x.effect.name == "indicial_lag")
    assert leading(screen, np.zeros(len(hypotheses)), 4.0, AS_SET) == [lag]
    first, second = [h for h in range(3) if h != lag][:2]
    promised = np.zeros(len(hypotheses))
    promised[[first, second]] = 100.0, 90.0
    assert leading(screen, promised, 4.0, AS_SET) == [first, second, lag]
    promised[lag] = 200.0
    assert leading(screen, promised, 4.0, AS_SET) == [lag, first, second], "and once only"


@pytest.mark.parametrize("count", [9, 10])
@pytest.mark.parametrize("forgiving", [False, True])
def test_the_determinant_is_that_of_the_covariance_which_energies_are_by(count: int, forgiving: bool) -> None:
    rng, ny = np.random.default_rng(count), 2
    half = rng.standard_normal((count // 2 + 1, ny, ny)) + 1j * rng.standard_normal((count // 2 + 1, ny, ny))
    half[[0, -1] if count % 2 == 0 else [0]] = half[[0, -1] if count % 2 == 0 else [0]].real
    values, vectors = np.linalg.eigh(half @ half.conj().transpose(0, 2, 1) + np.eye(ny))
    root = (vectors / np.sqrt(values)[:, None, :]) @ vectors.conj().transpose(0, 2, 1)
    whitener = Whitener(root, count)
    if forgiving:
        whitener = Whitener(root, count, Slack(whitener.rows(rng.standard_normal((count, ny, 3)))))
    precision = whitener.gram(np.eye(count * ny).reshape(count, ny, count * ny))
    assert whitener.log_determinant == pytest.approx(-np.linalg.slogdet(precision)[1], rel=1e-9)
