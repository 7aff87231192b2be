"""Speed and memory of Neural Gauss-Newton on the project's own code: make bench. Times are of this machine, now."""

import resource
import time

import numpy as np
import pytest

from estimation.aircraft import load_aircraft
from estimation.estimators.neural_gauss_newton import estimate_ngn
from estimation.estimators.neural_gauss_newton.axes import LateralAxis
from estimation.estimators.neural_gauss_newton.campaign import CampaignOptions, train_campaign
from estimation.estimators.neural_gauss_newton.formulation import Rows
from tests.estimation.truth import NOISE, Case, fly


@pytest.mark.benchmark
def test_networks_of_a_bootstrap() -> None:
    """64 bootstrap networks for one 30 s flight: under 60 s on two cores, under 1 GB."""
    aircraft = load_aircraft("cdfp")
    flight = fly(Case(noise=NOISE), np.random.default_rng(1))[0][0]
    rows = Rows.build(LateralAxis(aircraft), [flight], "interval")
    begin = time.perf_counter()
    networks = train_campaign([rows], CampaignOptions(bootstraps=64))
    seconds = time.perf_counter() - begin
    assert networks[0].shape[0] == 64
    begin = time.perf_counter()
    for improved in (False, True):
        estimate_ngn(aircraft, flight, improved=improved)
    each = (time.perf_counter() - begin) / 2
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(
        f"\n64 bootstrap networks {seconds:.1f} s; one estimate with intervals {each:.1f} s; peak memory {peak:.0f} MB"
    )
    assert seconds < 60.0
    assert peak < 1024.0
