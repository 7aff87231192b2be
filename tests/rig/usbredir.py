"""A USB device outside of the virtual machine: the device's end of the usbredir protocol, as far as control transfers need it.

QEMU's `-device usb-redir` is the other end. Packets have a header of type, length and id, little-endian, and a body; the
first one of either side is `hello` with its capabilities, always with an id of 32 bits. Source: usb-redirection-protocol.md of
the usbredir project, version 0.7.
"""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

HELLO, DEVICE_CONNECT, DEVICE_DISCONNECT, RESET, INTERFACE_INFO, EP_INFO = range(6)
SET_CONFIGURATION, GET_CONFIGURATION, CONFIGURATION_STATUS = 6, 7, 8
SET_ALT_SETTING, GET_ALT_SETTING, ALT_SETTING_STATUS = 9, 10, 11
CANCEL_DATA = 21
CONTROL = 100

SUCCESS, CANCELLED, INVALID, IO_ERROR, STALL = range(5)
"""Status of a transfer."""

CAP_VERSION, CAP_PACKET_SIZE, CAP_WIDE_IDS, CAP_LONG_BULK = 1, 4, 5, 6
_CAPABILITIES = (
    1 << CAP_VERSION | 1 << CAP_PACKET_SIZE | 1 << CAP_WIDE_IDS | 1 << CAP_LONG_BULK
)  # xHCI wants the last three
_OURS = b"sideslip rig".ljust(64, b"\0")
_FULL_SPEED, _VENDOR_CLASS = 1, 255
_CONTROL_ENDPOINT, _NO_ENDPOINT = 0, 255  # types of endpoints
_ENDPOINTS = 32
_LONGEST = 1 << 20  # of a packet's body: QEMU's are below 64 KiB

_CONTROL_HEADER = struct.Struct("<BBBBHHH")


class ProtocolError(Exception):
    """Bytes that are no usbredir."""


@dataclass(frozen=True, slots=True)
class Packet:
    """One packet. id: the other end's mark for a request, given back with the answer."""

    kind: int
    id: int
    body: bytes = b""


class PacketStream:
    """Packets out of and into a stream of bytes. wide: ids of 64 bits, from when both ends have said they know them."""

    def __init__(self) -> None:
        self.wide = False
        self._buffer = bytearray()

    def feed(self, data: bytes) -> Iterator[Packet]:
        """The packets that are complete with these bytes; raises ProtocolError for a length that cannot be."""
        self._buffer += data
        while True:
            head = struct.Struct("<IIQ" if self.wide else "<III")
            if len(self._buffer) < head.size:
                return
            kind, length, number = head.unpack_from(self._buffer)
            if length > _LONGEST:
                raise ProtocolError(f"a packet of type {kind} and {length} bytes")
            if len(self._buffer) < head.size + length:
                return
            body = bytes(self._buffer[head.size : head.size + length])
            del self._buffer[: head.size + length]
            yield Packet(kind, number, body)

    def pack(self, packet: Packet) -> bytes:
        """The bytes of a packet."""
        head = struct.pack("<IIQ" if self.wide else "<III", packet.kind, len(packet.body), packet.id)
        return head + packet.body


class UsbDevice(Protocol):
    """A device with one configuration, one interface and no endpoint besides the control endpoint."""

    vendor: int
    product: int

    def control(
        self, kind: int, request: int, value: int, index: int, length: int, data: bytes
    ) -> tuple[int, bytes] | None:
        """Carry a control transfer out: its status and the bytes that go in; None where the device never answers."""
        ...


class RedirectedDevice:
    """The device's end of one connection. send: takes bytes for the other end."""

    def __init__(self, device: UsbDevice, send: Callable[[bytes], None]) -> None:
        self.plugged = False
        self._device = device
        self._send = send
        self._stream = PacketStream()
        self._greeted = False
        self._unanswered: dict[int, bytes] = {}
        self._tell(HELLO, 0, _OURS + struct.pack("<I", _CAPABILITIES))

    def plug_in(self) -> None:
        """Show the device to the machine, from when it has said hello."""
        self.plugged = True
        if self._greeted:
            self._announce()

    def unplug(self) -> None:
        """Take the device away."""
        if self.plugged and self._greeted:
            self._tell(DEVICE_DISCONNECT, 0)
        self.plugged = False

    def receive(self, data: bytes) -> None:
        """Take bytes of the other end and answer them."""
        for packet in self._stream.feed(data):
            self._take(packet)

    def _take(self, packet: Packet) -> None:
        match packet.kind:
            case 0:  # HELLO
                self._greet(packet.body)
            case 6:  # SET_CONFIGURATION
                self._tell(CONFIGURATION_STATUS, packet.id, bytes([SUCCESS, packet.body[0]]))
            case 7:  # GET_CONFIGURATION
                self._tell(CONFIGURATION_STATUS, packet.id, bytes([SUCCESS, 1]))
            case 9 | 10:  # SET_ALT_SETTING, GET_ALT_SETTING
                self._tell(ALT_SETTING_STATUS, packet.id, bytes([SUCCESS, packet.body[0], 0]))
            case 21:  # CANCEL_DATA
                self._cancel(packet.id)
            case 100 if self.plugged:  # CONTROL
                self._transfer(packet)
            case _:
                pass  # resets and filters ask for nothing

    def _greet(self, body: bytes) -> None:
        theirs = struct.unpack_from("<I", body, 64)[0] if len(body) >= 68 else 0
        self._stream.wide = bool(theirs & 1 << CAP_WIDE_IDS)
        self._greeted = True
        if self.plugged:
            self._announce()

    def _announce(self) -> None:
        types = bytes([_CONTROL_ENDPOINT] + [_NO_ENDPOINT] * 15) * 2
        sizes = struct.pack("<32H", *([64] + [0] * 15) * 2)
        self._tell(EP_INFO, 0, types + bytes(_ENDPOINTS) + bytes(_ENDPOINTS) + sizes)
        classes = bytes([_VENDOR_CLASS]).ljust(_ENDPOINTS, b"\0")
        self._tell(INTERFACE_INFO, 0, struct.pack("<I", 1) + bytes(32) + classes + bytes(32) + bytes(32))
        told = struct.pack("<BBBBHHH", _FULL_SPEED, 0, 0, 0, self._device.vendor, self._device.product, 0x0100)
        self._tell(DEVICE_CONNECT, 0, told)

    def _transfer(self, packet: Packet) -> None:
        endpoint, request, kind, _, value, index, length = _CONTROL_HEADER.unpack_from(packet.body)
        done = self._device.control(kind, request, value, index, length, packet.body[_CONTROL_HEADER.size :])
        if done is None:
            self._unanswered[packet.id] = packet.body[: _CONTROL_HEADER.size]
            return
        status, data = done
        data = data[:length]
        told = length if status == SUCCESS and not kind & 0x80 else len(data)
        head = _CONTROL_HEADER.pack(endpoint, request, kind, status, value, index, told)
        self._tell(CONTROL, packet.id, head + data)

    def _cancel(self, number: int) -> None:
        """The machine waits no longer. QEMU keeps the id for cancelled until it has been given back."""
        body = self._unanswered.pop(number, None)
        if body is not None:
            endpoint, request, kind, _, value, index, _ = _CONTROL_HEADER.unpack(body)
            self._tell(CONTROL, number, _CONTROL_HEADER.pack(endpoint, request, kind, CANCELLED, value, index, 0))

    def _tell(self, kind: int, number: int, body: bytes = b"") -> None:
        self._send(self._stream.pack(Packet(kind, number, body)))
