"""The emulated adapter under a second writing of the kernel's driver: the real sampler reads the simulated chips through it."""

import errno
import os
import struct
from collections.abc import Sequence
from typing import Any

import pytest
from smbus2 import i2c_msg

from daq.acquisition.sampler import Sampler
from daq.contract.scan import SensorState
from daq.sensors.bus import I2cBus
from firmware_sim.hardware.bus import Disturbance
from firmware_sim.hardware.serial import SimulatedSerial
from tests.rig.tiny_usb import TinyUsb
from tests.rig.usbredir import STALL, SUCCESS
from tests.unit.daq.cdfp_fit import cdfp_sensors
from tests.unit.daq.rig import Rig, rig

IMU, NOBODY, WHO_AM_I = 0x68, 0x55, 0x00


class Kernel:
    """What Linux does between `/dev/i2c-N` and the adapter, as in usb_xfer of i2c-tiny-usb.c (Linux 6.1)."""

    def __init__(self, adapter: TinyUsb) -> None:
        self.adapter = adapter

    def _xfer(self, *messages: tuple[int, bytes | int]) -> list[bytes]:
        answers = []
        for i, (address, what) in enumerate(messages):
            command = 4 | (1 if i == 0 else 0) | (2 if i == len(messages) - 1 else 0)
            if isinstance(what, int):
                done = self.adapter.control(0xC1, command, 1, address, what, b"")
            else:
                done = self.adapter.control(0x41, command, 0, address, len(what), what)
            if done is None or done[0] != SUCCESS or (isinstance(what, int) and len(done[1]) != what):
                raise OSError(errno.EIO, os.strerror(errno.EIO))
            status = self.adapter.control(0xC1, 3, 0, 0, 1, b"")
            assert status is not None
            if status[1] == b"\x02":
                raise OSError(errno.ENXIO, os.strerror(errno.ENXIO))
            answers.append(done[1])
        return answers

    def read_byte_data(self, i2c_addr: int, register: int, /) -> int:
        return self._xfer((i2c_addr, bytes([register])), (i2c_addr, 1))[1][0]

    def write_byte_data(self, i2c_addr: int, register: int, value: int, /) -> None:
        self._xfer((i2c_addr, bytes([register, value])))

    def read_i2c_block_data(self, i2c_addr: int, register: int, length: int, /) -> list[int]:
        return list(self._xfer((i2c_addr, bytes([register])), (i2c_addr, length))[1])

    def write_i2c_block_data(self, i2c_addr: int, register: int, data: Sequence[int], /) -> None:
        self._xfer((i2c_addr, bytes([register, *data])))

    def i2c_rdwr(self, *i2c_msgs: Any) -> None:
        answers = self._xfer(*((m.addr, m.len if m.flags & 1 else bytes(list(m))) for m in i2c_msgs))
        for message, data in zip(i2c_msgs, answers, strict=True):
            for k, value in enumerate(data):
                message.buf[k] = bytes([value])

    def close(self) -> None:
        pass


@pytest.fixture
def aircraft() -> Rig:
    return rig(start=False)


def test_the_sampler_reads_all_chips_through_the_adapter(aircraft: Rig) -> None:
    adapter = TinyUsb(aircraft.aircraft.bus)
    kernel = Kernel(adapter)
    assert isinstance(kernel, I2cBus)
    port = SimulatedSerial(aircraft.aircraft.gnss, aircraft.clock.monotonic_ns)
    aircraft.sampler = Sampler(cdfp_sensors(), kernel, port, aircraft.clock)
    aircraft.sampler.start()
    last = aircraft.fly(2.0)[-1]
    assert {s.state for g, s in last.groups.items() if g not in ("attitude", "gnss")} == {
        SensorState.OK,
        SensorState.OFF,
    }
    assert adapter.messages > 2.0 * 20 * 20


def test_a_chip_that_does_not_acknowledge_is_enxio(aircraft: Rig) -> None:
    kernel = Kernel(TinyUsb(aircraft.aircraft.bus))
    assert kernel.read_byte_data(IMU, WHO_AM_I) == 0xEA
    for refused in (lambda: kernel.read_byte_data(NOBODY, 0), lambda: kernel.i2c_rdwr(i2c_msg.read(NOBODY, 3))):
        with pytest.raises(OSError, match="No such device") as caught:
            refused()
        assert caught.value.errno == errno.ENXIO
    assert kernel.read_byte_data(IMU, WHO_AM_I) == 0xEA


def test_a_held_line_breaks_the_transfer_off(aircraft: Rig) -> None:
    bus = aircraft.aircraft.bus
    bus.disturb = lambda address, now_ns: Disturbance(held=True)
    adapter = TinyUsb(bus)
    assert adapter.control(0xC1, 7, 1, IMU, 1, b"") == (STALL, b"")
    with pytest.raises(OSError, match="Input/output"):
        Kernel(adapter).read_byte_data(IMU, WHO_AM_I)


def test_a_mute_adapter_never_answers_a_message(aircraft: Rig) -> None:
    adapter = TinyUsb(aircraft.aircraft.bus)
    adapter.mute = True
    assert adapter.control(0xC1, 7, 1, IMU, 1, b"") is None


def test_time_is_brought_to_the_present_before_every_message(aircraft: Rig) -> None:
    asked = []
    adapter = TinyUsb(aircraft.aircraft.bus, lambda: asked.append(1))
    Kernel(adapter).read_byte_data(IMU, WHO_AM_I)
    assert len(asked) == 2  # the register, and what is in it


def test_descriptors_are_those_of_the_adapter(aircraft: Rig) -> None:
    adapter = TinyUsb(aircraft.aircraft.bus)
    done = adapter.control(0x80, 6, 0x0100, 0, 18, b"")
    assert done is not None
    device = done[1]
    assert len(device) == device[0] == 18
    assert struct.unpack_from("<HH", device, 8) == (0x0403, 0xC631)
    done = adapter.control(0x80, 6, 0x0200, 0, 255, b"")
    assert done is not None
    configuration = done[1]
    assert struct.unpack_from("<H", configuration, 2)[0] == len(configuration) == 9 + 9
    done = adapter.control(0x80, 6, 0x0302, 0x0409, 255, b"")
    assert done is not None
    assert done[1][2:].decode("utf-16-le") == "i2c-tiny-usb"
    assert adapter.control(0x80, 6, 0x0F00, 0, 255, b"") == (STALL, b"")  # no such descriptor
    assert adapter.control(0xC1, 1, 0, 0, 4, b"") == (SUCCESS, struct.pack("<I", 0x0EFF0001))
