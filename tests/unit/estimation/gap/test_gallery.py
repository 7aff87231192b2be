"""Flights of an aircraft of another size, flown by JSBSim, through the whole workflow; all of them are a study."""

import pytest

pytest.importorskip("jsbsim", reason="JSBSim is not installed: pip install '.[jsbsim]'")

from tests.studies.gap_gallery import HIDDEN, KINDS, ROWS, judged, one_line, outcome  # needs jsbsim

L17 = next(k for k in KINDS if k.name == "L17")


@pytest.mark.study
def test_a_log_of_commands_of_an_aircraft_without_beliefs() -> None:
    """1.3 t, 20 Hz, no derivative believed: the servos are named with their 40 ms, and yaw by aileron, which the L-17 has."""
    found = outcome(L17, ROWS[0], "commands", 1, 40)
    assert judged(found) == "right", one_line(found)
    assert [s["effect"] for s in found["steps"]] == ["servo_lag", "Cn_da"]
    lag, bound = found["steps"][0]["estimates"]["servo_lag"]
    assert abs(lag - 0.04) < max(3.0 * bound, 0.006)
    assert "Cn_da" in found["present"]


def test_names_are_judged_by_what_is_in_the_aircraft_and_its_record() -> None:
    said = {
        "row": ROWS[0].title,
        "hidden": "beta_lag",
        "present": {"Cn_da": 1.0},
        "cannot": [],
        "verdict": "gap_closed",
    }

    def named(*effects: str, **change: object) -> str:
        return judged({**said, "steps": [{"effect": e} for e in effects], **change})

    assert named("beta_lag", "Cn_da") == "right"
    assert named("Cn_da") == "missed"
    assert named("beta_lag", "gyro_scale") == "wrong"
    assert named("unknown", verdict="unknown_effect") == "honest"
    assert named(cannot=["beta_lag"], verdict="no_gap") == "honest"
    assert named(hidden="nothing") == "right"
    assert set(HIDDEN) >= {"nothing", "commands", "nothing in pitch"}
