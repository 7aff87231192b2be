"""Units that a model of one's own states: the flight format's, in whatever spelling, or the fit is refused."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.errors import DataError
from estimation.models import load_model
from estimation.models.base import Model
from estimation.prepare.pipeline import prepare
from tests.unit.estimation.truth import NOISE, Case, fly

LATERAL = load_model("lateral", "cdfp")
FLIGHT = fly(Case(seconds=8.0, noise=NOISE), np.random.default_rng(4))[0][0]


def with_unit(kind: str, name: str, unit: str) -> Model:
    """The lateral model with one signal in another unit."""
    signals = tuple(replace(s, unit=unit) if s.name == name else s for s in getattr(LATERAL, kind))
    return replace(LATERAL, **{kind: signals})


@pytest.mark.parametrize(
    ("kind", "name", "unit"),
    [("inputs", "V", "km/h"), ("inputs", "delta_r", "deg"), ("states", "p", "deg/s"), ("outputs", "ay", "g")],
)
def test_a_unit_that_flights_do_not_hold_is_refused_by_name(kind: str, name: str, unit: str) -> None:
    with pytest.raises(DataError, match=rf"states {name} in {unit}"):
        prepare(with_unit(kind, name, unit), FLIGHT)


@pytest.mark.parametrize(
    ("kind", "name", "unit"), [("outputs", "ay", "m/s^2"), ("inputs", "V", "m s-1"), ("inputs", "delta_r", "")]
)
def test_other_spellings_and_no_unit_at_all_are_taken(kind: str, name: str, unit: str) -> None:
    assert prepare(with_unit(kind, name, unit), FLIGHT).used == len(FLIGHT)
