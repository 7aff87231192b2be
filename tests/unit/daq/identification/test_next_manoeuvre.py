"""What to fly next: the linear motion against the estimator's own nonlinear one, and advice that is kept when it is flown."""

import math
from dataclasses import replace

import numpy as np
import pytest

from daq.identification.airframe import DERIVATIVES, EQUATIONS, Airframe, Belief, Sample
from daq.identification.estimates import EquationInformation
from daq.identification.next_manoeuvre import (
    LIBRARY,
    CandidateManoeuvre,
    linear_lateral,
    next_manoeuvre,
    predicted_columns,
)
from daq.identification.simulated_motion import LateralState, MotionInputs, SimulatedMotion
from tests.studies.live_statistics import Case, airframe_for

LEVEL = Sample(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.08, 0.08, 17.0, 0.0, 0.0, 0.0, 1.2)


@pytest.fixture(scope="module")
def airframe() -> Airframe:
    return airframe_for(Case("second", 0.1, False))


def test_linear_motion_is_the_slope_of_the_simulated_one(airframe: Airframe) -> None:
    values = {n: airframe.believed(n) for n in DERIVATIVES}
    A, B = linear_lateral(airframe, values, LEVEL)
    motion = SimulatedMotion(airframe)
    motion.values = {n: 0.0 if n.endswith("_0") else v for n, v in values.items()}

    def rates(x: list[float]) -> np.ndarray:
        drive = MotionInputs(0.0, LEVEL.theta, LEVEL.alpha, LEVEL.V, LEVEL.rho, x[4], x[5])
        return np.array(motion.rates(LateralState(*x[:4]), drive))

    step = 1e-5
    for i in range(6):
        x = [0.0] * 6
        x[i] = step
        slope = (rates(x) - rates([-v for v in x])) / (2 * step)
        np.testing.assert_allclose(slope, np.column_stack([A, B])[:, i], rtol=1e-6, atol=1e-9)


def _informed(airframe: Airframe, columns: dict[str, np.ndarray], noise: float) -> dict[str, EquationInformation]:
    found = {}
    for c, terms in EQUATIONS.items():
        pick = tuple(("0", "beta", "p", "r", "da", "dr").index(t) for t in terms)
        own = columns[c][:, list(pick)]
        normal = own.T @ own
        found[c] = EquationInformation(tuple(f"{c}_{t}" for t in terms), pick, normal, noise * np.linalg.inv(normal))
    return found


def test_advice_is_what_lowers_the_worst_bound_most(airframe: Airframe) -> None:
    """Brute force over the library, bounds from least squares on all rows together."""
    values = {n: airframe.believed(n) for n in DERIVATIVES}
    flown, _ = predicted_columns(airframe, values, CandidateManoeuvre("", "doublet", "doublet"), LEVEL)
    noise = 1e-3
    known = _informed(airframe, dict.fromkeys(EQUATIONS, flown), noise)
    wanted = {n: 0.01 * abs(v) for n, v in values.items() if not n.endswith("_0")}
    advice = next_manoeuvre(airframe, values, known, wanted, LEVEL)
    assert advice is not None
    worst = {}
    for candidate in LIBRARY:
        more, share = predicted_columns(airframe, values, candidate, LEVEL)
        both = _informed(airframe, dict.fromkeys(EQUATIONS, np.vstack([flown, more])), noise)
        worst[candidate.title] = max(
            math.sqrt(b) / wanted[f"{c}_{t}"]
            for c, terms in EQUATIONS.items()
            for t, b in zip(terms, np.diag(both[c].covariance), strict=True)
        )
        assert 0.0 < share <= 1.0
    assert advice.manoeuvre == min(worst, key=lambda t: worst[t])
    assert advice.then < advice.now


def test_no_advice_where_all_is_reached_or_nothing_is_known(airframe: Airframe) -> None:
    values = {n: airframe.believed(n) for n in DERIVATIVES}
    flown, _ = predicted_columns(airframe, values, CandidateManoeuvre("", "doublet", "doublet"), LEVEL)
    known = _informed(airframe, dict.fromkeys(EQUATIONS, flown), 1e-3)
    assert next_manoeuvre(airframe, values, known, dict.fromkeys(DERIVATIVES, 1e9), LEVEL) is None
    assert next_manoeuvre(airframe, values, {}, dict.fromkeys(DERIVATIVES, 1e-9), LEVEL) is None


def test_a_lively_aircraft_is_advised_smaller_manoeuvres(airframe: Airframe) -> None:
    lively = {n: airframe.believed(n) * (3.0 if n in ("Cl_da", "Cn_dr") else 1.0) for n in DERIVATIVES}
    usual = {n: airframe.believed(n) for n in DERIVATIVES}
    candidate = CandidateManoeuvre("", aileron="slow doublet")
    _, large = predicted_columns(airframe, usual, candidate, LEVEL)
    _, small = predicted_columns(airframe, lively, candidate, LEVEL)
    assert small < large
    columns, share = predicted_columns(replace(airframe, beliefs={"Cl_p": Belief(-0.4, 0.1)}), lively, candidate, LEVEL)
    np.testing.assert_allclose(columns, predicted_columns(airframe, lively, candidate, LEVEL)[0])
    assert share == small
