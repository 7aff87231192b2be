"""Moves of a surface that is known by its commands alone, dated by the gyro."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from groundstation.importers.columns import ColumnOrigin
from groundstation.importers.mapping import ColumnSource
from groundstation.importers.move_times import with_moves_dated
from groundstation.importers.series import TimeSeries, held_at

LAG = 0.05  # s, of the servo
DAMPING, POWER = -11.0, -55.0  # 1/s, 1/s2: rolls to its rate in 90 ms
GYRO = 0.003  # rad/s
EDGES = np.array([2.013, 2.54, 3.06, 6.001, 6.537, 7.024, 11.009, 11.522, 12.031, 15.018, 15.55, 16.063])
TIME = np.arange(0.0, 20.0, 0.02)


def command(t: np.ndarray) -> np.ndarray:
    """Doublets of 7 deg; between them a slow waggle, as an autopilot's."""
    steps = np.array([0.12, -0.24, 0.12] * 4)
    return np.asarray((steps * (t[:, None] >= EDGES)).sum(axis=1) + 0.02 * np.sin(1.7 * t))


def flown(lag: float = LAG) -> tuple[np.ndarray, np.ndarray]:
    """Surface and rolling rate at TIME."""
    fine = np.arange(0.0, 20.0, 0.0005)
    commanded = command(fine)

    def rate(t: float, x: np.ndarray) -> list[float]:
        u = commanded[min(int(t / 0.0005 + 0.5), fine.size - 1)]
        return [(u - x[0]) / lag, DAMPING * x[1] + POWER * x[0]]

    found = solve_ivp(rate, (0.0, 20.0), [0.0, 0.0], t_eval=TIME, max_step=0.002)
    return found.y[0], found.y[1]


SURFACE, ROLLING = flown()


def recorded(
    interval: float, late: float = 0.0, lag: float = LAG
) -> tuple[dict[str, TimeSeries], dict[str, ColumnOrigin]]:
    """The servo's output as a log has it, `late` [s] after it was given."""
    at = np.arange(0.0, 20.0, interval)
    series = {"servo.a": TimeSeries(at, command(at - late), lag=lag, command=True)}
    origin = ColumnOrigin(
        ColumnSource(column="servo.a", unit="rad"), "computed", 1.0 / interval, "delta_a", interval, lag
    )
    return series, {"delta_a": origin}


def dated(interval: float, noise: float = GYRO, **log: float) -> tuple[np.ndarray, np.ndarray, float | None, list[str]]:
    """The surface as an import has it, without and with its moves dated, how surely, and what is said of it."""
    series, origins = recorded(interval, **log)
    rng = np.random.default_rng(3)
    columns = {n: noise * rng.standard_normal(TIME.size) for n in ("p", "q", "r", "ay")}
    columns["p"] += ROLLING
    columns["delta_a"] = held_at(series["servo.a"], TIME)
    moved, stated, said = with_moves_dated(series, origins, TIME, columns)
    return columns["delta_a"], moved["delta_a"], stated["delta_a"].dated, said


def error(surface: np.ndarray, late: float = 0.0) -> float:
    true = np.interp(TIME - late, TIME, SURFACE)
    known = np.isfinite(surface) & (TIME > 1.0)
    return float(np.sqrt(np.mean((surface - true)[known] ** 2)))


@pytest.mark.parametrize(("interval", "before", "after"), [(0.04, 0.004, 0.001), (0.1, 0.008, 0.003)])
def test_moves_stand_where_the_gyro_shows_them(interval: float, before: float, after: float) -> None:
    plain, moved, sure, said = dated(interval)
    assert error(plain) > before
    assert error(moved) < after
    assert sure is not None
    assert sure < 0.15 * interval
    assert "12 of delta_a by p" in said[0]


def test_what_all_moves_are_late_by_is_taken_out() -> None:
    """A record 15 ms old, a servo of 50 ms said to be one of 30: the surface is where it was all the same."""
    plain, moved, _, said = dated(0.04, late=0.015)
    assert error(plain) > 0.006
    assert error(moved) < 0.0015
    assert "ms earlier" in said[0]
    plain, moved, _, said = dated(0.04, lag=0.03)
    assert error(moved) < 0.75 * error(plain)  # what is left is the shape of another lag
    assert "ms later" in said[0]


def test_a_gyro_that_shows_none_of_them_dates_none() -> None:
    plain, moved, sure, said = dated(0.04, noise=3.0)
    np.testing.assert_array_equal(moved, plain)
    assert sure is None
    assert not said


def test_without_a_lag_stated_the_moves_are_told_apart_all_the_same() -> None:
    """The servo behind is one of 50 ms, which the map does not say: all moves stay late alike, and none against another."""
    plain, moved, sure, _ = dated(0.04, lag=0.0)
    fine = np.arange(0.0, 20.0, 0.001)
    given = np.convolve(command(fine), np.ones(21) / 21, "same")

    def off(surface: np.ndarray) -> float:
        known = (TIME > 1.0) & (TIME < 19.0)
        shifts = np.arange(-0.03, 0.031, 0.002)
        return min(float(np.std((surface - np.interp(TIME - s, fine, given))[known])) for s in shifts)

    assert sure is not None
    assert off(moved) < 0.4 * off(plain)
