"""Made flights shared by the tests of estimation."""

import numpy as np
import pytest

from groundstation.flight import Flight
from tests.unit.estimation.truth import NOISE, Case, fly


@pytest.fixture(scope="session")
def made_flights() -> list[Flight]:
    """Four noisy 30 s flights with surfaces straight between samples."""
    return fly(Case(noise=NOISE, servo=None), np.random.default_rng(11), 4)[0]


@pytest.fixture(scope="session")
def clean_flight() -> Flight:
    """One flight without noise."""
    return fly(Case(servo=None), np.random.default_rng(1))[0][0]
