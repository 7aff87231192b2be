"""Edges on the sampling clock: the way of a surface between its samples, against flights integrated at 400 Hz and finer."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from estimation.engine.simulate import Simulator
from estimation.estimators.filter_error import filter_error, gain_law
from estimation.estimators.input_path import SURE_OF_WAY, InputPath, clocked_controls, with_paths
from estimation.estimators.output_error import OutputErrorOptions, output_error
from estimation.estimators.refits import parametric_bootstrap
from estimation.estimators.result import Result
from estimation.models import load_model
from estimation.models.base import InputTransform, Parameter
from estimation.prepare.flight_data import Segment
from estimation.prepare.pipeline import prepare
from groundstation.flight import Provenance
from tests.unit.estimation.truth import NOISE, STRONG, TRUE, Case, fly

LATERAL = load_model("lateral", "cdfp")


def misses(result: Result, names: Sequence[str] = STRONG) -> list[float]:
    """Distance of each estimate from the truth, in corrected bounds."""
    return [(result.parameters[n].estimate - TRUE[n]) / result.parameters[n].std_coloured for n in names]


def test_edges_on_the_clock_are_seen_and_others_are_not() -> None:
    for rate, servo, phase, seen in ((10.0, 0.05, 0.0, True), (20.0, 0.035, 0.0, True), (20.0, 0.04, 0.0173, False)):
        flights, _ = fly(Case(rate=rate, servo=servo, phase=phase, noise=NOISE), np.random.default_rng(3), seeds=1)
        found = clocked_controls(LATERAL, [prepare(LATERAL, flights[0])])
        assert set(found) == ({"delta_a", "delta_r"} if seen else set())


def test_a_command_has_an_open_way_whatever_its_edges_look_like() -> None:
    """What is logged at 8 Hz may have been commanded an eighth of a second before: the prior is that wide."""
    case = Case(rate=20.0, servo=0.04, phase=0.0173, noise=NOISE)
    flights, _ = fly(case, np.random.default_rng(9), seeds=1)
    channel = {"from": "RCOU.C1", "kind": "computed", "rate_hz": 8.0, "held": True, "interval_s": 0.125}
    provenance = Provenance(detail={"channels": {"delta_a": channel}})
    data = prepare(LATERAL, replace(flights[0], provenance=provenance))
    assert data.commands == {"delta_a": 0.125}
    assert clocked_controls(LATERAL, [data]) == ("delta_a",)
    prior = with_paths(LATERAL, [data]).parameter("lag_of_delta_a").prior_std
    assert prior == pytest.approx(np.hypot(0.04, 0.0625))


def test_a_model_that_says_how_a_surface_follows_is_left_as_it_is() -> None:
    flights, _ = fly(Case(rate=10.0, servo=0.05, noise=NOISE), np.random.default_rng(4))
    stated = LATERAL.plus(
        parameters=[Parameter("T", "s", 0.02)], transforms=[InputTransform("delay", "delta_a", ("T",))]
    )
    found = with_paths(stated, [prepare(stated, flights[0])])
    assert {t.input for t in found.transforms if t.kind == "bend"} == {"delta_r"}


def test_derivatives_by_the_way_between_samples_are_those_of_differences() -> None:
    model = LATERAL.plus(parameters=[Parameter("b", "1", 0.2)], transforms=[InputTransform("bend", "delta_a", ("b",))])
    flights, _ = fly(Case(rate=10.0, servo=0.05), np.random.default_rng(5))
    whole: Segment = prepare(model, flights[0]).segments[0]
    segment = whole.part(0, 60, whole.x0)  # this motion grows: later differences are no longer small
    simulator, values = Simulator.build(model), model.starts()
    motion = simulator.run(segment, values, segment.x0, sensitivities=True)
    up, down = (simulator.run(segment, {**values, "b": 0.2 + h}, segment.x0).y for h in (1e-4, -1e-4))
    assert motion.dy is not None
    column = motion.dy[:, :, simulator.free.index("b")]
    assert np.abs(column).max() > 0.01
    assert column == pytest.approx((up - down) / 2e-4, abs=1e-5 * np.abs(column).max() + 1e-9)


def test_a_bootstrap_is_of_the_parameters_of_the_model_alone() -> None:
    flights, _ = fly(Case(rate=10.0, servo=0.05, noise=NOISE), np.random.default_rng(3), seeds=1)
    result = output_error(LATERAL, flights)
    assert result.extra["input_paths"]
    bootstrap = parametric_bootstrap(LATERAL, flights, result, 10, np.random.default_rng(1))
    assert bootstrap.names == tuple(result.parameters)
    assert len(bootstrap.estimates) == 10


@pytest.mark.parametrize(("rate", "servo"), [(10.0, 0.05), (20.0, 0.032)])
def test_roll_damping_with_edges_on_the_clock(rate: float, servo: float) -> None:
    flights, _ = fly(Case(rate=rate, servo=servo, noise=NOISE), np.random.default_rng(6), seeds=2)
    result = output_error(LATERAL, flights)
    without = output_error(LATERAL, flights, options=OutputErrorOptions(paths=False))
    assert np.abs(misses(result)).max() < 2.5
    off = abs(result.parameters["Cl_p"].estimate - TRUE["Cl_p"])
    assert off < 0.5 * abs(without.parameters["Cl_p"].estimate - TRUE["Cl_p"])
    moved = abs(result.parameters["Cl_p"].estimate - without.parameters["Cl_p"].estimate)
    assert result.parameters["Cl_p"].std_coloured > 0.5 * SURE_OF_WAY * moved  # half: the shift is linearised
    path: InputPath = result.extra["input_paths"]["delta_a"]
    assert abs(path.lag) < 3.0 * path.std
    assert result.to_json()["inputs"]["delta_a"]["lag"] == path.lag
    assert set(result.parameters) == set(LATERAL.free_names)


def test_filter_error_has_the_same_unknowns() -> None:
    flights, _ = fly(Case(rate=10.0, servo=0.05, noise=NOISE), np.random.default_rng(7))
    result = filter_error(LATERAL, flights[0])
    assert set(result.extra["input_paths"]) == {"delta_a", "delta_r"}
    assert np.abs(misses(result)).max() < 4.0


def test_edges_at_any_time_leave_a_fit_as_it_was() -> None:
    flights, _ = fly(Case(rate=20.0, phase=0.0173, noise=NOISE), np.random.default_rng(8))
    now, before = (output_error(LATERAL, flights, options=OutputErrorOptions(paths=p)) for p in (True, False))
    assert now.values == before.values
    assert "inputs" not in now.to_json()


def test_a_filter_without_a_finite_gain_says_so() -> None:
    law = gain_law(np.array([[2e4]]), np.array([[1.0]]), 0.1, np.array([0.1]), np.array([0.1]), (0,))
    with pytest.raises(np.linalg.LinAlgError, match="grows beyond all numbers"):
        law.gain(np.array([1.0]))
