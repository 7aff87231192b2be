"""Standing still, on the tail, or with a sensor off: no advice, no error, and advice again in the next flight."""

import math

import numpy as np
import pytest

from daq.identification.airframe import Sample
from daq.identification.next_manoeuvre import LIBRARY, has_condition, predicted_columns
from sideslip.live_aircraft import live_aircraft

FLYING = Sample(
    time=1.0, beta=0.0, p=0.0, q=0.0, r=0.0, phi=0.0, theta=0.05, alpha=0.05, V=17.0, ay=0.0, delta_a=0.0, delta_r=0.0, rho=1.17,
)  # fmt: skip


@pytest.mark.parametrize(
    "changes",
    [
        {"V": 0.0},
        {"V": 1e-300},
        {"V": -3.0},
        {"V": math.nan},
        {"rho": 0.0},
        {"theta": math.pi / 2},
        {"alpha": math.inf},
    ],
)
def test_what_is_no_flight_condition_adds_nothing_and_raises_nothing(changes: dict[str, float]) -> None:
    airframe = live_aircraft("cdfp").airframe
    still = FLYING._replace(**changes)
    assert not has_condition(still)
    for candidate in LIBRARY:
        columns, share = predicted_columns(
            airframe, {n: airframe.believed(n) for n in airframe.beliefs}, candidate, still
        )
        assert not columns.any()
        assert share == 1.0


def test_a_flight_condition_has_the_same_rows_and_information_in_them() -> None:
    airframe = live_aircraft("cdfp").airframe
    values = {n: airframe.believed(n) for n in airframe.beliefs}
    flown, _ = predicted_columns(airframe, values, LIBRARY[0], FLYING)
    still, _ = predicted_columns(airframe, values, LIBRARY[0], FLYING._replace(V=0.0))
    assert flown.shape == still.shape
    assert np.isfinite(flown).all()
    assert flown.any()
