"""A fit whose motion grows: bounded responses, nulls that no pilot flies, and records short enough for it."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.linalg import block_diag

from estimation.engine.kernel import Array
from estimation.errors import GapError
from estimation.gap import workflow
from estimation.gap.answer.result import GapResult, GapVerdict
from estimation.gap.criteria import AS_SET
from estimation.gap.fit.baseline import Baseline, fit_baseline, stretch_that_holds
from estimation.gap.fit.linear_motion import BoundedMotion, BoundedResponse, Linear, fastest_growth, growth
from estimation.gap.fit.noise import channel_noise
from estimation.gap.records.candidate_model import with_dormant, with_nuisance
from estimation.gap.records.flight_records import FlightRecords, prepare_flights, sample_interval
from estimation.gap.significance.calibration import screen_round
from estimation.gap.significance.nulls import input_errors
from estimation.models.base import Model, Parameter
from groundstation.flight import Flight
from tests.unit.estimation.gap.roll import ROLL

STEP = 0.05
GROWING = 0.4  # 1/s
DIVERGENT = replace(ROLL, parameters=(Parameter("L_p", start=GROWING), Parameter("L_a", start=4.0)))


def linear(A: Array, B: Array, step: float = STEP) -> Linear:
    """Motion that shows all its states."""
    n, m = B.shape
    return Linear(A, B, np.eye(n), np.zeros((n, m)), ("delta_a",) * m, step, np.ones(n))


def bounded_response(motion: Linear, courses: Array) -> Array:
    return BoundedResponse.of(motion).outputs(courses)


def test_a_mode_that_grows_is_at_rest_after_the_last_disturbance_and_moves_before_the_first() -> None:
    """x' = a x + 1 from t = 2 to t = 3: x = -(exp(-a (2 - t)) - exp(-a (3 - t)))/a before, 0 after."""
    time = STEP * np.arange(101)
    pulse = np.where((time > 1.99) & (time < 3.01), 1.0, 0.0)
    pulse[[40, 60]] = 0.5  # edges half-way, so that straight lines have the same area
    found = bounded_response(linear(np.array([[0.5]]), np.ones((1, 1))), pulse[:, None, None])[:, 0, 0]
    before = time < 1.9
    closed = -(np.exp(-0.5 * (2.0 - time)) - np.exp(-0.5 * (3.0 - time))) / 0.5
    np.testing.assert_allclose(found[before], closed[before], rtol=1e-3)
    np.testing.assert_array_equal(found[time > 3.1], 0.0)


def test_modes_mixed_in_the_states_respond_each_in_its_own_direction() -> None:
    rng = np.random.default_rng(0)
    mix, course = rng.standard_normal((4, 4)), rng.standard_normal((200, 2, 3))
    modes = block_diag(0.5, np.array([[-0.3, 2.0], [-2.0, -0.3]]), 0.005)  # the last grows too slowly to count
    B = rng.standard_normal((4, 2))
    together = bounded_response(linear(mix @ modes @ np.linalg.inv(mix), mix @ B), course)
    alone = bounded_response(linear(modes[:1, :1], B[:1]), course)
    swinging = bounded_response(linear(modes[1:3, 1:3], B[1:3]), course)
    slow = bounded_response(linear(modes[3:, 3:], B[3:]), course)
    expected = np.einsum("ij,njk->nik", mix, np.concatenate([alone, swinging, slow], axis=1))
    np.testing.assert_allclose(together, expected, atol=1e-9 * np.abs(expected).max())
    assert not slow[0].any()  # at rest in the beginning
    assert not alone[-1].any()


def test_noise_of_a_growing_motion_has_the_power_that_its_whitener_expects() -> None:
    """|1/(i w - a)|^2 = |1/(i w + a)|^2: as much as the mode that decays as fast."""
    white = np.random.default_rng(1).standard_normal((4000, 1, 60))
    inner = slice(500, 3500)
    grows, decays = (bounded_response(linear(np.array([[a]]), np.ones((1, 1))), white)[inner] for a in (0.6, -0.6))
    assert np.var(grows) == pytest.approx(np.var(decays), rel=0.05)
    assert np.var(decays) == pytest.approx(STEP / (2.0 * 0.6), rel=0.1)


def controlled(seed: int, growing: float = GROWING, duration: float = 20.0) -> Flight:
    """Roll that grows, in gusts, held by a pilot between pulses of the aileron."""
    rng, count = np.random.default_rng(seed), round(duration / STEP)
    time, p, aileron = STEP * np.arange(count, dtype=np.float64), np.zeros(count), np.zeros(count)
    pulses = 0.3 * (np.floor(time / 1.5 + seed) % 4 == 0) - 0.3 * (np.floor(time / 1.5 + seed) % 4 == 2)
    for k in range(count - 1):
        aileron[k] = pulses[k] - 0.5 * (p[k - 10] if k >= 10 else 0.0)
        p[k + 1] = p[k] + STEP * (growing * p[k] + 4.0 * aileron[k]) + 0.1 * np.sqrt(STEP) * rng.standard_normal()
    aileron[-1] = aileron[-2]
    noisy = {"p": p + 0.005 * rng.standard_normal(count), "delta_a": aileron + 2e-4 * rng.standard_normal(count)}
    return Flight.build(f"f{seed}", time, noisy)


def fitted(model: Model, flights: list[Flight]) -> tuple[FlightRecords, Baseline]:
    prepared = prepare_flights(model, (), flights, (), AS_SET)
    scatter = channel_noise(prepared.records)
    noise = dict(zip(model.output_names, scatter, strict=True))
    clean = with_nuisance(model, noise, sample_interval(prepared.records), AS_SET)
    return prepared, fit_baseline(with_dormant(clean, (), frozenset(), ("p",)), clean, prepared, scatter)


@pytest.fixture(scope="module")
def divergent() -> tuple[FlightRecords, Baseline]:
    return fitted(DIVERGENT, [controlled(1), controlled(2)])


def test_nulls_of_a_fit_that_grows_are_like_its_flights(divergent: tuple[FlightRecords, Baseline]) -> None:
    prepared, baseline = divergent
    assert fastest_growth(baseline.problem, baseline.fit) == pytest.approx(GROWING, abs=0.15)
    errors = [input_errors(r, baseline.clean, np.random.default_rng(i)) for i, r in enumerate(prepared.records)]
    round_ = screen_round(baseline, prepared, (), errors, 20, 1)
    energy = round_.screen.projected().energy
    assert len(round_.null_residuals) == 20
    # four fifths, as with roll that decays: of this jumpy aileron the flights' noise has more than what preparing it leaves
    assert np.all((energy[1:] > 0.6 * energy[0]) & (energy[1:] < energy[0]))


def test_a_motion_that_does_not_grow_is_simulated() -> None:
    _, baseline = fitted(ROLL, [controlled(1, -6.0, 15.0)])
    assert BoundedMotion.of(baseline.problem, baseline.fit) == (None,)


def test_a_bounded_motion_differs_from_a_simulated_one_by_the_growing_mode(
    divergent: tuple[FlightRecords, Baseline],
) -> None:
    _, baseline = divergent
    problem, fit = baseline.problem, baseline.fit
    bounded = BoundedMotion.of(problem, fit)[0]
    assert bounded is not None
    np.testing.assert_array_equal(bounded.outputs(bounded.inputs), problem.fitted_outputs(0, fit))
    moved = bounded.inputs.copy()
    aileron = problem.model.input_names.index("delta_a")
    moved[200:240, aileron] += 0.01
    driven = replace(problem.driven(problem.grids[0], fit.values), u=moved)
    motion = problem.simulator.run_by_middles(driven, {**fit.values, **fit.locals[0].parameters}, fit.locals[0].x0)
    difference = (motion.y - bounded.outputs(moved))[:, 0]
    rate = growth(bounded.linear)
    shape = np.exp(rate * (problem.coarse[0].time - problem.coarse[0].time[0]))
    np.testing.assert_allclose(difference / shape, difference[0], rtol=0.02)
    assert np.abs(bounded.outputs(moved) - bounded.fitted).max() < 0.1 * np.abs(motion.y - bounded.fitted).max()
    course = np.zeros((len(problem.coarse[0]), len(problem.model.input_names)))
    course[100:120, aileron] = 0.01
    np.testing.assert_allclose(bounded.changes([course])[0], bounded.outputs(moved) - bounded.fitted, atol=2e-3)
    assert bounded.changes([]).shape == (0, *bounded.fitted.shape)


def test_records_are_as_short_as_the_motion_grows_fast(divergent: tuple[FlightRecords, Baseline]) -> None:
    _, baseline = divergent
    longest = stretch_that_holds(baseline)
    assert longest is not None
    assert longest == pytest.approx(3.0 / GROWING, rel=0.25)
    criteria = replace(AS_SET, longest_record=longest)
    short = prepare_flights(DIVERGENT, (), [controlled(1), controlled(2)], (), criteria)
    assert max(float(np.ptp(r.time)) for r in short.records) < longest
    cut = replace(baseline, problem=replace(baseline.problem, records=short.records))
    assert stretch_that_holds(cut) is None
    steady = replace(baseline, fit=replace(baseline.fit, values={**baseline.fit.values, "L_p": 0.1}))
    assert stretch_that_holds(steady) is None


ANSWER = GapResult(GapVerdict.NO_GAP, "", {}, (), {}, 4.0, 3.0, (), (), DIVERGENT, DIVERGENT)
CLOSED, UNKNOWN, NOTHING = GapVerdict.GAP_CLOSED, GapVerdict.UNKNOWN, GapVerdict.NO_GAP
BLIND, REDUCED = GapVerdict.CANNOT_TELL, GapVerdict.GAP_REDUCED


@pytest.mark.parametrize(
    ("whole", "grows", "stretched", "verdict"),
    [
        (CLOSED, True, NOTHING, CLOSED),
        (REDUCED, True, CLOSED, REDUCED),
        (UNKNOWN, False, CLOSED, UNKNOWN),
        (UNKNOWN, True, CLOSED, CLOSED),
        (NOTHING, True, REDUCED, REDUCED),
        (BLIND, True, NOTHING, NOTHING),
        (BLIND, True, UNKNOWN, UNKNOWN),
        (UNKNOWN, True, NOTHING, NOTHING),
        (UNKNOWN, True, BLIND, UNKNOWN),
        (NOTHING, True, UNKNOWN, NOTHING),
        (UNKNOWN, True, None, UNKNOWN),
    ],
)
def test_where_whole_records_leave_no_name_stretches_are_asked(
    monkeypatch: pytest.MonkeyPatch,
    divergent: tuple[FlightRecords, Baseline],
    whole: GapVerdict,
    grows: bool,
    stretched: GapVerdict | None,
    verdict: GapVerdict,
) -> None:
    """They settle what they name, or show to be nothing; None stands for stretches on which the motion runs away."""
    baseline = divergent[1]

    def searched(run: Any, model: Model) -> Any:
        if run.stretched and stretched is None:
            raise GapError("runs away")
        assert not run.stretched or "in stretches of up to" in run.notes_after[-1]
        first = baseline if grows else replace(baseline, fit=replace(baseline.fit, values={"L_p": -6.0, "L_a": 4.0}))
        rounds = SimpleNamespace(rounds=[SimpleNamespace(baseline=first)])
        setting: Any = SimpleNamespace(effects=(), verdict=stretched if run.stretched else whole)
        return workflow._Found(run, setting, first, cast(Any, rounds), "")

    monkeypatch.setattr(workflow, "_find", searched)
    monkeypatch.setattr(workflow, "kinematic_check", lambda *given: None)
    monkeypatch.setattr(workflow, "late_commands", lambda *given: "")
    monkeypatch.setattr(workflow, "turned_signs", lambda *given: [])
    monkeypatch.setattr(workflow, "concluded", lambda setting, search, check: replace(ANSWER, verdict=setting.verdict))
    assert workflow.run_gap(DIVERGENT, [controlled(1), controlled(2)]).verdict is verdict
