"""The sequencer through a simulated ArduPlane: what it refuses, what ends it, and how soon the servos are the pilot's."""

import pytest
from hypothesis import HealthCheck, example, given, settings

from daq.actuation.autopilot.output import RELEASES, wrong_parameter
from daq.contract.sequencing import Reason, State
from tests.unit.daq.autopilot_histories import AutopilotHistory, histories, mixed, played
from tests.unit.daq.autopilot_rig import USUAL, AutopilotRig
from tests.unit.daq.sequencer_histories import Happening
from tests.unit.daq.sequencer_rig import ARM, GO, OFF, switch_plan

MS = 1_000_000
QUIET = AutopilotHistory(80, 130, "switch", ())


@settings(max_examples=24, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(histories)
@example(QUIET)
@example(AutopilotHistory(80, 130, "switch", (Happening("dead", 190, 5, 0.0),)))
@example(AutopilotHistory(80, 130, "switch", (Happening("stall", 190, 1, 1.0),)))
@example(AutopilotHistory(80, 130, "switch", (Happening("line lost", 190, 50, 1.0),)))
@example(
    AutopilotHistory(80, 130, "switch", (Happening("in late", 190, 50, 1.0), Happening("switch off", 200, 50, 1.0)))
)
@example(AutopilotHistory(80, 130, "ground", (Happening("mode", 195, 30, 1.0),)))
@example(
    AutopilotHistory(75, 120, "switch", (Happening("switch off", 68, 50, 0.0), Happening("switch arm", 135, 13, 0.0)))
)
def test_the_pilot_always_wins(history: AutopilotHistory) -> None:
    assert played(history).faults == []


def test_such_histories_do_fly() -> None:
    for start in ("switch", "ground"):
        run = played(AutopilotHistory(80, 130, start, ()))
        assert run.running >= 50
        assert run.worst.lapse > 100 * MS  # of the silence that is tried at go: the watch does see overrides


def running(**rig: object) -> AutopilotRig:
    """A rig in the middle of its manoeuvre."""
    made = AutopilotRig(switch_plan(*USUAL), **rig)  # type: ignore[arg-type]
    made.run_until(State.RUNNING)
    made.run(0.4)
    assert made.state is State.RUNNING
    return made


class TestWhatGoesOut:
    def test_servos_follow_the_increments(self) -> None:
        rig = running()
        increments = rig.book.frames[-4].increments  # three loops of 20 ms on the way
        roll, pitch, yaw = 1510 + rig_us(increments[1]), 1490, 1500 + rig_us(increments[2])
        assert rig.plane.outputs_us(rig.now)[:3] == pytest.approx(mixed((round(roll), pitch, round(yaw)), 0), abs=12)

    def test_nothing_is_overridden_before_and_after(self) -> None:
        rig = AutopilotRig(switch_plan(*USUAL))
        rig.run_until(State.CHECKING)
        assert not rig.plane.rc.any_holds(rig.now)
        rig.run_until(State.RELEASED)
        rig.run(0.1)
        assert not rig.plane.rc.any_holds(rig.now)
        assert rig.plane.outputs_us(rig.now)[:3] == mixed(rig.sticks, 0)

    def test_throttle_and_switch_are_never_touched(self) -> None:
        rig = running()
        rig.throttle = 1620
        rig.run(0.1)
        assert rig.plane.outputs_us(rig.now)[3] == 1620

    def test_a_second_manoeuvre_after_the_first(self) -> None:
        rig = AutopilotRig(switch_plan(*USUAL, (5.3, OFF), (6.0, ARM), (7.0, GO)))
        rig.run_until(State.RELEASED)
        rig.run_until(State.IDLE)
        asked = rig.output.link.parameters
        rig.run_until(State.RUNNING)
        assert rig.output.link.parameters is not asked  # read anew: somebody may have changed them
        rig.run_until(State.RELEASED)
        assert rig.reason is Reason.COMPLETE

    def test_the_sticks_are_recorded_as_not_seen(self) -> None:
        rig = running()
        assert rig.book.frames[-1].pilot_us == ()
        assert rig.book.frames[-1].output_us != ()


def rig_us(angle: float) -> float:
    return 1145.916 * angle


class TestRefused:
    @pytest.mark.parametrize(
        ("parameters", "words"),
        [
            ({"RC_OVERRIDE_TIME": 3.0}, "RC_OVERRIDE_TIME is 3 s; set it to 0.1"),
            ({"RC_OVERRIDE_TIME": 0.0}, "RC_OVERRIDE_TIME is 0 s"),
            ({"RC_OVERRIDE_TIME": -1.0}, "RC_OVERRIDE_TIME is -1 s"),
            ({"RC_OPTIONS": 34.0}, "RC_OPTIONS bit 1"),
            ({"SYSID_MYGCS": 254.0}, "SYSID_MYGCS is 254"),
            ({"MAV_GCS_SYSID": 245.0}, "MAV_GCS_SYSID is 245"),
            ({"RC5_OPTION": 0.0}, "RC5_OPTION is 0; set it to 46"),
        ],
    )
    def test_parameters(self, parameters: dict[str, float], words: str) -> None:
        rig = AutopilotRig(switch_plan(*USUAL), parameters=parameters)
        rig.run(2.4)
        assert (rig.state, rig.reason) == (State.RELEASED, Reason.AUTOPILOT)
        assert words in rig.book.warnings[-1]
        rig.run(2.0)
        assert not any(f.state == State.RUNNING or f.beating for f in rig.book.frames)

    def test_a_receiver_that_the_autopilot_ignores(self) -> None:
        """RC_OPTIONS bit 0: there is no switch to be seen."""
        rig = AutopilotRig(switch_plan(*USUAL), parameters={"RC_OPTIONS": 33.0})
        rig.run(4.0)
        assert rig.state is State.IDLE
        assert wrong_parameter(rig.output.link, rig.config.autopilot).startswith("RC_OPTIONS bit 0 is set")

    def test_another_mode(self) -> None:
        rig = AutopilotRig(switch_plan(*USUAL))
        rig.plane.set_mode(5, rig.now)
        rig.run(2.0)
        assert (rig.state, rig.reason) == (State.RELEASED, Reason.AUTOPILOT)
        assert "mode 5" in rig.book.warnings[-1]

    def test_a_gate_that_is_open_at_arm(self) -> None:
        """The switch was at off too shortly for the autopilot's debounce: what was allowed at go still is."""
        plan = switch_plan((0.0, OFF), (0.5, GO), (1.4, OFF), (1.55, ARM))
        rig = AutopilotRig(plan)
        rig.run(2.4)
        assert (rig.state, rig.reason) == (State.RELEASED, Reason.OVERRIDES)
        assert "though the switch is not at go" in rig.book.warnings[-1]

    def test_cleared_by_a_stick_held_out_of_trim(self) -> None:
        """RC_OPTIONS bit 14 lets nothing through then; 60 us are 3 deg of elevator."""
        rig = AutopilotRig(switch_plan(*USUAL), parameters={"RC_OPTIONS": float(32 | 1 << 14)})
        rig.sticks = (1500, 1560, 1500)
        rig.run(4.5)
        assert (rig.state, rig.reason) == (State.RELEASED, Reason.OVERRIDES)
        assert "they are not taken" in rig.book.warnings[-1]

    def test_an_autopilot_that_keeps_overrides(self) -> None:
        """Parameters say 0.1 s, and it holds them for 3 s all the same: only trying it shows."""
        rig = AutopilotRig(switch_plan(*USUAL))
        rig.plane.rc._parameters = {**rig.plane.parameters, "RC_OVERRIDE_TIME": 3.0}
        rig.run(4.5)
        assert (rig.state, rig.reason) == (State.RELEASED, Reason.OVERRIDES)
        assert "outlived RC_OVERRIDE_TIME" in rig.book.warnings[-1]


class TestEnds:
    def ends(self, rig: AutopilotRig, reason: Reason, within_s: float) -> None:
        left = rig.now
        rig.run_until(State.RELEASED, within_s)
        assert rig.reason is reason
        rig.run(0.12)
        assert rig.plane.outputs_us(rig.now)[:3] == mixed(rig.sticks, rig.plane.mode)
        assert rig.now - left < (within_s + 0.14) * 1e9

    def test_throttle(self) -> None:
        rig = running()
        rig.throttle += 60
        self.ends(rig, Reason.STICK, 0.12)

    def test_mode(self) -> None:
        rig = running()
        rig.plane.set_mode(5, rig.now)
        self.ends(rig, Reason.AUTOPILOT, 0.08)

    def test_a_parameter_changed_under_way(self) -> None:
        rig = running()
        rig.plane.parameters["RC_OVERRIDE_TIME"] = 3.0
        rig.plane._send_parameter("RC_OVERRIDE_TIME", rig.now)
        self.ends(rig, Reason.AUTOPILOT, 0.08)

    def test_a_stick_moved_with_bit_14(self) -> None:
        rig = running(parameters={"RC_OPTIONS": float(32 | 1 << 14)})
        rig.sticks = (1510, 1580, 1500)
        self.ends(rig, Reason.NOT_FOLLOWED, 0.4)

    def test_without_bit_14_a_moved_stick_is_not_seen(self) -> None:
        """Stated in docs/sequencer.md: his switch and his throttle are what he has."""
        rig = running()
        rig.sticks = (1510, 1700, 1500)
        rig.run(0.3)
        assert rig.state is State.RUNNING

    def test_releases_are_repeated(self) -> None:
        rig = running()
        sent: list[tuple[int, ...]] = []
        taken = rig.plane.rc.override
        rig.plane.rc.override = lambda values, now_ns: (sent.append(values), taken(values, now_ns))[1]  # type: ignore[method-assign]
        rig.actuation.request(None)
        rig.run_until(State.RELEASED)
        sent.clear()
        rig.run(0.5)
        assert sent[-RELEASES:] == [(0, 0, 65535, 0, 65535, 65535, 65535, 65535)] * RELEASES
        assert len(sent) <= RELEASES + 2

    @pytest.mark.parametrize("off_s", [4.0, 4.04, 4.11])
    def test_a_sender_that_runs_amok_is_ended_by_the_switch_alone(self, off_s: float) -> None:
        """RCn_OPTION 46: whatever our process sends, at off the servos are the pilot's, after debounce and 10 Hz look."""
        rig = AutopilotRig(switch_plan(*USUAL, (off_s, OFF)))
        rig.run_until(State.RUNNING)
        rig.alive = False
        while rig.now < off_s * 1e9 + 700 * MS:
            rig.output.link.override({1: 1800, 2: 1800, 4: 1800})
            rig.frame()
            mine = rig.plane.outputs_us(rig.now)[:3] == mixed(rig.sticks, 0)
            if off_s * 1e9 - 200 * MS < rig.now < off_s * 1e9:
                assert not mine
            if rig.now > off_s * 1e9 + 400 * MS:
                assert mine

    def test_a_receiver_that_falls_silent_is_not_noticed(self) -> None:
        """The autopilot takes overrides for a receiver that is alive; what is left are file, limits and ground."""
        rig = running()
        rig.receiver = lambda time_ns: None  # type: ignore[method-assign]
        rig.plane._receiver = rig.receiver
        rig.run(0.5)
        assert rig.state is State.RUNNING
        rig.run_until(State.RELEASED)
        assert rig.reason is Reason.COMPLETE
