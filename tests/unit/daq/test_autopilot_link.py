"""The line to an autopilot, spoken by pymavlink at its other end: what is taken, what is not, and how old it is."""

from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from daq.actuation.autopilot.link import AutopilotLink
from daq.transport.autopilot_requests import REQUEST_AGAIN_NS
from tests.unit.daq.fakes import FakePort

MS = 1_000_000
NAMES = (("RC_OPTIONS",), ("MAV_GCS_SYSID", "SYSID_MYGCS"))


class Wire:
    """A link, and pymavlink as the autopilot of system 7."""

    def __init__(self) -> None:
        self.port = FakePort()
        self.link = AutopilotLink(self.port, 255, 50.0, NAMES)
        self.mav = mavlink.MAVLink(None, srcSystem=7, srcComponent=1)

    def say(self, message: Any) -> None:
        self.port.received += message.pack(self.mav)

    def channels(self, boot_ms: int, *widths: int) -> None:
        self.say(self.mav.rc_channels_encode(boot_ms, 8, *widths, *[0] * (18 - len(widths)), 255))

    def sent(self) -> list[Any]:
        """What went out since last asked."""
        data, self.port.sent = bytes(self.port.sent), bytearray()
        return mavlink.MAVLink(None).parse_buffer(data) or []


def test_nothing_is_asked_before_a_heartbeat_and_then_what_is_missing() -> None:
    wire = Wire()
    wire.link.poll(0)
    assert wire.sent() == []
    assert not wire.link.override({1: 1500})
    wire.say(wire.mav.heartbeat_encode(1, 3, 81, 5, 4))
    wire.link.poll(MS)
    assert wire.link.heartbeat is not None
    assert (wire.link.heartbeat.system, wire.link.heartbeat.mode) == (7, 5)
    asked = wire.sent()
    assert (asked[0].command, asked[0].param1, asked[0].param2) == (511, 65.0, 20_000.0)
    assert [m.param_id for m in asked[1:]] == ["RC_OPTIONS", "MAV_GCS_SYSID", "SYSID_MYGCS"]
    assert {m.get_srcSystem() for m in asked} == {255}
    wire.say(wire.mav.param_value_encode(b"SYSID_MYGCS", 255.0, 9, 100, 3))
    wire.link.poll(2 * MS + REQUEST_AGAIN_NS)
    assert wire.link.missing == ("RC_OPTIONS",)
    assert [m.param_id for m in wire.sent()[1:]] == ["RC_OPTIONS"]


def test_an_override_leaves_other_channels_alone() -> None:
    wire = Wire()
    wire.say(wire.mav.heartbeat_encode(1, 3, 81, 0, 4))
    wire.link.poll(0)
    wire.sent()
    assert wire.link.override({1: 1510, 4: 0})
    (message,) = wire.sent()
    widths = [getattr(message, f"chan{i}_raw") for i in range(1, 10)]
    assert widths == [1510, 65535, 65535, 0, 65535, 65535, 65535, 65535, 0]
    assert message.target_system == 7


def test_frames_that_lay_somewhere_are_as_old_as_they_are() -> None:
    wire = Wire()
    for k in range(10):
        wire.channels(1000 + 20 * k, 1500 + k)
        wire.link.poll((20 * k + 8) * MS)
    wire.channels(1200, 1600)
    wire.link.poll(400 * MS)  # 192 ms later than the others came
    assert wire.link.channels is not None
    assert wire.link.channels.widths == {1: 1600.0}
    assert abs(wire.link.channels.sampled_ns - 208 * MS) < MS


def test_an_autopilot_that_is_started_anew() -> None:
    wire = Wire()
    wire.channels(60_000, 1500)
    wire.link.poll(100 * MS)
    wire.channels(20, 1501)
    wire.link.poll(5_000 * MS)
    wire.channels(40, 1502)
    wire.link.poll(5_020 * MS)
    assert wire.link.channels is not None
    assert wire.link.channels.widths == {1: 1502.0}
    assert 0 <= 5_020 * MS - wire.link.channels.sampled_ns < 25 * MS


def test_other_components_are_not_the_autopilot() -> None:
    wire = Wire()
    wire.mav.srcComponent = 154  # a gimbal
    wire.say(wire.mav.heartbeat_encode(26, 8, 0, 0, 4))
    wire.link.poll(0)
    assert wire.link.heartbeat is None


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.binary(max_size=200), st.integers(0, 60))
def test_no_bytes_make_it_raise_and_sound_frames_behind_them_are_taken(junk: bytes, cut: int) -> None:
    wire = Wire()
    wire.port.received += junk
    wire.channels(1000, 1500)
    wire.port.received = wire.port.received[: len(wire.port.received) - cut] if cut else wire.port.received
    wire.link.poll(0)
    for k in range(8):  # long enough to complete whatever the bytes seem to begin
        wire.channels(1020 + 20 * k, 1501)
        wire.link.poll((20 + 20 * k) * MS)
    assert wire.link.channels is not None
    assert wire.link.channels.widths == {1: 1501.0}
