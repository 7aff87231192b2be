"""The USB adapter i2c-tiny-usb, with the simulated chips on its bus.

The kernel's stock driver (drivers/i2c/busses/i2c-tiny-usb.c) speaks to it: every message of an I2C transfer is one control
transfer to the interface, and another one asks whether the chip has acknowledged. The driver makes ENXIO of a chip that
has not, and EIO of everything else that goes wrong.
"""

import struct
from collections.abc import Callable

from smbus2 import i2c_msg

from daq.sensors.bus import NACK_ERRNOS
from firmware_sim.hardware.bus import SimulatedBus
from tests.rig.usbredir import STALL, SUCCESS

ECHO, GET_FUNCTIONS, SET_DELAY, GET_STATUS, IO, IO_BEGIN, IO_END = range(7)
"""Requests; the flags of a message, first and last of its transfer, are added to IO."""
IDLE, ACKNOWLEDGED, REFUSED = range(3)
_READ = 0x0001  # I2C_M_RD
_FUNCTIONS = 0x0EFF0001  # I2C_FUNC_I2C | I2C_FUNC_SMBUS_EMUL: block transfers are put together by the kernel
_DEVICE_TO_HOST = 0x80
_KINDS = 0x60  # of a request: standard, class or vendor
_GET_DESCRIPTOR = 6
_DEVICE, _CONFIGURATION, _STRING = 1, 2, 3
_NAMES = ("Sideslip", "i2c-tiny-usb", "rig")
_TOLD = (SUCCESS, b"")
_STALLED = (STALL, b"")


class TinyUsb:
    """The adapter. bus: what hangs on it. before: called before every message, to bring the bus's time to the present.

    on_read: told about every read that was answered, with the address and what was read. mute: True makes it a device that
    never answers a message any more, as firmware does whose loop waits for a line held low.
    """

    vendor, product = 0x0403, 0xC631

    def __init__(self, bus: SimulatedBus, before: Callable[[], None] = lambda: None) -> None:
        self.mute = False
        self.messages = 0
        self.on_read: Callable[[int, bytes], None] = lambda address, data: None
        self._bus = bus
        self._before = before
        self._status = IDLE

    def control(
        self, kind: int, request: int, value: int, index: int, length: int, data: bytes
    ) -> tuple[int, bytes] | None:
        """See `UsbDevice`; for messages `value` has the flags, `index` the address."""
        if kind & _KINDS == 0:
            return self._standard(kind, request, value)
        match request:
            case 0:  # ECHO
                return SUCCESS, struct.pack("<H", value)
            case 1:  # GET_FUNCTIONS
                return SUCCESS, struct.pack("<I", _FUNCTIONS)
            case 2:  # SET_DELAY
                return _TOLD
            case 3:  # GET_STATUS
                return SUCCESS, bytes([self._status])
            case _ if IO <= request <= IO + 3:
                return None if self.mute else self._message(bool(value & _READ), index, length, data)
            case _:
                return _STALLED

    def _message(self, reads: bool, address: int, length: int, data: bytes) -> tuple[int, bytes]:
        self._before()
        self.messages += 1
        message = i2c_msg.read(address, length) if reads else i2c_msg.write(address, list(data))
        try:
            self._bus.i2c_rdwr(message)
        except OSError as error:
            if error.errno not in NACK_ERRNOS:
                return _STALLED
            # The firmware reads on: what nobody drives is ones. The driver asks for the status afterwards.
            self._status = REFUSED
            return SUCCESS, b"\xff" * length if reads else b""
        self._status = ACKNOWLEDGED
        if not reads:
            return SUCCESS, b""
        answer = bytes(list(message))
        self.on_read(address, answer)
        return SUCCESS, answer

    def _standard(self, kind: int, request: int, value: int) -> tuple[int, bytes]:
        if request != _GET_DESCRIPTOR or not kind & _DEVICE_TO_HOST:
            return _TOLD if not kind & _DEVICE_TO_HOST else (SUCCESS, b"\0\0")
        what, number = value >> 8, value & 0xFF
        if what == _DEVICE:
            head = struct.pack(
                "<BBHBBBBHHHBBBB", 18, _DEVICE, 0x0110, 0, 0, 0, 64, self.vendor, self.product, 0x0205, 1, 2, 3, 1
            )
            return SUCCESS, head
        if what == _CONFIGURATION:
            interface = struct.pack("<BBBBBBBBB", 9, 4, 0, 0, 0, 255, 0, 0, 0)
            return SUCCESS, struct.pack("<BBHBBBBB", 9, _CONFIGURATION, 18, 1, 1, 0, 0x80, 50) + interface
        if what == _STRING and number == 0:
            return SUCCESS, struct.pack("<BBH", 4, _STRING, 0x0409)
        if what == _STRING and number <= len(_NAMES):
            text = _NAMES[number - 1].encode("utf-16-le")
            return SUCCESS, struct.pack("<BB", 2 + len(text), _STRING) + text
        return _STALLED
