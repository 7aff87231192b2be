"""A base that holds its derivatives: freed where they are off, and not where one hypothesis explains why they look it."""

import numpy as np
import pytest

from estimation.gap.effects.base import Group
from estimation.gap.search.bases import derivatives_off, explained_by_one
from estimation.gap.significance.screen import Signatures, derivatives, hypotheses_for, sensitivity
from estimation.gap.workflow import Options, _Run
from estimation.models.base import Model
from estimation.models.load import load_model
from groundstation.flight import Flight
from tests.studies import second_truth as truth
from tests.studies.gap_benchmark import flights

LATERAL = load_model("lateral", "cdfp")


def held(spread: float) -> Model:
    """The lateral model with every derivative held, off by up to so much."""
    known = truth.perturbed_derivatives(np.random.default_rng(3), spread)
    return LATERAL.with_starts({n: v for n, v in known.items() if n in LATERAL.free_names}).fixed(
        *(n for n in LATERAL.free_names if n in known)
    )


def flown(shown: float) -> list[Flight]:
    """Two flights whose airspeed reads `shown` times the true one."""
    asked = [truth.Request(56100 + i, V, {}, 0.15 * truth.DEG) for i, V in enumerate((14.5, 16.5))]
    return [f.with_columns(V=shown * f["V"]) for f in flights(truth.fly(asked))]


@pytest.mark.parametrize(("spread", "shown", "explained"), [(0.0, 1.1, True), (0.15, 1.0, False)])
def test_an_airspeed_that_is_off_is_asked_before_all_derivatives_are_freed(
    spread: float, shown: float, explained: bool
) -> None:
    run = _Run.of(LATERAL, flown(shown), (), (), None, Options(nulls=20), lambda what, share: None)
    setting, baseline = run.set_up(held(spread))
    assert derivatives_off(setting, baseline)
    assert explained_by_one(setting, baseline) is explained


def test_derivatives_by_dormant_parameters_are_what_small_steps_show() -> None:
    run = _Run.of(LATERAL, flown(1.0), (), (), None, Options(nulls=20), lambda what, share: None)
    setting, baseline = run.set_up(LATERAL)
    hypotheses = hypotheses_for(baseline.clean, setting.effects, setting.prepared.available)
    exact = derivatives(baseline.problem, baseline.fit, hypotheses)
    parameters = {p.name: (h, p) for h in hypotheses for p in h.form.parameters}
    assert len(exact) > 20
    for name, changes in exact.items():
        steps = sensitivity(baseline.problem, baseline.fit, baseline.fit.residuals, *parameters[name])
        assert (changes is None) == (steps is None), name
        for a, b in zip(changes or (), steps or (), strict=True):
            assert np.linalg.norm(a - b) <= 0.1 * np.linalg.norm(b), name
    signatures = Signatures.of(baseline.problem, baseline.fit, hypotheses)
    asked = {h.effect.name for h in signatures.hypotheses}
    assert {"Cn_da", "Cl_beta3", "aileron_lag", "aileron_deadzone"} <= asked
    assert {h.effect.group for h in signatures.hypotheses} >= {Group.DERIVATIVE, Group.SENSOR, Group.ACTUATOR}
