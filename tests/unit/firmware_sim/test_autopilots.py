"""Simulated autopilots spoken to by pymavlink, which knows nothing of this project: what their sources say."""

from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from firmware_sim.hardware.autopilots.arduplane import ArduPlane
from firmware_sim.hardware.autopilots.looped import LossyLine
from tests.unit.firmware_sim.px4 import MAVLINK, RECEIVER, Px4

MS = 1_000_000
STICKS = (1520, 1480, 1600, 1510, 2000, 1500, 1500, 1500)
STAY = 65535


class Ground:
    """A ground station on the line of an autopilot. switch: width on channel 5 [us]."""

    def __init__(self, make: Callable[..., Any] = ArduPlane, system: int = 255, **parameters: float) -> None:
        self.sticks: tuple[int, ...] | None = STICKS
        self.craft = make(lambda t: self.sticks, parameters)
        self.mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=190)
        self.ear = mavlink.MAVLink(None)
        self.now = 0
        self.heard: list[Any] = []

    def send(self, message: Any) -> None:
        self.craft.receive(message.pack(self.mav), self.now)

    def override(self, *values: int) -> None:
        widths = [*values, *[STAY] * (8 - len(values))]
        self.send(self.mav.rc_channels_override_encode(1, 1, *widths))

    def run(self, ms: int) -> list[Any]:
        """What was heard in so many milliseconds."""
        self.now += ms * MS
        heard = self.ear.parse_buffer(self.craft.bytes_until(self.now)) or []
        self.heard += heard
        return heard

    def of(self, kind: str) -> list[Any]:
        return [m for m in self.heard if m.get_type() == kind]

    def stream(self, number: int, interval_us: int = 20_000) -> None:
        self.command(511, number, interval_us)

    def command(self, command: int, *values: float) -> None:
        self.send(self.mav.command_long_encode(1, 1, command, 0, *values, *[0.0] * (7 - len(values))))

    @property
    def outputs(self) -> tuple[int, ...]:
        made: tuple[int, ...] = self.craft.outputs_us(self.now)
        return made


def servos(roll: int, pitch: int, throttle: int, yaw: int) -> tuple[int, ...]:
    return pitch - roll + 1500, pitch + roll - 1500, yaw, throttle


class TestArduPlane:
    def test_sticks_go_straight_to_the_servos_in_manual(self) -> None:
        ground = Ground()
        ground.run(100)
        assert ground.outputs == servos(1520, 1480, 1600, 1510)
        ground.craft.set_mode(5, ground.now)
        ground.run(40)
        assert ground.outputs != servos(1520, 1480, 1600, 1510)

    def test_a_mode_is_told_at_once(self) -> None:
        ground = Ground()
        ground.run(130)
        ground.craft.set_mode(5, ground.now)
        assert [m.custom_mode for m in ground.run(10)] == [5]

    def test_an_override_takes_the_place_of_the_stick_and_is_shown(self) -> None:
        ground = Ground()
        ground.stream(65)
        ground.stream(36)
        ground.run(100)
        ground.override(1600, 0, STAY, 1555)
        ground.run(70)
        shown = ground.of("RC_CHANNELS")[-1]
        assert (shown.chan1_raw, shown.chan2_raw, shown.chan4_raw, shown.chan5_raw) == (1600, 1480, 1555, 2000)
        out = ground.of("SERVO_OUTPUT_RAW")[-1]
        assert (out.servo1_raw, out.servo2_raw, out.servo3_raw) == servos(1600, 1480, 1600, 1555)[:3]

    @pytest.mark.parametrize(("lasts", "held_ms"), [(0.1, 160), (0.5, 560), (3.0, 3060)])
    def test_silence_ends_it(self, lasts: float, held_ms: int) -> None:
        ground = Ground(RC_OVERRIDE_TIME=lasts)
        ground.run(100)
        ground.override(1700)
        ground.run(held_ms - 60)
        assert ground.outputs[0] == 1480 - 1700 + 1500
        ground.run(60)
        assert ground.outputs == servos(1520, 1480, 1600, 1510)

    @pytest.mark.parametrize("lasts", [0.0, -1.0])
    def test_never_and_for_ever(self, lasts: float) -> None:
        ground = Ground(RC_OVERRIDE_TIME=lasts)
        ground.run(100)
        ground.override(1700)
        ground.run(10_000)
        assert (ground.outputs == servos(1520, 1480, 1600, 1510)) is (lasts == 0.0)

    def test_zero_releases(self) -> None:
        ground = Ground(RC_OVERRIDE_TIME=3.0)
        ground.run(100)
        ground.override(1700, 1700)
        ground.run(100)
        ground.override(0, STAY)
        ground.run(70)
        assert ground.outputs == servos(1520, 1700, 1600, 1510)

    def test_only_the_ground_stations_system_is_listened_to(self) -> None:
        for name in ("SYSID_MYGCS", "MAV_GCS_SYSID"):
            ground = Ground(**{name: 200.0})
            ground.run(100)
            ground.override(1700)
            ground.run(80)
            assert ground.outputs == servos(1520, 1480, 1600, 1510)

    def test_options_ignore_overrides_or_the_receiver(self) -> None:
        ground = Ground(RC_OPTIONS=2.0)
        ground.run(100)
        ground.override(1700)
        ground.run(80)
        assert ground.outputs == servos(1520, 1480, 1600, 1510)
        ground = Ground(RC_OPTIONS=1.0)
        ground.run(100)
        assert ground.outputs[:3] == (1500, 1500, 1500)

    def test_a_switch_at_low_clears_and_refuses_after_its_debounce(self) -> None:
        ground = Ground(RC_OVERRIDE_TIME=-1.0)
        ground.run(100)
        ground.override(1700)
        ground.run(100)
        ground.sticks = (*STICKS[:4], 1000, *STICKS[5:])
        ground.run(180)
        assert ground.outputs[0] == 1480 - 1700 + 1500
        ground.run(180)
        assert ground.outputs == servos(1520, 1480, 1600, 1510)
        ground.override(1700)
        ground.run(80)
        assert ground.outputs == servos(1520, 1480, 1600, 1510)
        ground.sticks = (*STICKS[:4], 1500, *STICKS[5:])  # in between nothing changes
        ground.run(400)
        ground.override(1700)
        ground.run(80)
        assert ground.outputs == servos(1520, 1480, 1600, 1510)

    def test_a_lapsed_override_stays_while_the_receiver_is_silent_and_the_failsafe_comes_late(self) -> None:
        ground = Ground()
        ground.run(100)
        ground.override(1700)
        ground.run(40)
        ground.sticks = None
        ground.run(400)
        assert ground.outputs[0] == 1480 - 1700 + 1500
        ground.run(700)
        assert ground.outputs[:3] == (1500, 1500, 1500)
        ground.run(600)
        assert ground.craft.mode == 1

    def test_overrides_hide_a_receiver_that_is_lost(self) -> None:
        ground = Ground()
        ground.run(100)
        ground.sticks = None
        for _ in range(100):
            ground.override(1700)
            ground.run(30)
        assert ground.craft.mode == 0
        assert ground.outputs[0] == 1480 - 1700 + 1500

    def test_a_servo_with_a_function_is_not_set_by_command(self) -> None:
        ground = Ground()
        ground.command(183, 1, 1700)
        ground.command(183, 9, 1700)
        ground.run(100)
        assert [(m.command, m.result) for m in ground.of("COMMAND_ACK")] == [(183, 4), (183, 0)]

    def test_parameters(self) -> None:
        ground = Ground()
        ground.send(ground.mav.param_request_read_encode(1, 1, b"RC_OVERRIDE_TIME", -1))
        ground.send(ground.mav.param_request_read_encode(1, 1, b"NOT_THERE", -1))
        ground.send(ground.mav.param_set_encode(1, 1, b"RC_OPTIONS", 34.0, 9))
        ground.run(100)
        told = [(m.param_id, m.param_value) for m in ground.of("PARAM_VALUE")]
        assert told == [("RC_OVERRIDE_TIME", pytest.approx(0.1)), ("RC_OPTIONS", 34.0)]

    def test_damage_costs_only_what_is_damaged(self) -> None:
        ground = Ground()
        ground.run(100)
        frame = bytearray(ground.mav.rc_channels_override_encode(1, 1, 1700, *[STAY] * 7).pack(ground.mav))
        frame[12] ^= 0x40
        ground.craft.receive(bytes(frame), ground.now)
        ground.override(STAY, 1600)
        ground.run(80)
        assert ground.outputs == servos(1520, 1600, 1600, 1510)


class TestPx4:
    """What would happen if manual control were sent beside a pilot: either is flown by, never both."""

    def fly(self, mode: int, sent: bool = True) -> Ground:
        ground = Ground(Px4, COM_RC_IN_MODE=float(mode))
        ground.run(100)
        for _ in range(20):
            if sent:
                ground.send(ground.mav.manual_control_encode(1, 300, -200, 500, 100, 0))
            ground.run(20)
        return ground

    @pytest.mark.parametrize(
        ("mode", "chosen"),
        [(0, RECEIVER), (1, MAVLINK), (2, RECEIVER), (3, RECEIVER), (4, None), (5, RECEIVER), (6, MAVLINK)],
    )
    def test_one_source_is_chosen_for_all_axes(self, mode: int, chosen: str | None) -> None:
        ground = self.fly(mode)
        assert ground.craft.chosen == chosen
        wanted = {RECEIVER: (1520, 1480, 1510, 1600), MAVLINK: (1400, 1650, 1550, 1500), None: (1500, 1500, 1500, 1000)}
        assert ground.outputs == wanted[chosen]

    def test_a_stick_that_is_not_read(self) -> None:
        """Mode 1: the pilot's hand moves nothing, also after the sender has died; then throttle goes to idle."""
        ground = self.fly(1)
        ground.sticks = (2000, 1000, 1600, 1000, 2000, 1500, 1500, 1500)
        ground.send(ground.mav.manual_control_encode(1, 300, -200, 500, 100, 0))
        ground.run(100)
        assert ground.outputs == (1400, 1650, 1550, 1500)
        ground.run(3000)
        assert ground.outputs == (1500, 1500, 1500, 1000)

    def test_precedence_of_newer_sources_gives_the_stick_back_half_a_second_late(self) -> None:
        """Mode 6, COM_RC_LOSS_T 0.5 s: five times what is allowed here, and throttle is the sender's all the while."""
        ground = self.fly(6)
        ground.run(400)
        assert ground.craft.chosen == MAVLINK
        ground.run(200)
        assert ground.craft.chosen == RECEIVER

    def test_set_actuator_reaches_no_surface(self) -> None:
        ground = self.fly(0, sent=False)
        before = ground.outputs
        ground.command(187, 0.7)
        ground.run(100)
        assert ground.outputs == before
        assert ground.craft.peripheral == pytest.approx(0.7)


def test_a_line_takes_its_time() -> None:
    line = LossyLine(baud=10_000)  # a byte a millisecond
    line.send(b"abcd", 0)
    line.send(b"ef", 1 * MS)
    assert line.arrived(2 * MS) == b"ab"
    assert line.arrived(5 * MS) == b"cde"
    line.late_ns = lambda now_ns: 10 * MS
    line.send(b"g", 6 * MS)
    assert line.arrived(16 * MS) == b"f"
    assert line.arrived(17 * MS) == b"g"
