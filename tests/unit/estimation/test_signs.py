"""Signs and units that a fit gives away: channels against the model of the others, controls against what was believed."""

from collections.abc import Mapping
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from estimation.estimators.result import Estimate, Result
from estimation.gap.workflow import Options, run_gap
from estimation.models import load_model
from estimation.session.plausible_derivatives import implausible_derivatives
from estimation.session.sanity_checks import (
    controls_of_another_unit,
    turned_controls,
    turned_outputs,
    turned_side_force,
)
from tests.studies import second_truth as truth
from tests.studies.gap_benchmark import flights, requests

LATERAL = load_model("lateral", "cdfp")
NAMES = LATERAL.output_names


def believed(**times: float) -> dict[str, Estimate]:
    """What was believed, known to 2 %, some of it so many times as large."""
    found = {}
    for p in LATERAL.parameters:
        if p.reference:
            value = p.reference * times.get(p.name, 1.0)
            found[p.name] = Estimate(p.name, value, 0.01 * abs(value), 0.02 * abs(value), reference=p.reference)
    return found


def motion(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    values = 3.0 + np.cumsum(rng.standard_normal((300, len(NAMES))), axis=0)
    values[rng.random(values.shape) < 0.1] = np.nan
    return values


def test_an_output_that_moves_against_the_model_is_told_about_its_mean_and_where_both_are_known() -> None:
    modelled = [np.nan_to_num(motion(k), nan=3.0) for k in (1, 2)]
    measured = [np.where(np.isfinite(motion(k)), m, np.nan) for k, m in zip((3, 4), modelled, strict=True)]
    assert turned_outputs(LATERAL, zip(measured, modelled, strict=True)) == []
    at = NAMES.index("phi")
    for z in measured:
        z[:, at] = 50.0 - z[:, at]
    (told,) = turned_outputs(LATERAL, zip(measured, modelled, strict=True))
    assert told.startswith("phi: moves against what the other channels make of it (correlation -1.00")
    for z in measured:
        z[:, at] = np.nan
    assert turned_outputs(LATERAL, zip(measured, modelled, strict=True)) == []


def test_side_force_into_the_wind_is_told_where_it_is_sure() -> None:
    assert turned_side_force(LATERAL, believed()) == []
    assert "is its sign wrong" in turned_side_force(LATERAL, believed(CY_beta=-1.0))[0]
    unsure = {"CY_beta": Estimate("CY_beta", 0.04, 0.001, 0.01)}
    assert turned_side_force(LATERAL, unsure) == []
    assert turned_side_force(LATERAL, {}) == []


@pytest.mark.parametrize(
    ("times", "turned", "unit"),
    [
        ({}, 0, 0),
        ({"Cl_da": -0.7}, 1, 0),
        ({"CY_dr": -1.0, "Cl_dr": -1.0}, 0, 0),
        ({"CY_dr": -1.0, "Cl_dr": -1.0, "Cn_dr": -1.0}, 1, 0),
        ({"CY_dr": 57.3, "Cl_dr": 57.3, "Cn_dr": 57.3}, 0, 1),
        ({"Cl_da": 1 / 57.3}, 0, 1),
        ({"Cl_da": -1 / 57.3}, 1, 0),
    ],
)
def test_a_control_is_doubted_by_all_its_derivatives(times: Mapping[str, float], turned: int, unit: int) -> None:
    found = believed(**times)
    assert (len(turned_controls(LATERAL, found)), len(controls_of_another_unit(LATERAL, found))) == (turned, unit)


def test_a_turned_column_is_told_before_what_the_gap_workflow_makes_of_it() -> None:
    (flight,) = flights(truth.fly(requests({}, 5, 0.15, "rich")[:1]))
    turned = flight.with_columns(ay=-flight["ay"])
    result = run_gap(LATERAL, [turned], effects=(), options=Options(nulls=20))
    assert result.text.startswith(
        "Before any of this, look at the flights: ay: pushes the aircraft into the wind (CY_beta = 0.1"
    )
    assert any(n.startswith("ay: pushes the aircraft into the wind") for n in result.notes)


@pytest.mark.parametrize(("CY_r", "told"), [(0.2, True), (0.6, True), (1.4, True), (1.4, False)])
def test_side_force_by_yaw_rate_is_a_fins(CY_r: float, told: bool) -> None:
    side, by_rate = Estimate("CY_beta", -0.5, 0.01, 0.02), Estimate("CY_r", CY_r, 0.02, 0.05, identifiable=told)
    result = cast(Result, SimpleNamespace(model=LATERAL, parameters={"CY_beta": side, "CY_r": by_rate}))
    texts = list(implausible_derivatives(result))
    assert [("yaw damper" in text) for text in texts] == ([True] if CY_r > 1.0 and told else [])


@pytest.mark.parametrize(("Cn_da", "known", "doubted"), [(0.02, True, False), (0.1, True, True), (0.1, False, False)])
def test_ailerons_that_yaw_as_no_ailerons_do_ask_for_the_product_of_inertia(
    Cn_da: float, known: bool, doubted: bool
) -> None:
    roll, yaw = Estimate("Cl_da", -0.2, 0.002, 0.003), Estimate("Cn_da", Cn_da, 0.001, 0.002, identifiable=known)
    constants = {"Ixx": 0.5, "Izz": 1.0, "Ixz": 0.0}
    model = SimpleNamespace(name=LATERAL.name, constants=constants)
    result = cast(Result, SimpleNamespace(model=model, parameters={"Cl_da": roll, "Cn_da": yaw}))
    texts = list(implausible_derivatives(result))
    assert len(texts) == doubted
    if not doubted:
        return
    # with the product of inertia that the sentence names, the same accelerations need no yawing moment
    assert "is Ixz = 0 kg m2 right? With -0.25 they" in texts[0]
    p_dot, r_dot = roll.estimate / constants["Ixx"], Cn_da / constants["Izz"]
    assert constants["Izz"] * r_dot - -0.25 * p_dot == pytest.approx(0.0)
