"""The device's end of usbredir, held against packets written out by hand from the protocol's description."""

import struct

import pytest

from tests.rig.usbredir import (
    CANCEL_DATA,
    CANCELLED,
    CONTROL,
    DEVICE_CONNECT,
    DEVICE_DISCONNECT,
    EP_INFO,
    HELLO,
    INTERFACE_INFO,
    STALL,
    SUCCESS,
    Packet,
    PacketStream,
    ProtocolError,
    RedirectedDevice,
)

WIDE, NARROW = 1 << 5 | 1 << 4, 1 << 4
READ_STATUS = bytes.fromhex(
    "80 03 c1 00 0000 0000 0100"
)  # endpoint 0x80, request 3, vendor/interface/in, 1 byte wanted


class Echo:
    """Answers with what it was asked; request 9 stalls, request 8 never answers."""

    vendor, product = 0x1234, 0x5678

    def control(
        self, kind: int, request: int, value: int, index: int, length: int, data: bytes
    ) -> tuple[int, bytes] | None:
        if request == 8:
            return None
        if request == 9:
            return STALL, b""
        return SUCCESS, (bytes([request, value & 0xFF, index & 0xFF]) + data) if kind & 0x80 else b""


class Machine:
    """The other end, as QEMU's: says hello with its capabilities and reads what comes."""

    def __init__(self, capabilities: int = WIDE) -> None:
        self.sent = bytearray()
        self.device = RedirectedDevice(Echo(), self.sent.extend)
        self.stream = PacketStream()
        self.capabilities = capabilities

    def told(self) -> list[Packet]:
        data, self.sent[:] = bytes(self.sent), b""
        return list(self.stream.feed(data))

    def greet(self) -> list[Packet]:
        first = self.told()
        hello = b"qemu".ljust(64, b"\0") + struct.pack("<I", self.capabilities)
        self.device.receive(struct.pack("<III", HELLO, len(hello), 0) + hello)
        self.stream.wide = bool(self.capabilities & 1 << 5)
        return first

    def ask(self, body: bytes, number: int = 7, kind: int = CONTROL) -> list[Packet]:
        self.device.receive(self.stream.pack(Packet(kind, number, body)))
        return self.told()


def test_hello_comes_first_with_a_narrow_id_and_the_capabilities() -> None:
    machine = Machine()
    assert bytes(machine.sent[:12]) == bytes.fromhex("00000000 44000000 00000000")
    (hello,) = machine.greet()
    assert hello.kind == HELLO
    assert struct.unpack_from("<I", hello.body, 64)[0] == 0b1110010  # version, packet sizes, 64-bit ids, long bulk


@pytest.mark.parametrize("capabilities", [WIDE, NARROW])
def test_a_plugged_device_is_described_before_it_is_connected(capabilities: int) -> None:
    machine = Machine(capabilities)
    machine.device.plug_in()
    machine.greet()
    told = machine.told()
    assert [p.kind for p in told] == [EP_INFO, INTERFACE_INFO, DEVICE_CONNECT]
    endpoints, interfaces, device = (p.body for p in told)
    assert (endpoints[0], endpoints[16]) == (0, 0)  # control, out and in
    assert set(endpoints[1:16] + endpoints[17:32]) == {255}
    assert len(endpoints) == 3 * 32 + 2 * 32
    assert interfaces[:4] == bytes([1, 0, 0, 0])
    assert len(interfaces) == 4 + 4 * 32
    assert device == bytes.fromhex("01 00 00 00 3412 7856 0001")


def test_unplugging_and_plugging_in_again() -> None:
    machine = Machine()
    machine.greet()
    assert machine.told() == []  # nothing is there yet
    machine.device.plug_in()
    assert [p.kind for p in machine.told()][-1] == DEVICE_CONNECT
    machine.device.unplug()
    assert [p.kind for p in machine.told()] == [DEVICE_DISCONNECT]
    assert machine.ask(READ_STATUS) == []  # nobody there to answer
    machine.device.plug_in()
    assert [p.kind for p in machine.told()][-1] == DEVICE_CONNECT


def test_transfers_are_answered_under_their_id() -> None:
    machine = Machine()
    machine.device.plug_in()
    machine.greet()
    machine.told()
    inward = struct.pack("<BBBBHHH", 0x80, 5, 0xC1, 0, 0x0102, 0x0068, 3)
    (answer,) = machine.ask(inward, number=1 << 40)
    assert answer == Packet(
        CONTROL, 1 << 40, struct.pack("<BBBBHHH", 0x80, 5, 0xC1, SUCCESS, 0x0102, 0x0068, 3) + b"\x05\x02\x68"
    )
    (answer,) = machine.ask(struct.pack("<BBBBHHH", 0, 4, 0x41, 0, 0, 0x68, 2) + b"\x6b\x01")
    assert answer.body == struct.pack("<BBBBHHH", 0, 4, 0x41, SUCCESS, 0, 0x68, 2)  # outward: as many as were taken
    (answer,) = machine.ask(struct.pack("<BBBBHHH", 0x80, 9, 0xC1, 0, 0, 0, 1))
    assert answer.body[3] == STALL
    assert machine.ask(struct.pack("<B", 1), kind=6)[0].body == bytes([SUCCESS, 1])  # configuration
    assert machine.ask(struct.pack("<BB", 0, 0), kind=9)[0].body == bytes([SUCCESS, 0, 0])  # setting of the interface


def test_a_transfer_without_an_answer_is_given_back_when_cancelled() -> None:
    machine = Machine()
    machine.device.plug_in()
    machine.greet()
    machine.told()
    assert machine.ask(struct.pack("<BBBBHHH", 0x80, 8, 0xC1, 0, 0, 0x68, 1), number=11) == []
    (answer,) = machine.ask(b"", number=11, kind=CANCEL_DATA)
    assert (answer.id, answer.body[3]) == (11, CANCELLED)
    assert machine.ask(b"", number=11, kind=CANCEL_DATA) == []  # once


def test_packets_may_come_in_pieces() -> None:
    stream = PacketStream()
    data = stream.pack(Packet(CONTROL, 3, b"abc")) + stream.pack(Packet(CONTROL, 4))
    found = [p for i in range(len(data)) for p in stream.feed(data[i : i + 1])]
    assert found == [Packet(CONTROL, 3, b"abc"), Packet(CONTROL, 4)]


def test_a_length_that_cannot_be_is_refused() -> None:
    with pytest.raises(ProtocolError, match="type 100"):
        list(PacketStream().feed(struct.pack("<III", CONTROL, 0xFFFFFFFF, 0)))
