"""The onboard sequencer on simulated hardware: each way in, each way out, and what the servos get meanwhile."""

import math
from collections.abc import Callable

import pytest

from daq.actuation.servos import ServoManoeuvre, plan_of, servos_of
from daq.contract.manoeuvre import Manoeuvre, ManoeuvreError
from daq.contract.sequencing import TRANSITIONS, Exit, Reason, State, Switch, switch_position
from firmware_sim.hardware.bus import Disturbance
from tests.unit.daq.sequencer_rig import (
    ARM,
    GO,
    OFF,
    USUAL,
    Flying,
    Rig,
    sequencer_config,
    short_manoeuvre,
    switch_plan,
)

START_S = 1.26  # go is believed after three frames


def armed() -> Rig:
    rig = Rig(switch_plan(*USUAL))
    rig.run(1.15)
    assert rig.state is State.ARMED
    return rig


def running(**options: object) -> Rig:
    rig = Rig(switch_plan(*USUAL), **options)  # type: ignore[arg-type]
    rig.run(1.6)
    assert rig.state is State.RUNNING
    return rig


class TestFlown:
    def test_a_whole_manoeuvre(self) -> None:
        rig = Rig(switch_plan(*USUAL, (3.2, OFF)))
        rig.run(3.6)
        states = [State(f.state) for f in rig.book.frames]
        order = list(dict.fromkeys(states))
        assert order == [State.CHECKING, State.ARMED, State.RUNNING, State.RELEASED, State.IDLE]
        assert any(f.reason == Reason.COMPLETE for f in rig.book.frames)
        assert "flown to its end" in " ".join(rig.book.words)
        assert rig.state is State.IDLE

    def test_servos_follow_the_file_about_the_signals_at_the_start(self) -> None:
        rig = Rig(switch_plan(*USUAL))
        rig.sticks = (0.05, -0.03, 0.02)
        found: list[tuple[float, float, float, float]] = []
        rig.run(1.2)

        def note() -> None:
            if rig.state is State.RUNNING:
                c = rig.commands
                found.append((rig.now * 1e-9, c.left, c.right, c.rudder))

        rig.run(1.5, note)
        begin = next(f.time_monotonic_ns for f in rig.book.frames if f.state == State.RUNNING) * 1e-9
        step = math.radians(0.25)  # of the 12-bit driver, and its cycle of 20 ms
        worst = 0.0
        for time, left, right, rudder in found[5:]:
            near = [rig.plan.at(time - begin - d * 0.01) for d in range(7)]
            for value, base, gains in ((left, 0.05, (1, -1, 0)), (right, -0.03, (1, 1, 0)), (rudder, 0.02, (0, 0, 1))):
                wanted = [base + sum(g * i for g, i in zip(gains, n, strict=True)) for n in near]
                worst = max(worst, min(wanted) - value, value - max(wanted))
        assert len(found) > 60
        assert worst < step

    def test_started_by_the_ground(self) -> None:
        rig = Rig(switch_plan(*USUAL), config=sequencer_config(start="ground", wait_s=5.0))
        digest = int(rig.plan.digest[:6], 16)
        rig.run(1.0)
        assert "not at go" in rig.actuation.request(digest)
        rig.run(1.0)
        assert rig.state is State.ARMED
        assert "another manoeuvre" in rig.actuation.request(digest ^ 1)
        rig.run(0.1)
        assert rig.state is State.ARMED
        assert rig.actuation.request(digest) == ""
        rig.run(0.1)
        assert rig.state is State.RUNNING
        assert rig.actuation.request(None) == ""
        rig.run(0.4)
        assert (rig.state, rig.reason) == (State.RELEASED, Reason.GROUND)
        assert "the pilot has the aircraft" in rig.actuation.request(None)

    def test_a_ground_that_never_starts_does_not_keep_the_aircraft(self) -> None:
        rig = Rig(switch_plan(*USUAL), config=sequencer_config(start="ground", wait_s=1.0))
        rig.run(3.0)
        assert (rig.state, rig.reason) == (State.RELEASED, Reason.WAITED)

    def test_the_switch_starts_only_what_the_switch_may(self) -> None:
        rig = armed()
        assert "pilot's switch" in rig.actuation.request(int(rig.plan.digest[:6], 16))


def let(rig: Rig, reason: Reason) -> None:
    """Bring about what a reason is for."""
    changes: dict[Reason, Flying] = {
        Reason.BANK: Flying(bank_deg=-61.0),
        Reason.LOAD_FACTOR: Flying(load_factor=2.6),
        Reason.AIRSPEED: Flying(airspeed=11.5),
        Reason.ALPHA: Flying(alpha_deg=15.0),
        Reason.HEIGHT: Flying(height=29.0),
        Reason.SENSOR: Flying(absent=frozenset({"pitot"})),
        Reason.NOT_FOLLOWED: Flying(absent=frozenset({"capture"})),
    }
    if reason in changes:
        rig.flying = changes[reason]
    elif reason is Reason.LINK:
        rig.link_s = 2.1
    elif reason is Reason.RECORDING:
        rig.book.recording = False
    elif reason is Reason.STICK:
        rig.sticks = (0.0, 0.0, math.radians(2.3))
    elif reason is Reason.CHIP:
        rig.cabin.chip.set_power(False, rig.now)
    elif reason is Reason.PILOT_SIGNALS:
        rig.receiver.set_power(False, rig.now)
    else:
        rig.actuation.request(None)


ENDED = (
    Reason.BANK,
    Reason.LOAD_FACTOR,
    Reason.AIRSPEED,
    Reason.ALPHA,
    Reason.HEIGHT,
    Reason.SENSOR,
    Reason.NOT_FOLLOWED,
    Reason.LINK,
    Reason.RECORDING,
    Reason.STICK,
    Reason.CHIP,
    Reason.PILOT_SIGNALS,
    Reason.GROUND,
)
SLOWEST_S = {Reason.SENSOR: 0.12, Reason.PILOT_SIGNALS: 0.12, Reason.NOT_FOLLOWED: 0.18}
"""What can only be told after a while; all else within a scan, here and then the next frame."""


class TestEnded:
    @pytest.mark.parametrize("reason", ENDED, ids=lambda r: r.name.lower())
    def test_each_reason_ends_it_and_is_told(self, reason: Reason) -> None:
        config = sequencer_config(limits={"link_s": 2.0})
        rig = running(config=config)
        at = rig.now
        let(rig, reason)
        rig.run(0.6)
        left = next(f for f in rig.book.frames if f.time_monotonic_ns > at and f.state != State.RUNNING)
        assert Reason(left.reason) is reason
        assert State(left.state) is (State.RAMPING if reason.exit is Exit.RAMP else State.RELEASED)
        assert (left.time_monotonic_ns - at) * 1e-9 <= SLOWEST_S.get(reason, 0.041)
        assert (rig.state, rig.reason) == (State.RELEASED, reason)
        assert any(reason.words in w for w in rig.book.warnings)
        assert not rig.cabin.multiplexer.selects_second(rig.now)

    def test_letting_go_does_not_wait_for_the_monostable(self) -> None:
        """The clear line ends it in the same frame, and the driver's outputs are turned off besides."""
        rig = running()
        let(rig, Reason.STICK)
        rig.frame()
        rig.frame()
        assert rig.state is State.RELEASED
        assert not rig.monostable.up(rig.now)
        rig.run(0.1)
        rig.cabin.chip._enabled = lambda time_ns: True
        assert [rig.cabin.chip.width_us(channel, rig.now) for channel in range(3)] == [0.0, 0.0, 0.0]

    def test_a_frame_that_could_not_be_written_does_not_beat(self, monkeypatch: pytest.MonkeyPatch) -> None:
        rig = running()
        last = rig.monostable.last_edge_ns

        def refuse(*_: object) -> None:
            raise OSError(121, "Remote I/O error")

        monkeypatch.setattr(rig.bus, "write_i2c_block_data", refuse)
        rig.frame()
        assert rig.monostable.last_edge_ns == last
        assert not rig.monostable.up(rig.now)
        assert not rig.book.frames[-1].beating
        rig.frame()
        assert (rig.state, rig.reason) == (State.RELEASED, Reason.CHIP)

    def test_a_ramp_fades_and_lets_go(self) -> None:
        rig = running()
        rig.flying = Flying(bank_deg=70.0)
        rig.run(0.4)
        fading = [f for f in rig.book.frames if f.state == State.RAMPING]
        sizes = [abs(f.increments[1]) for f in fading]
        assert 9 <= len(fading) <= 11
        assert sizes == sorted(sizes, reverse=True)
        assert sizes[-1] < 0.12 * sizes[0]

    @pytest.mark.parametrize("held", [State.CHECKING, State.ARMED, State.RUNNING], ids=lambda s: s.name.lower())
    def test_the_switch_ends_everything_at_once(self, held: State) -> None:
        seconds = {State.CHECKING: 0.5, State.ARMED: 1.1, State.RUNNING: 1.8}[held]
        steps = tuple(s for s in USUAL if s[0] < seconds)
        rig = Rig(switch_plan(*steps, (seconds, OFF)))
        rig.run(seconds - 0.01)
        assert rig.state is held
        rig.run(0.05)
        assert rig.state in (State.IDLE, State.RELEASED)
        assert rig.reason is Reason.SWITCH
        assert not rig.cabin.multiplexer.selects_second(rig.now)

    def test_a_late_frame_and_a_missed_one(self) -> None:
        rig = running()
        rig.frame(late_ns=11_000_000)
        assert (rig.state, rig.reason) == (State.RELEASED, Reason.LATE)
        rig = running()
        rig.clock.advance(35_000_000)
        rig.number = -(-rig.now // 20_000_000)
        rig.frame()
        assert (rig.state, rig.reason) == (State.RELEASED, Reason.MISSED)

    def test_nothing_happens_again_until_the_switch_was_off(self) -> None:
        rig = running()
        let(rig, Reason.STICK)
        rig.run(0.1)
        rig.sticks = (0.0, 0.0, 0.0)
        rig.run(3.0)
        assert rig.state is State.RELEASED


class TestRefused:
    @pytest.mark.parametrize("error", [-0.03, 0.025, 0.08])
    def test_a_wrong_output_frequency(self, error: float) -> None:
        rig = Rig(switch_plan(*USUAL), oscillator_error=error)
        rig.run(1.1)
        assert (rig.state, rig.reason) == (State.RELEASED, Reason.FREQUENCY)

    def test_a_small_error_is_taken_out_of_the_pulses(self) -> None:
        rig = Rig(switch_plan(*USUAL), oscillator_error=0.018)
        rig.sticks = (0.2, -0.2, 0.1)
        rig.run(1.1)
        assert rig.state is State.ARMED
        for channel, angle in enumerate(rig.sticks):
            width = rig.cabin.chip.width_us(channel, rig.now)
            assert width == pytest.approx(1500.0 + 1145.916 * angle, abs=5.0)  # a step is 4.9 us

    def test_no_loopback(self) -> None:
        rig = Rig(switch_plan(*USUAL))
        rig.monostable.broken = lambda time_ns: True
        rig.run(2.5)
        assert (rig.state, rig.reason) == (State.RELEASED, Reason.TOO_EARLY)
        rig = Rig(switch_plan((0.2, ARM)))
        rig.monostable.broken = lambda time_ns: True
        rig.run(2.5)
        assert (rig.state, rig.reason) == (State.RELEASED, Reason.FREQUENCY)

    def test_a_switch_at_go_from_the_beginning_arms_nothing(self) -> None:
        rig = Rig(switch_plan((0.0, GO)))
        rig.run(2.0)
        assert rig.state is State.IDLE
        rig = Rig(switch_plan((0.0, ARM)))
        rig.run(2.0)
        assert rig.state is State.IDLE

    def test_outside_the_envelope_it_does_not_start(self) -> None:
        rig = armed()
        rig.flying = Flying(height=20.0)
        rig.run(0.4)
        assert (rig.state, rig.reason) == (State.RELEASED, Reason.HEIGHT)
        assert not any(f.state == State.RUNNING for f in rig.book.frames)

    def test_sticks_must_be_still_and_leave_room(self) -> None:
        rig = armed()
        number = rig.number

        def waver() -> None:
            rig.sticks = (0.02 * ((rig.number - number) % 2), 0.0, 0.0)

        rig.run(0.4, waver)
        assert (rig.state, rig.reason) == (State.RELEASED, Reason.STICKS_NOT_STILL)
        rig = armed()
        rig.sticks = (math.radians(17.0), 0.0, 0.0)
        rig.run(0.3)
        assert (rig.state, rig.reason) == (State.RELEASED, Reason.NO_ROOM)

    @pytest.mark.parametrize(
        ("manoeuvre", "changes", "words"),
        [
            (short_manoeuvre(peak_deg=13.0), {}, "delta_a goes to 13.0 deg"),
            (short_manoeuvre(seconds=0.2, peak_deg=12.0), {}, "us/s"),
            (Manoeuvre("test", 0.02, {"delta_a": (0.0, 0.1, 0.0)}), {"rudder_only": True}, "moves delta_a, but no"),
        ],
    )
    def test_a_manoeuvre_that_this_aircraft_must_not_fly(
        self, manoeuvre: Manoeuvre, changes: dict[str, bool], words: str
    ) -> None:
        config = sequencer_config()
        if changes:
            config = config.model_copy(update={"output": {"rudder": config.output["rudder"]}})
        with pytest.raises(ManoeuvreError, match=words):
            plan_of(manoeuvre, config)


class TestRecord:
    def test_every_frame_that_is_not_idle_is_recorded(self) -> None:
        rig = Rig(switch_plan(*USUAL, (3.2, OFF)))
        rig.run(3.6)
        times = [f.time_monotonic_ns for f in rig.book.frames]
        assert max(b - a for a, b in zip(times, times[1:], strict=False)) < 25_000_000
        for f in rig.book.frames:
            assert f.beating is State(f.state).beats
            assert bool(f.output_us) is f.beating
            assert len(f.pilot_us) == 3

    def test_output_that_cannot_be_recorded_ends(self) -> None:
        """A card that stalls until the recorder's memory is full."""
        rig = running()
        rig.book.room = False
        rig.run(0.5)
        assert (rig.state, rig.reason) == (State.RELEASED, Reason.RECORDING)

    def test_the_ground_hears_little_but_every_change(self) -> None:
        rig = Rig(switch_plan(*USUAL, (3.2, OFF)))
        rig.run(3.6)
        changes = len(rig.book.words)
        seconds = len(rig.book.frames) * 0.02
        assert changes <= rig.book.sent <= changes + 2.0 * seconds + 1


def test_switch_positions_leave_out_where_the_multiplexer_may_go_either_way() -> None:
    assert [switch_position(w) for w in (1000.0, 1500.0, 2000.0)] == [Switch.OFF, Switch.ARM, Switch.GO]
    assert {switch_position(w) for w in (1640.0, 1700.0, 1760.0, 1790.0)} == {Switch.UNKNOWN}
    assert {switch_position(w) for w in (None, 0.0, 700.0, 2500.0)} == {Switch.UNKNOWN}


def test_every_state_leads_back_to_idle() -> None:
    reached = {State.IDLE}
    for _ in State:
        reached |= {s for s in State if TRANSITIONS[s] & reached}
    assert reached == set(State)
    assert all(reason.words for reason in Reason if reason is not Reason.NONE)


def test_slew_and_limits_of_a_servo() -> None:
    servo = servos_of(sequencer_config())[0]
    assert servo.limited(1700.0, 1500.0, 0.02) == pytest.approx(1620.0)
    assert servo.limited(2500.0, 1890.0, 0.02) == 1900.0
    assert servo.limited(900.0, 1110.0, 0.02) == 1100.0


def test_a_plan_is_straight_between_samples_and_zero_outside() -> None:
    plan = ServoManoeuvre("", 0.02, ((0.0, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.0)))
    assert plan.at(0.005)[1] == pytest.approx(0.025)
    assert plan.at(0.02)[1] == pytest.approx(0.1)
    assert plan.at(0.03)[1] == pytest.approx(0.05)
    assert plan.at(-0.001) == plan.at(0.04) == plan.at(0.061) == (0.0, 0.0, 0.0)
    assert plan.duration_s == pytest.approx(0.06)


def _bus_held(from_s: float) -> Callable[[int, int], Disturbance | None]:
    return lambda address, now_ns: Disturbance(held=True) if now_ns > from_s * 1e9 else None


def test_a_held_bus_ends_the_heartbeat_in_the_same_frame() -> None:
    rig = Rig(switch_plan(*USUAL), disturb=_bus_held(1.8))
    rig.run(2.2)
    assert (rig.state, rig.reason) in ((State.RELEASED, Reason.CHIP), (State.RELEASED, Reason.LATE))
    last = rig.monostable.last_edge_ns or 0
    assert last <= 1.8e9
    assert not any(rig.cabin.multiplexer.selects_second(last + 100_000_000 + k * 1_000_000) for k in range(300))
