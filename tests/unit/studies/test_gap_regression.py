"""The regressions that the gap workflow is compared with are given their best: the whole catalogue, right in physics."""

import numpy as np
import pytest

from estimation.aircraft import load_aircraft
from estimation.gap.effects import catalogue
from estimation.models.load import load_model
from tests.studies import second_truth as truth
from tests.studies.gap_benchmark import flights
from tests.studies.gap_regression.equations import Way, evidence
from tests.studies.gap_regression.fake_flights import signals
from tests.studies.gap_regression.library import LIBRARY, lagged, late, with_play
from tests.studies.gap_regression.selection import Regression, stepwise, stepwise_on_nulls, stlsq, stlsq_on_nulls

WEAK = Way("weak", 15)
# usual size of the second truth over that of the library; the signs are those of the library's own words
HIDDEN = {
    "Cl_alpha_beta": -1.0,
    "Ixz_error": 1.5,
    "motor_torque": -1.0,
    "rudder_lag": 1.0,
    "beta_lag": 1.0,
    "imu_lever_arm": 1.33,
    "time_skew": 1.07,
    "wind_shear": 1.33,
}


def test_the_library_holds_every_form_of_every_effect_that_applies() -> None:
    model = load_model("lateral", "cdfp")
    wanted = {(e.name, f.label) for e in catalogue() if not e.tied_to for f in e.applicable(model)}
    held = [(h.effect, h.form) for h in LIBRARY]
    assert set(held) == wanted
    assert len(held) == len(wanted)


@pytest.mark.parametrize("way", [Way("savgol", 7), Way("weak", 5), WEAK, Way("weak cubic", 9)], ids=lambda w: w.name)
def test_rate_and_value_belong_together(way: Way) -> None:
    """A signal and its exact rate agree to a thousandth, away from the ends."""
    step = 0.05
    t = step * np.arange(300)
    x, rate = np.sin(1.3 * t), 1.3 * np.cos(1.3 * t)
    off = (way.rate(x, step) - way.value(rate))[10:-10]
    assert np.abs(off).max() < 2e-3


def test_lag_delay_and_play() -> None:
    step = 0.05
    t = step * np.arange(400)
    fine = np.linspace(0.0, t[-1], 20 * (t.size - 1) + 1)
    x = np.interp(fine, t, np.sin(t))  # straight between the samples, as the lag has it
    slow = np.zeros_like(fine)
    for k in range(1, fine.size):
        slow[k] = slow[k - 1] + (fine[1] - fine[0]) / 0.1 * (0.5 * (x[k] + x[k - 1]) - slow[k - 1])
    np.testing.assert_allclose(lagged(np.sin(t), 0.1, step), slow[::20], atol=3e-3)
    np.testing.assert_allclose(late(np.sin(t), 0.07, step)[10:-10], np.sin(t - 0.07)[10:-10], atol=1e-6)
    loose = with_play(np.array([0.0, 1.0, 2.0, 1.5, 0.0]), 1.0)
    assert loose.tolist() == [0.0, 0.5, 1.5, 1.5, 0.5]


def test_a_hidden_effect_is_found_with_its_size() -> None:
    """Calm flights: the coefficient of the effect's own column, alone beside the base terms, is what was hidden."""
    constants = load_model("lateral", load_aircraft("cdfp")).constants
    requests = [
        truth.Request(70 + i, v, {n: 1.0}, gust=0.0, duration=20.0)
        for n in HIDDEN
        for i, v in enumerate((14.5, 16.5, 19.0))
    ]
    flown = flights(truth.fly(requests))
    for at, (name, size) in enumerate(HIDDEN.items()):
        three = [signals(f, constants) for f in flown[3 * at : 3 * at + 3]]
        gram = evidence(three, [WEAK])[WEAK.name].sum(axis=0)
        first = next(j for j, h in enumerate(LIBRARY) if h.effect == name)
        assert gram[first, -1] / gram[first, first] == pytest.approx(size, abs=0.2), name


def flown(rng: np.random.Generator, hidden: float) -> Regression:
    """Evidence of one set and 60 nulls: every flight has a bias along column 3, the set itself something along column 7."""
    n, samples = len(LIBRARY), 400
    grams = []
    for k in range(61):
        columns = rng.standard_normal((5, samples, n))
        left = 0.5 * columns[..., 3] + rng.standard_normal((5, samples))
        if k == 0:
            left += hidden * columns[..., 7]
        M = np.concatenate([columns, left[..., None]], axis=-1)
        grams.append(np.einsum("eti,etj->eij", M, M))
    return Regression.joint(np.stack(grams), samples)


def test_standardising_on_nulls_takes_away_what_every_flight_has(rng: np.random.Generator) -> None:
    with_effect = flown(rng, 0.25)
    assert stepwise(with_effect).effect == LIBRARY[3].effect
    named = stepwise_on_nulls(with_effect)
    assert named["score"].effect == LIBRARY[7].effect
    assert named["score"].margin > 1.5
    calm = stepwise_on_nulls(flown(rng, 0.0))["score"]
    assert calm.margin < 1.5


def test_pysindy_names_the_same(rng: np.random.Generator) -> None:
    pytest.importorskip("pysindy", reason="pip install '.[study]'")
    with_effect = flown(rng, 0.25)
    assert stlsq(with_effect)["ridge 0.05, threshold 0.1"] == LIBRARY[3].effect
    assert stlsq_on_nulls(with_effect, 0.05).effect == LIBRARY[7].effect
