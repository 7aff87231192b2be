"""Standing still, on the tail, or with a sensor off: no advice, no error, and advice again in the next flight."""

import math

import numpy as np
import pytest

from daq.identification import in_order
from daq.identification.airframe import Sample
from daq.identification.in_order import COPY_EVERY, HORIZON, OrderedEstimator
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


def test_four_horizons_of_samples_take_no_more_memory_than_one(monkeypatch: pytest.MonkeyPatch) -> None:
    horizon = HORIZON / 4.0
    monkeypatch.setattr(in_order, "HORIZON", horizon)
    ordered = OrderedEstimator(live_aircraft("cdfp").airframe)
    rng = np.random.default_rng(5)
    counts = []
    for n in range(9600):
        wave = 0.05 * math.sin(n * 0.07)
        sample = FLYING._replace(time=0.1 * n, p=wave, beta=0.3 * wave, delta_a=wave + 0.001 * float(rng.normal()))
        ordered.add(sample)
        if n % 2400 == 2399:
            counts.append((len(ordered._samples), len(ordered._copies)))
    assert counts[1:] == [counts[1]] * 3
    assert counts[1][0] < 10 * (horizon + 3 * COPY_EVERY)
    before = ordered.estimates()
    ordered.add(FLYING._replace(time=100.05))
    assert ordered.too_late == 1
    assert ordered.behind == 0
    assert ordered.estimates().rows == before.rows
    ordered.add(FLYING._replace(time=930.05))
    assert 0 < ordered.behind < 10 * 200
    while not ordered.work():
        pass
