"""Controls whose noise the gyros show: prepared as where they pitch, and no nameless term; and what such terms are made of."""

from itertools import islice

import numpy as np
import pytest

from estimation.errors import GapError
from estimation.gap.criteria import AS_SET
from estimation.gap.fit.baseline import fit_baseline
from estimation.gap.records.flight_records import prepare_flights
from estimation.gap.significance import calibration
from estimation.gap.significance.calibration import Round, screen_round
from estimation.gap.significance.measured_again import MeasuredAgain, own_shares
from estimation.gap.significance.omnibus import OmnibusSignal, beyond_control_noise, nameless_terms, regressors_of
from estimation.gap.workflow import Options, _setting
from groundstation.flight import Flight
from tests.unit.estimation.gap.roll import ROLL

DEG = np.pi / 180
STEPS, DURATION = 50, 30.0  # a step of 1 ms each sample of 50 ms; s


def rolling(seed: int, gyro: float, control: float = 0.07 * DEG, bend: float = 0.0) -> Flight:
    """Roll by doublets and a hand that holds the bank, p' = -6 p + 40 da + bend p|p|; noise of gyro and aileron [rad/s, rad]."""
    rng = np.random.default_rng(seed)
    count = round(DURATION / 1e-3)
    p, bank, arm, rows = 0.0, 0.0, 0.0, []
    for k in range(count):
        t = 1e-3 * k
        doublet = 0.05 * (np.floor((t % 5.0) / 0.4) == 1) - 0.05 * (np.floor((t % 5.0) / 0.4) == 2)
        arm += 1e-3 / 0.035 * (doublet - 0.2 * bank - 0.1 * p - arm)
        if k % STEPS == 0:
            rows.append((p, arm))
        p += 1e-3 * (-6.0 * p + 40.0 * arm + bend * p * abs(p))
        bank += 1e-3 * p
    rates, arms = np.array(rows).T
    columns = {
        "p": rates + gyro * rng.standard_normal(rates.size),
        "delta_a": arms + control * rng.standard_normal(arms.size),
    }
    return Flight.build(f"roll{seed}", 0.05 * np.arange(rates.size), columns)


@pytest.mark.parametrize(("gyro", "exact"), [(0.04 * DEG, True), (0.8 * DEG, False)])
def test_an_aileron_whose_noise_a_quiet_gyro_shows_keeps_what_follows_the_motion(gyro: float, exact: bool) -> None:
    flights = [rolling(seed, gyro) for seed in (31, 32)]
    records = prepare_flights(ROLL, (), flights, (), AS_SET).records
    for record, flight in zip(records, flights, strict=True):
        assert bool(record.raw) is exact
        assert ("delta_a" in record.follows) is exact
        if exact:
            raw, measured = record.raw["delta_a"], flight.columns["delta_a"][: len(record)]
            assert 0.1 < raw.mean() < 0.8
            np.testing.assert_array_equal(record.inputs["delta_a"][raw], measured[raw])


def screened(bend: float, control: float, every: int = 1) -> Round:
    """Three flights as a screen has them, of which the gyro is known in `every` sample."""
    flights = [rolling(seed, 0.04 * DEG, control, bend) for seed in (41, 42, 43)]
    known = [np.arange(len(f.time)) % every == 0 for f in flights]
    pairs = zip(flights, known, strict=True)
    flights = [f.with_columns(p=np.where(k, f.columns["p"], np.nan)) for f, k in pairs]
    options = Options(seed=1, nulls=40)
    prepared = prepare_flights(ROLL, (), flights, (), options.criteria)
    setting = _setting(prepared, (), {}, {}, {}, options, lambda what, share: None)
    baseline = fit_baseline(setting.working, setting.clean, setting.prepared, setting.scatter)
    return screen_round(baseline, setting.prepared, (), setting.errors, 40, 1)


def strongest(round_: Round) -> OmnibusSignal:
    return max(nameless_terms(round_.tangent)[0], key=lambda s: s.score)


def test_a_nameless_term_that_is_there_stands_beyond_the_noise_of_the_controls() -> None:
    round_ = screened(-6.0, 0.07 * DEG)
    before = strongest(round_)
    (after,) = beyond_control_noise(MeasuredAgain(round_.baseline, 1), [before])
    assert after.score > 0.5 * before.score > 5.0


def test_what_the_noise_of_a_control_makes_is_no_nameless_term() -> None:
    """0.4 deg of noise on an aileron, as measured by its steps: rolling less than it says."""
    round_ = screened(0.0, 0.4 * DEG)
    before = strongest(round_)
    (after,) = beyond_control_noise(MeasuredAgain(round_.baseline, 1), [before])
    assert after.score < 0.8 * before.score
    again = MeasuredAgain(round_.baseline, 1)
    for (problem, found), remade in zip(again.problems(), again.sets, strict=True):
        for whitener, residual, record in zip(problem.whiteners, found.residuals, remade, strict=True):
            assert whitener.energy(residual) == pytest.approx(record.energy)


def test_a_mean_of_the_other_sign_takes_nothing_and_a_larger_one_all() -> None:
    shares = own_shares(np.array([6.0, -6.0, 6.0, 2.0]), np.array([1.5, -1.5, -1.5, 3.0]))
    np.testing.assert_allclose(shares, [0.75, 0.75, 1.0, 0.0])


def test_a_term_of_an_output_that_is_logged_more_rarely_is_made_of_its_motion() -> None:
    """Nothing where nobody measured made its rate a comb, and energy between the samples a scatter that grows with it."""
    often, rarely = screened(0.0, 0.07 * DEG).baseline, screened(0.0, 0.07 * DEG, every=2).baseline
    for shape in ("linear", "rate"):
        every, half = (regressors_of(b.problem, b.fit, 0)[("p", shape)] for b in (often, rarely))
        assert np.std(every - half) < 0.05 * np.std(every)


def test_nulls_that_run_away_leave_a_threshold_by_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """A cubic pitching moment of usual size was found, and forgotten since 17 of 40 nulls with it ran away."""
    fly = calibration.fly_nulls
    monkeypatch.setattr(calibration, "fly_nulls", lambda *given: islice(fly(*given), 6))
    assert len(screened(0.0, 0.07 * DEG).null_residuals) == 6
    monkeypatch.setattr(calibration, "fly_nulls", lambda *given: islice(fly(*given), 5))
    with pytest.raises(GapError, match="only 5 of 40"):
        screened(0.0, 0.07 * DEG)
