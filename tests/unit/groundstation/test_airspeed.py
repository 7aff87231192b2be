"""What the calibration of an airspeed is worth in flight, however long the recording lasted on the ground."""

import numpy as np
import pytest

from groundstation.calibration.account import column_uncertainty
from groundstation.calibration.calibration_set import load_calibration
from groundstation.flight.airspeed import calibration_error

AIR = np.full(400, 15.0)
GROUND = np.linspace(0.0, 1.0, 600)  # m/s: what noise of a pressure at rest makes


@pytest.mark.parametrize("V", [AIR, np.r_[GROUND, AIR], np.r_[np.zeros(600), AIR, np.nan]])
def test_an_airspeed_is_known_in_flight_as_its_calibration_says(V: np.ndarray) -> None:
    assert calibration_error({"uncertainty": {"V": 0.3}}, V) == pytest.approx(0.02)


@pytest.mark.parametrize("sigma", [None, 0.0, -1.0, float("inf"), float("nan"), "0.3"])
def test_what_is_no_standard_deviation_states_nothing(sigma: object) -> None:
    assert calibration_error({"uncertainty": {"V": sigma}}, AIR) == 0.0


def test_nothing_is_stated_of_a_recording_without_a_flight() -> None:
    assert calibration_error({"uncertainty": {"V": 0.3}}, GROUND) == 0.0
    assert calibration_error({}, AIR) == calibration_error({"uncertainty": "V"}, AIR) == 0.0


def test_time_on_the_ground_makes_no_airspeed_less_sure() -> None:
    """5 Pa are 1.9 % of 15 m/s, and 4 m/s at 1 m/s."""

    def stated(V: np.ndarray) -> float:
        still = {"rho": 1.2, "p_static": 1e5, "temperature": 290.0}
        columns = {n: np.full(V.size, v) for n, v in still.items()} | {"V": V, "p_dynamic": 0.6 * V**2}
        triads = {n: np.full(V.size, np.nan) for n in ("ax", "ay", "az", "p", "q", "r", "mx", "my", "mz")}
        return column_uncertainty(load_calibration("cdfp"), columns | triads)["V"]

    assert stated(np.r_[GROUND, AIR]) == pytest.approx(stated(AIR))
