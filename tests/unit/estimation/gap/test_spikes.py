"""Single values that only a fit shows to be no measurement."""

import numpy as np
import pytest

from estimation.engine.kernel import Array
from estimation.gap.criteria import AS_SET
from estimation.gap.effects import catalogue
from estimation.gap.fit import spikes
from estimation.gap.fit.spikes import (
    beside_neighbours,
    left_open,
    spikes_about,
    spikes_in,
    spikes_in_words,
    stepping_samples,
    without_spikes,
)
from estimation.gap.fit.surface_steps import SurfaceSteps
from estimation.gap.workflow import Options, _Run, run_gap
from estimation.models.load import load_model
from groundstation.flight import Flight
from tests.studies import fourth_simulator as fourth
from tests.studies import second_truth as truth
from tests.studies.gap_benchmark import flights, outcome, requests

COUNT = 600
NOWHERE, CLOSED = np.zeros(COUNT, bool), np.zeros(COUNT)
MOST, FARTHEST = 0.01, 4.9


def noise(seed: int = 1) -> Array:
    return np.random.default_rng(seed).standard_normal(COUNT)


def with_level(sample: int, level: float) -> Array:
    """White noise of which one sample is `level` standard deviations from its neighbours."""
    residual = noise()
    change = np.sign(beside_neighbours(residual)[sample])
    for _ in range(200):
        missing = level - abs(beside_neighbours(residual)[sample])
        residual[sample] += 0.5 * change * missing
    return residual


@pytest.mark.parametrize(("level", "found"), [(4.7, []), (5.1, [250])])
def test_a_single_value_far_from_its_neighbours_is_a_spike(level: float, found: list[int]) -> None:
    at = spikes_in(with_level(250, level), NOWHERE, CLOSED, FARTHEST, MOST)
    assert np.flatnonzero(at).tolist() == found


def test_noise_and_slow_motion_have_no_spike_and_gaps_are_none() -> None:
    slow = 30.0 * np.sin(0.15 * np.arange(COUNT))
    assert not any(spikes_in(noise(seed) + slow, NOWHERE, CLOSED, FARTHEST, MOST).any() for seed in range(20))
    broken = noise()
    broken[100:103] = np.nan
    broken[400] += 9.0
    assert np.flatnonzero(spikes_in(broken, NOWHERE, CLOSED, FARTHEST, MOST)).tolist() == [400]
    assert not spikes_in(np.full(COUNT, np.nan), NOWHERE, CLOSED, FARTHEST, MOST).any()
    assert not spikes_in(np.zeros(COUNT), NOWHERE, CLOSED, FARTHEST, MOST).any()


@pytest.mark.parametrize("sample", [0, COUNT - 1])
def test_a_spike_at_an_end_is_one(sample: int) -> None:
    residual = noise()
    residual[sample] += 12.0
    assert np.flatnonzero(spikes_in(residual, NOWHERE, CLOSED, FARTHEST, MOST)).tolist() == [sample]


def test_two_values_in_a_row_are_no_accident_and_neither_are_many() -> None:
    residual = noise()
    residual[300:302] += 20.0
    assert not spikes_in(residual, NOWHERE, CLOSED, FARTHEST, MOST).any()
    residual = noise()
    residual[20::80] += 20.0
    assert spikes_in(residual, NOWHERE, CLOSED, FARTHEST, 0.02).sum() == 8
    assert not spikes_in(residual, NOWHERE, CLOSED, FARTHEST, MOST).any()


def test_near_steps_values_are_judged_by_their_scatter_there() -> None:
    control = np.where(np.arange(COUNT) % 60 < 30, 0.0, 0.1)[:, None]
    stepping = stepping_samples(control, AS_SET)
    assert stepping.sum() == 5 * 19
    assert stepping[28:33].all()
    assert not stepping[[27, 33]].any()
    residual = noise() * np.where(stepping, 5.0, 1.0)
    jump, calm = 29, 440
    residual[[jump, calm]] += 12.0
    assert not spikes_in(residual, stepping, CLOSED, FARTHEST, MOST)[jump]
    assert spikes_in(residual, stepping, CLOSED, FARTHEST, MOST)[calm - 3 : calm + 3].any()
    residual[jump] += 40.0
    assert spikes_in(residual, stepping, CLOSED, FARTHEST, MOST)[jump]


def test_spikes_are_taken_out_and_their_times_said() -> None:
    flight = Flight.build("f", 0.05 * np.arange(COUNT), {"p": noise(), "r": noise(2)})
    at = np.array([10, 20, 30, 40])
    clean = without_spikes(flight, {"p": at})
    assert np.isnan(clean["p"]).sum() == 4
    np.testing.assert_array_equal(clean["r"], flight["r"])
    assert spikes_in_words([flight], {0: {"p": at}}) == [
        "f: single values far from their neighbours and from the model left out: p at 0.50, 1.00, 1.50 s and 1 more"
    ]


def test_flights_with_spikes_have_no_gap_and_say_what_was_left_out() -> None:
    """Two spikes of eight standard deviations on every channel; with them left in the remainder is 6.0."""
    flown = fourth.fly(3232, fourth.Kind(axes="lateral", duration=15.0, spikes=2), (14.5, 16.5, 19.0, 17.0))
    base = load_model("lateral", "cdfp")
    answer = run_gap(base, flown[:3], flown[3:], catalogue(model=base), Options(seed=1, nulls=20))
    assert answer.verdict.value == "no_gap"
    assert outcome(answer)["left"][0] < 5.0
    said = [note for note in answer.notes if "single values far from their neighbours" in note]
    assert {note.split(":")[0] for note in said} == {f.name for f in flown}
    assert "beta at 3.35, 13.50 s" in said[0]


def test_an_attitude_of_a_filter_has_no_spikes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Logged at 10 Hz beside 50 Hz it had eight a flight, and what they left was a gust of three seconds."""
    kind = fourth.Kind(axes="longitudinal", rate=50, attitude="held")
    model, flown = load_model("longitudinal", "cdfp"), fourth.fly(4702, kind, (14.5, 16.5))
    run = _Run.of(model, flown, (), (), None, Options(nulls=20), lambda what, share: None)
    _, baseline = run.set_up(model)
    assert not any("theta" in columns for columns in spikes_about(baseline).values())
    monkeypatch.setattr(spikes, "filtered_attitudes", lambda *given: ())
    assert all(len(columns["theta"]) > 5 for columns in spikes_about(baseline).values())


def test_the_fastest_moves_of_an_aileron_leave_no_spikes() -> None:
    """The path of an aileron that moves by 4 deg between two samples leaves four times the noise of a roll rate open. Without
    that a value of `p` was taken out at the doublets of two flights of three."""
    model, flown = load_model("lateral", "cdfp"), flights(truth.fly(requests({}, 71000, 0.15, "rich")))
    run = _Run.of(model, flown[:3], (), (), None, Options(nulls=20), lambda what, share: None)
    _, baseline = run.set_up(model)
    (opened, *_) = left_open(baseline.problem, baseline.fit, baseline.noise)
    roll_rate = model.output_names.index("p")
    assert opened.shape == baseline.fit.residuals[0].shape
    assert opened[:, roll_rate].max() > 3.0 * baseline.scatter[roll_rate]
    assert not any(spikes_about(baseline).values())


def test_what_a_displacement_leaves_beside_its_neighbours_is_its_response_weighed() -> None:
    response = np.zeros((9, 1, 1))
    response[4:, 0, 0] = 2.0
    steps = SurfaceSteps(("delta_a",), np.array([3]), np.array([0.1]), response, AS_SET)
    scatter = steps.scatter({"delta_a": 0.5}, np.array([0.0, 1.0, -1.0]))[:, 0]
    np.testing.assert_allclose(scatter, [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0], atol=1e-12)
