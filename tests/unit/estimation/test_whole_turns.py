"""Headings through whole turns, and between records that lie in a row, are no other unit."""

import numpy as np
import pytest

from estimation.compatibility.records import records_of
from estimation.errors import DataError
from estimation.models.kinematic import compatibility_model
from estimation.prepare.conditioned import condition_columns
from groundstation.flight import Flight


def circling(rate: float, unit: float = 1.0) -> Flight:
    rng = np.random.default_rng(9)
    t = np.arange(0.0, 60.0, 0.04)
    noise = {
        n: 0.01 * rng.standard_normal(t.size)
        for n in ("p", "q", "r", "phi", "theta", "ax", "ay", "az", "alpha", "beta", "V")
    }
    psi = (rate * t + np.pi) % (2 * np.pi) - np.pi
    level = {"r": rate, "az": -9.8, "V": 18.0}
    return Flight.build("circle", t, {**{n: v + level.get(n, 0.0) for n, v in noise.items()}, "psi": unit * psi})


@pytest.mark.parametrize("rate", [0.4, -0.9])
def test_circles_are_no_other_unit_and_degrees_are(rate: float) -> None:
    model = compatibility_model()
    records, _ = records_of(model, condition_columns(circling(rate), ("psi",)).flight)
    assert len(records) == 1
    with pytest.raises(DataError, match="psi is beyond"):
        records_of(model, condition_columns(circling(rate, 180.0 / np.pi), ("psi",)).flight)


def test_a_heading_of_another_record_is_no_turn() -> None:
    t = np.arange(0.0, 40.0, 0.1)
    second = t > 20.0
    flight = Flight.build(
        "two", t + 300.0 * second, {"psi": np.where(second, 1.65, -1.6)}, segment=second.astype(np.int64)
    )
    assert np.ptp(condition_columns(flight, ("psi",)).flight["psi"]) == pytest.approx(3.25)
