"""An attitude that a filter logs more rarely than the record: recognised, and between its values as the gyros say."""

import numpy as np
import pytest

from estimation.engine.kernel import Array
from estimation.gap.criteria import AS_SET
from estimation.gap.records.sampling import white_share, with_attitudes_between
from groundstation.flight import Flight, Provenance
from groundstation.flight.arrays import integral

DEG = np.pi / 180
TIME = 0.02 * np.arange(1500)


def turning(rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """(p, measured p, true bank) of a wing that rocks, slowly and in bursts."""
    p = 0.3 * np.sin(0.9 * TIME) + 0.8 * np.sin(9.0 * TIME) * (np.sin(0.5 * TIME) > 0.8)
    return p, p + 0.4 * DEG * rng.standard_normal(p.size), integral(TIME, p)


def drifting(rng: np.random.Generator) -> Array:
    """A filter's error of 0.5 deg that is forgotten in five seconds."""
    error, keep = np.zeros(TIME.size), np.exp(-0.02 / 5.0)
    for k in range(1, TIME.size):
        error[k] = keep * error[k - 1] + 0.5 * DEG * np.sqrt(1.0 - keep**2) * rng.standard_normal()
    return error


@pytest.mark.parametrize("way", ["held", "lines", "empty"])
def test_a_filters_bank_goes_as_the_gyros_say_between_its_values(way: str) -> None:
    rng = np.random.default_rng(11)
    _, measured, bank = turning(rng)
    filtered = bank + drifting(rng)
    index, logged = np.arange(TIME.size), filtered[::5]
    shown = {"held": np.repeat(logged, 5), "lines": np.interp(index, index[::5], logged)}.get(way)
    shown = np.where(index % 5 == 0, filtered, np.nan) if shown is None else shown
    still = np.zeros(TIME.size)
    flight = Flight.build("f", TIME, {"p": measured, "q": still, "r": still, "phi": shown, "theta": still})
    filled = with_attitudes_between(flight, AS_SET)
    assert np.isfinite(filled["phi"]).all()
    assert np.std(filled["phi"] - filtered) < 0.1 * DEG  # held it is 1.0 deg off, on lines 0.16
    assert any("phi is a filter's, logged at 10 Hz" in str(n) for n in filled.notes)


@pytest.mark.parametrize("afresh", [False, True])
def test_lines_between_instants_on_no_sample_get_back_what_they_cut_off(afresh: bool) -> None:
    """A log of 25 Hz, its instants 7 ms beside the samples of 50 Hz: no sample shows a value of the filter's."""
    rng = np.random.default_rng(14)
    p = 1.5 * np.sin(6.0 * TIME)
    bank = integral(TIME, p)
    true = bank + (0.3 * DEG * rng.standard_normal(bank.size) if afresh else drifting(rng) * 0.1)
    instants = np.arange(TIME[0] + 0.007, TIME[-1] - 0.02, 0.04)
    shown = np.interp(TIME, instants, np.interp(instants, TIME, true))
    still, turned = np.zeros(TIME.size), p + 0.1 * DEG * rng.standard_normal(p.size)
    columns = {"p": turned, "q": still, "r": still, "phi": shown, "theta": still}
    detail = {"native_hz": {"phi": 25.0}}
    flight = Flight.build("f", TIME, columns, provenance=Provenance(detail=detail))
    filled = with_attitudes_between(flight, AS_SET)
    if afresh:
        assert filled is flight
        return
    inside = slice(5, -5)
    cut_off, left = (float(np.std((f["phi"] - true)[inside])) for f in (flight, filled))
    assert left < 0.5 * cut_off
    assert any("phi is a filter's, logged at 25 Hz" in str(n) for n in filled.notes)


def test_a_bank_measured_afresh_ten_times_a_second_stays_as_it_is() -> None:
    rng = np.random.default_rng(12)
    _, measured, bank = turning(rng)
    shown = np.repeat((bank + 0.3 * DEG * rng.standard_normal(bank.size))[::5], 5)
    still = np.zeros(TIME.size)
    flight = Flight.build("f", TIME, {"p": measured, "q": still, "r": still, "phi": shown, "theta": still})
    assert with_attitudes_between(flight, AS_SET) is flight


def test_lateness_makes_a_measured_attitude_no_filters() -> None:
    """What the rate changes times the lateness is no white noise, and is larger than it in manoeuvres."""
    rng = np.random.default_rng(13)
    p, measured, bank = turning(rng)
    late = bank - 0.1 * p + 0.1 * DEG * rng.standard_normal(bank.size)
    assert white_share(late, integral(TIME, measured)) > 0.8
    assert white_share(bank + drifting(rng), integral(TIME, measured)) < 0.2
    assert white_share(bank[:20], bank[:20]) == 1.0  # too few to say
