"""An ArduPlane tried out before the flight: each thing that is not as it must be, in words."""

from pathlib import Path

import pytest

from daq.actuation.actuation import Devices, findings
from daq.actuation.servos import TrialFinding
from firmware_sim.hardware.serial import SimulatedSerial
from firmware_sim.runs.flight import MANOEUVRE_FILE
from tests.unit.daq.autopilot_rig import AutopilotRig, autopilot_config
from tests.unit.daq.sequencer_rig import OFF, Flying, scan_of, switch_plan
from tests.unit.firmware_sim.px4 import Px4


def tried(rig: AutopilotRig, manoeuvre: Path = MANOEUVRE_FILE) -> dict[str, TrialFinding]:
    """What the trial finds of a rig's autopilot."""
    config = rig.config.model_copy(update={"manoeuvre": manoeuvre})
    devices = Devices(None, None, rig.clock, rig.port)
    return {f.what: f for f in findings(config, devices, lambda: scan_of(0, rig.now, Flying()))}


def test_all_is_well() -> None:
    rig = AutopilotRig(switch_plan((0.0, OFF)))
    found = tried(rig)
    assert list(found) == [
        "manoeuvre",
        "parameters",
        "autopilot",
        "autopilot stream",
        "pilot's signals",
        "override gate",
    ]
    assert all(f.well for f in found.values()), found
    assert "RC_OVERRIDE_TIME 0.1" in found["parameters"].text
    assert not rig.plane.rc.any_holds(rig.now)


@pytest.mark.parametrize(
    ("parameters", "what", "words"),
    [
        ({"RC_OVERRIDE_TIME": 3.0}, "parameters", "set it to 0.1"),
        ({"RC_OVERRIDE_TIME": 0.04}, "parameters", "at least 0.06"),
        ({"RC5_OPTION": 0.0, "RC6_OPTION": 46.0}, "parameters", "RC5_OPTION is 0; set it to 46"),
        ({"SYSID_MYGCS": 245.0}, "parameters", "set sequencer.autopilot.system_id"),
    ],
)
def test_parameters(parameters: dict[str, float], what: str, words: str) -> None:
    found = tried(AutopilotRig(switch_plan((0.0, OFF)), parameters=parameters))
    assert not found[what].well
    assert words in found[what].text
    assert "override gate" not in found


@pytest.mark.parametrize("loop_rate", [50.0, 60.0])
def test_a_loop_too_slow_for_the_stream_is_said_with_its_cure(loop_rate: float) -> None:
    found = tried(AutopilotRig(switch_plan((0.0, OFF)), parameters={"SCHED_LOOP_RATE": loop_rate}))
    assert not found["autopilot"].well
    assert "RC_CHANNELS at 50 Hz is denied (Requested rate for message ID 65 too fast." in found["autopilot"].text
    assert "set SCHED_LOOP_RATE to 63 or more, 100 advised" in found["autopilot"].text


def test_the_switch_is_to_be_at_off() -> None:
    found = tried(AutopilotRig(switch_plan((0.0, 1500.0))))
    assert found["pilot's signals"].text == "switch is at arm; put it to off"


def test_a_gate_that_does_not_hold() -> None:
    """The parameter says so, and the autopilot takes overrides all the same."""
    rig = AutopilotRig(switch_plan((0.0, OFF)))
    rig.plane.rc.read_switch = lambda now_ns: None  # type: ignore[method-assign]
    found = tried(rig)
    assert not found["override gate"].well
    assert "takes overrides though the switch is at off" in found["override gate"].text
    rig.plane.run_to(rig.now + 200_000_000)
    assert not rig.plane.rc.any_holds(rig.now + 200_000_000)


def test_a_mode_other_than_manual() -> None:
    rig = AutopilotRig(switch_plan((0.0, OFF)))
    rig.plane.set_mode(5, 0)
    assert "mode 5" in tried(rig)["autopilot"].text


def test_nobody_there() -> None:
    rig = AutopilotRig(switch_plan((0.0, OFF)))
    rig.plane.outward.lost = lambda now_ns: True
    found = tried(rig)
    assert list(found) == ["manoeuvre", "autopilot"]
    assert "is silent; check wiring, baud rate and MAVLink 2" in found["autopilot"].text


def test_a_px4_is_refused_in_a_sentence() -> None:
    rig = AutopilotRig(switch_plan((0.0, OFF)))
    rig.port = SimulatedSerial(Px4(rig.receiver), rig.clock.monotonic_ns)
    assert "PX4 takes either the sticks or MANUAL_CONTROL" in tried(rig)["autopilot"].text


def test_without_a_port() -> None:
    rig = AutopilotRig(switch_plan((0.0, OFF)))
    made = list(findings(autopilot_config(), Devices(None, None, rig.clock), lambda: scan_of(0, 0, Flying())))
    assert [f.well for f in made] == [False]
