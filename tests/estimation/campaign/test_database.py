"""Derivatives over conditions: a constant is the pooled value, a slope is found, bands cover, nobody flew there."""

import numpy as np
import pytest

from estimation.campaign import pooling
from estimation.campaign.database import Surface, fit_surface
from estimation.models.expressions import names_in


def flights(rng: np.random.Generator, count: int, slope: float, between: float = 0.004) -> tuple[np.ndarray, ...]:
    """Mean alpha falls with V as in level flight, and a little more freely; truth linear in alpha."""
    speed = rng.uniform(13.0, 20.0, count)
    conditions = np.column_stack([25.0 / speed**2 + 0.02 * rng.standard_normal(count), speed])
    v = rng.uniform(0.004, 0.012, count) ** 2
    truth = -0.5 + slope * conditions[:, 0]
    return truth + rng.standard_normal(count) * np.sqrt(v + between**2), v, conditions, truth


def test_where_nothing_depends_on_conditions_it_is_the_pooled_value(rng: np.random.Generator) -> None:
    y, v, _, _ = flights(rng, 20, 0.0)
    surface = fit_surface(y, v, np.full((20, 2), (0.1, 16.0)))
    value, std = surface.at(np.array([[0.1, 16.0], [0.2, 30.0]]))
    pooled = pooling.pool(y, v)
    assert surface.powers == ((0, 0),)
    assert value == pytest.approx(pooled.b[0])
    assert std == pytest.approx(pooled.std[0])


def test_a_slope_predicts_flights_held_out_better_than_any_constant_and_bands_cover() -> None:
    rng = np.random.default_rng(8)
    covered, points, better = 0, 0, 0
    for _ in range(40):
        y, v, conditions, truth = flights(rng, 60, 0.8)
        surface = fit_surface(y[:40], v[:40], conditions[:40])
        value, std = surface.at(conditions[40:])
        inside = surface.flown(conditions[40:])
        half = pooling.t_quantile(0.975, surface.fit.freedom) * std
        covered += int(np.sum(np.abs(value - truth[40:])[inside] < half[inside]))
        points += int(inside.sum())
        constant = pooling.pool(y[:40], v[:40]).b[0]
        better += np.sum((y[40:] - value) ** 2) < np.sum((y[40:] - constant) ** 2)
    assert better == 40
    assert 0.88 < covered / points < 0.985  # some 800 points on 40 surfaces, each off as a whole; 0.950 over 200


def test_without_a_slope_hardly_any_is_claimed() -> None:
    rng = np.random.default_rng(9)
    chosen = [fit_surface(*flights(rng, 40, 0.0)[:3]).powers for _ in range(40)]
    assert sum(powers == ((0, 0),) for powers in chosen) > 30


def test_the_formula_is_the_surface_and_is_of_a_model_file(rng: np.random.Generator) -> None:
    y, v, conditions, _ = flights(rng, 60, 0.8)
    surface = fit_surface(y, v, conditions)
    alpha, V = conditions[3]
    assert names_in(surface.formula) <= {"alpha", "V"}
    said = eval(surface.formula.replace("^", "**"), {"alpha": alpha, "V": V})  # noqa: S307  written a line above
    assert said == pytest.approx(surface.at(conditions[3:4])[0][0], rel=1e-5)


def test_far_from_every_flight_nothing_is_known(rng: np.random.Generator) -> None:
    y, v, conditions, _ = flights(rng, 30, 0.5)
    surface: Surface = fit_surface(y, v, conditions)
    corner = np.array(
        [[conditions[:, 0].max(), conditions[:, 1].max()]]
    )  # fast and at high incidence: not level flight
    assert not surface.flown(corner)[0]
    assert surface.flown(conditions).all()
