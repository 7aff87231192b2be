"""Properties of the onboard sequencer over random histories; thousands more in tests/studies/sequencer_histories.py."""

from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from daq.actuation.motion import MotionState
from daq.actuation.output import FrameObservation, OutputObservation
from daq.actuation.pwm.output import FrequencyProof
from daq.actuation.sequencer import Sequencer
from daq.actuation.servos import plan_of, servos_of
from daq.contract.sequencing import TRANSITIONS, State, Switch
from tests.unit.daq.sequencer_histories import Happening, History, histories, played, unhindered
from tests.unit.daq.sequencer_rig import sequencer_config, short_manoeuvre

QUIET = History(10, 60, "switch", 0.004, ())


@settings(max_examples=20, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(histories)
@example(QUIET)
@example(History(10, 60, "switch", 0.004, (Happening("dead", 100, 5, 0.0),)))
@example(History(10, 60, "switch", 0.004, (Happening("stall", 100, 1, 1.0),)))
@example(History(10, 60, "switch", 0.004, (Happening("bus held", 100, 30, 1.0),)))
@example(History(10, 60, "switch", 0.004, (Happening("heartbeat", 100, 30, 1.0),)))
@example(History(10, 60, "ground", 0.018, (Happening("switch between", 100, 30, 1.0),)))
def test_the_pilot_always_wins(history: History) -> None:
    assert played(history).faults() == []


def test_such_histories_do_fly() -> None:
    """Without mishaps the manoeuvre is flown, so that the property above is not one of a sequencer that never starts."""
    for start in ("switch", "ground"):
        assert played(unhindered(History(10, 60, start, 0.0, ()))).watch.running >= 50


motions = st.builds(
    MotionState,
    bank=st.none() | st.floats(-3.1, 3.1),
    load_factor=st.just(1.0) | st.none() | st.floats(-5.0, 5.0),
    airspeed=st.just(17.0) | st.none() | st.floats(0.0, 60.0),
    alpha=st.just(0.05) | st.none() | st.floats(-1.0, 1.0),
    height=st.just(60.0) | st.none() | st.floats(-10.0, 500.0),
)
widths = st.floats(900.0, 2100.0)
glimpses = st.tuples(
    st.integers(1, 60),
    st.sampled_from(Switch),
    st.none() | st.tuples(widths, widths, widths) | st.just((1500.0, 1500.0, 1500.0)),
    motions,
    st.none() | st.floats(1400.0, 1600.0),
    st.booleans(),
    st.sampled_from(("", "", "", "does not answer")),
    st.integers(0, 30),
)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.lists(glimpses, max_size=60), st.integers(0, 60))
def test_whatever_is_seen_gives_a_frame_in_its_limits(glimpsed: list[tuple], calm: int) -> None:  # type: ignore[type-arg]
    """The state machine alone: no input raises, no transition is outside the table, no pulse outside limits and slew."""
    config = sequencer_config(limits={"link_s": 1.0})
    servos = servos_of(config)
    sequencer = Sequencer(config, plan_of(short_manoeuvre(), config), servos, 0.02, FrequencyProof(1500.0, 50.0, 0.02))
    now, state, last = 0, State.IDLE, None
    well = MotionState(0.0, 1.0, 17.0, 0.05, 60.0)
    still = (1500.0, 1500.0, 1500.0)
    to_armed = [Switch.OFF] * 4 + [Switch.ARM] * 45 + [Switch.GO] * (10 + calm)
    seen = [(20, s, still, well, 1500.0, True, "", 0) for s in to_armed] + glimpsed
    for gap, switch, pilot, motion, loopback, recording, fault, late in seen:
        now += gap * 1_000_000
        frame = sequencer.decide_frame(
            FrameObservation(
                now,
                late * 1_000_000,
                motion,
                OutputObservation(switch, pilot, loopback_us=loopback, fault=fault, readback=(1500.0,) * 3),
                recording,
                0.1,
            )
        )
        assert frame.state is state or frame.state in TRANSITIONS[state]
        assert frame.state.beats is (frame.pulses is not None)
        if frame.state in (State.RUNNING, State.RAMPING):
            assert switch is Switch.GO
            for servo, width in zip(servos, frame.pulses or (), strict=True):
                assert servo.lowest_us <= width <= servo.highest_us
            if last is not None:
                for servo, a, b in zip(servos, last, frame.pulses or (), strict=True):
                    assert abs(a - b) <= servo.slew_us_per_s * min(gap * 1e-3, 0.04) + 1e-6
        elif frame.pulses is not None:
            assert frame.pulses == pilot
        last = frame.pulses if frame.state in (State.RUNNING, State.RAMPING) else None
        state = frame.state
