import numpy as np
import pytest

from groundstation.calibration.align import by_stamp, completeness, derivative, hold, runs, to_scan_time, undo_lag

PERIOD = 0.05


def test_smooth_motion_is_brought_to_the_scan_time() -> None:
    """A 1 Hz sine read 7 ms late: the shift would be 4.4 % of the amplitude, the cubic leaves a thousandth."""
    time = np.arange(200) * PERIOD
    number = np.arange(200)
    late = np.sin(2 * np.pi * (time + 0.007))
    out = to_scan_time(late, time + 0.007, time, number, smooth=True)
    assert np.max(np.abs(out - np.sin(2 * np.pi * time))[1:]) < 1.5e-3
    linear = to_scan_time(late, time + 0.007, time, number, smooth=False)
    assert np.max(np.abs(linear - np.sin(2 * np.pi * time))[1:]) < 0.008


def test_samples_at_the_scan_time_pass_unchanged() -> None:
    values = np.random.default_rng(1).standard_normal(50)
    time = 3.0 + np.arange(50) * PERIOD
    np.testing.assert_array_equal(to_scan_time(values, time, time, np.arange(50), smooth=True), values)


@pytest.mark.parametrize("smooth", [True, False])
def test_nothing_is_bridged(smooth: bool) -> None:
    """A step hidden in a gap: values on either side show their own side only."""
    number = np.concatenate([np.arange(20), np.arange(40, 60)])
    time = number * PERIOD
    values = np.where(number < 30, 1.0, 5.0)
    out = to_scan_time(values, time + 0.01, time, number, smooth=smooth)
    np.testing.assert_allclose(out, values, rtol=1e-12)


def test_missing_value_ends_a_run() -> None:
    values = np.arange(10.0)
    values[5] = np.nan
    out = to_scan_time(values, np.arange(10) * PERIOD, np.arange(10) * PERIOD, np.arange(10), smooth=True)
    assert np.isnan(out[5])
    np.testing.assert_allclose(np.delete(out, 5), np.delete(values, 5))


def test_a_lone_sample_cannot_be_aligned() -> None:
    values = np.array([1.0, np.nan, 3.0, np.nan, 4.0, 5.0, 6.0, 7.0, 8.0])
    time = np.arange(9) * PERIOD
    out = to_scan_time(values, time + 0.001, time, np.arange(9), smooth=False)
    assert np.isnan(out[:4]).all()
    assert np.isfinite(out[4:]).all()


def test_reaching_far_out_of_a_run_is_refused() -> None:
    time = np.arange(10) * PERIOD
    out = to_scan_time(time.copy(), time + 0.04, time, np.arange(10), smooth=False)
    assert np.isnan(out[0])  # 40 ms before the first sample, more than half an interval
    np.testing.assert_allclose(out[1:], time[1:] - 0.04, atol=1e-12)


def test_a_channel_of_every_fourth_scan_is_filled_within_its_runs() -> None:
    number = np.arange(41)
    time = number * 0.005
    values = np.where(number % 4 == 0, 2.0 * time, np.nan)
    out = to_scan_time(values, time, time, number, smooth=False)
    np.testing.assert_allclose(out[:41], 2.0 * time, atol=1e-12)


def test_a_channel_read_seldom_stays_in_its_own_scans() -> None:
    """One reading in 50 scans, or none for longer than `furthest`: what lies between is not known."""
    number = np.arange(200)
    time = number * 0.02
    values = np.where(number % 50 == 7, 5.0 + time, np.nan)
    np.testing.assert_array_equal(to_scan_time(values, time + 0.004, time, number, smooth=True), values)
    every_tenth = np.where(number % 10 == 3, 5.0 + time, np.nan)
    kept = to_scan_time(every_tenth, time + 0.004, time, number, smooth=True, furthest=0.1)
    np.testing.assert_array_equal(kept, every_tenth)
    assert np.isfinite(to_scan_time(every_tenth, time + 0.004, time, number, smooth=True, furthest=0.3)).sum() > 180


def test_a_held_quantity_keeps_its_last_value_within_its_runs() -> None:
    number = np.concatenate([np.arange(12), np.arange(30, 34)])
    values = np.where(number % 4 == 0, number.astype(float), np.nan)
    values[number >= 30] = [np.nan, np.nan, 32.0, np.nan]
    out = hold(values, number)
    np.testing.assert_array_equal(out, [0, 0, 0, 0, 4, 4, 4, 4, 8, 8, 8, 8, np.nan, np.nan, 32, 32])
    every_scan = np.array([1.0, np.nan, 3.0, 4.0, 5.0])
    np.testing.assert_array_equal(hold(every_scan, np.arange(5)), every_scan)  # a missing value stays missing


@pytest.mark.parametrize(("hertz", "tolerance"), [(0.5, 2e-4), (1.5, 4e-3), (3.0, 0.012)])
def test_first_order_low_pass_is_undone_in_amplitude_and_phase(hertz: float, tolerance: float) -> None:
    """Steady answer of a 11.6 Hz low pass to a sine: at 3 Hz 3 % smaller and 14 ms late."""
    lag, omega = 1 / (2 * np.pi * 11.6), 2 * np.pi * hertz
    time = np.arange(200) * PERIOD
    gain = 1 / (1 + 1j * omega * lag)
    seen = np.imag(gain * np.exp(1j * omega * time))
    back = undo_lag(seen, time, np.arange(200), lag)
    assert np.max(np.abs(back - np.sin(omega * time))[3:-3]) < tolerance
    assert np.max(np.abs(seen - np.sin(omega * time))) > 10 * tolerance


def test_undoing_a_lag_hardly_adds_noise(rng: np.random.Generator) -> None:
    """Variance 1 + (lag/dt)^2 (2 (8^2 + 1)/12^2) for the five-point slope."""
    time = np.arange(20_000) * PERIOD
    out = undo_lag(rng.standard_normal(time.size), time, np.arange(time.size), 0.0137)
    assert np.std(out[3:-3]) == pytest.approx(np.sqrt(1 + (0.0137 / PERIOD) ** 2 * 130 / 144), rel=0.02)


def test_short_runs_keep_their_values() -> None:
    np.testing.assert_array_equal(undo_lag(np.array([1.0, 2.0]), np.array([0.0, 0.05]), np.arange(2), 0.01), [1.0, 2.0])


def test_runs_and_completeness() -> None:
    number = np.array([0, 1, 2, 5, 6])
    found, spacing = runs(number, np.array([True, True, True, True, True]))
    assert [r.tolist() for r in found] == [[0, 1, 2], [3, 4]]
    assert spacing == 1
    assert completeness(number) == pytest.approx(5 / 7)
    assert completeness(np.arange(3)) == 1.0


@pytest.mark.parametrize("count", [3, 4, 60])
def test_derivative_of_a_parabola_is_exact_also_at_the_ends(count: int) -> None:
    time = np.cumsum(np.random.default_rng(2).uniform(0.04, 0.06, count))
    slope = derivative(1 + 2 * time - 3 * time**2, time, np.arange(count))
    np.testing.assert_allclose(slope, 2 - 6 * time, atol=1e-8)


def test_derivative_noise_is_that_of_five_points(rng: np.random.Generator) -> None:
    """Slope of a cubic through seven points, weights (22 -67 -58 0 58 67 -22)/252 (Savitzky and Golay 1964, table III)."""
    time = np.arange(20_000) * PERIOD
    slope = derivative(rng.standard_normal(time.size), time, np.arange(time.size))
    weights = np.array([22, -67, -58, 0, 58, 67, -22]) / 252
    assert np.std(slope[3:-3]) == pytest.approx(np.linalg.norm(weights) / PERIOD, rel=0.05)


def test_derivative_does_not_reach_across_a_gap() -> None:
    number = np.concatenate([np.arange(10), np.arange(30, 40)])
    values = np.where(number < 20, 0.0, 100.0)
    np.testing.assert_allclose(derivative(values, number * PERIOD, number), 0.0, atol=1e-9)


@pytest.mark.parametrize("every_s", [0.02, 0.1])
def test_pulses_that_came_between_reports_are_late_and_early_alike(every_s: float) -> None:
    """Pulses change at any time, a report shows what stands: what a servo of 35 ms does with them is late by nothing in the mean
    (before: by half an interval)."""
    rng, lag, fine = np.random.default_rng(4), 0.035, np.arange(0.0, 60.0, 1e-3)
    pulse = np.repeat(rng.uniform(-1.0, 1.0, 145), 417)[: fine.size]
    surface = np.zeros_like(fine)
    for i in range(1, fine.size):
        surface[i] = pulse[i - 1] + (surface[i - 1] - pulse[i - 1]) * np.exp(-1e-3 / lag)
    stamps = np.arange(0.5, 59.5, every_s) + 0.0037
    stamps = stamps + np.arange(stamps.size) % 7 * every_s / 70  # of another clock
    reported = pulse[np.searchsorted(fine, stamps, side="right") - 1]
    newest = np.searchsorted(stamps, scans := np.arange(1.0, 59.0, 0.02), side="right") - 1
    shown = by_stamp(reported[newest], stamps[newest], scans, smooth=False, lag=-lag, pulse=True)
    late = [float(np.nansum((shown - np.interp(scans - d * 1e-3, fine, surface)) ** 2)) for d in range(-30, 31)]
    assert abs(int(np.argmin(late)) - 30) <= 0.15e3 * every_s
