"""A channel that was logged more slowly than the grid counts as often as it was logged, wherever its samples fall on the grid."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.prepare.conditioned import condition_columns, drawn_between
from groundstation.flight import RECONSTRUCTED, Flight, Provenance
from groundstation.flight.flight import CHANNELS


def on_a_grid(rate: float, phase: float, **detail: object) -> Flight:
    """20 s at 50 Hz of two channels logged at `rate`, drawn on straight lines, and one logged at 50 Hz."""
    rng = np.random.default_rng(3)
    time, own = np.arange(0.0, 20.0, 0.02), np.arange(-1.0, 21.0, 1.0 / rate) + phase
    columns = {n: np.interp(time, own, rng.standard_normal(own.size)) for n in ("p", "phi")}
    columns |= {"ay": rng.standard_normal(time.size), "beta": np.sin(time), "delta_a": np.sign(np.sin(3 * time))}
    rates = {"p": rate, "phi": rate, "ay": 50.0, "delta_a": rate}
    return Flight.build("grid", time, columns, provenance=Provenance(detail={"native_hz": rates, **detail}))


@pytest.mark.parametrize(("rate", "phase"), [(10.0, 0.0), (10.0, 0.013), (7.3, 0.05), (25.0, 0.008)])
def test_one_sample_stands_for_each_that_was_logged_and_lies_beside_it(rate: float, phase: float) -> None:
    flight = on_a_grid(rate, phase)
    drawn = drawn_between(flight, ["p", "phi", "ay"])
    assert set(drawn) == {"p", "phi"}
    at = flight.time[~drawn["p"]]
    assert at.size == pytest.approx(20.0 * rate, abs=2)
    own = np.arange(-1.0, 21.0, 1.0 / rate) + phase
    off = np.abs(at[:, None] - own).min(axis=1)
    assert np.median(off) <= 0.0101  # half a step of the grid
    np.testing.assert_array_equal(drawn["p"], drawn["phi"])


def test_what_was_reconstructed_counts_as_the_gyros_and_a_command_holds() -> None:
    about = {
        RECONSTRUCTED: {"columns": ["beta"], "std": {}},
        CHANNELS: {"delta_a": {"kind": "computed", "held": True, "interval_s": 0.1}},
    }
    flight = on_a_grid(10.0, 0.0, **about)
    drawn = drawn_between(flight, ["beta", "delta_a"])
    assert set(drawn) == {"beta"}
    assert (~drawn["beta"]).sum() == pytest.approx(200, abs=1)


def test_a_flight_that_states_no_rates_is_compared_throughout_and_so_is_one_on_request() -> None:
    flight = on_a_grid(10.0, 0.0)
    bare = replace(flight, provenance=Provenance())
    assert drawn_between(bare, ["p", "ay"]) == {}
    assert np.isfinite(condition_columns(flight, ["p"], keep_held=True).as_output("p")[0]).all()
    assert np.isfinite(condition_columns(flight, ["p"]).as_output("p")[0]).sum() == pytest.approx(200, abs=1)
