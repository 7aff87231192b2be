"""The edge where real hardware is opened: the only place that knows smbus2.SMBus and serial.Serial.

Everything behind it sees `daq.sensors.bus.I2cBus` and `daq.sensors.bus.SerialPort`.
"""

import errno
import fcntl
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daq.clock import Clock
from daq.sensors.bus import I2cBus, SerialPort
from daq.sensors.config import SensorsConfig

if TYPE_CHECKING:
    from smbus2 import SMBus

I2C_TIMEOUT = 0x0702  # linux/i2c-dev.h, unit 10 ms
I2C_RETRIES = 0x0701
REOPEN_AFTER_NS = 1_000_000_000
LASTING_NAMES = "/dev/serial/by-id"  # udev's names, which an adapter keeps whatever number it gets
LOOK_AFTER_NS = 200_000_000  # between two looks at whether a bus that fails is still there


class HardwareAbsent(OSError):
    """A bus or port that cannot be opened at present; the sentence names it and says what to do."""


@dataclass(frozen=True, slots=True)
class Hardware:
    """What the sampler is given. Any of them is None when nothing fitted needs it.

    absent: a sentence for each that was not there when it was asked for; it is tried again for as long as the logger runs.
    """

    bus: I2cBus | None
    gnss: SerialPort | None
    autopilot: SerialPort | None
    pulse: Callable[[], int | None] | None
    absent: tuple[str, ...] = ()

    def close(self) -> None:
        """Release everything."""
        for device in (self.bus, self.gnss, self.autopilot):
            if device is not None:
                device.close()


def open_hardware(config: SensorsConfig, clock: Clock) -> Hardware:
    """Open the bus and ports that the configuration needs.

    What is not there yet, in whatever order things get their power, is no error: `Hardware.absent` says it, and it joins
    when it comes.
    """
    capture_serial = config.capture is not None and config.capture.driver == "mavlink_servo"
    chips = [g for g in config.fitted if g not in ("attitude", "gnss") and not (g == "capture" and capture_serial)]
    bus = ReopeningBus(config.bus.device, config.bus.timeout_ms, clock) if chips else None
    gnss = autopilot = pulse = None
    if config.gnss is not None:
        gnss = ReopeningPort(config.gnss.device, config.gnss.baud, clock)
        pulse = SysfsPulse(Path(config.gnss.pps), clock) if config.gnss.pps else None
    if capture_serial and config.capture is not None:
        autopilot = ReopeningPort(config.capture.device, config.capture.baud, clock)
    opened = (bus, gnss, autopilot, pulse)
    return Hardware(bus, gnss, autopilot, pulse, tuple(o.absence for o in opened if o is not None and o.absence))


def _advice(error: OSError, when_missing: str) -> str:
    if error.errno == errno.ENOENT:
        return f"no such device; {when_missing} or correct the key sensors.bus.device"
    if error.errno == errno.EACCES:
        return "no permission; add the user to the group i2c"
    if error.errno == errno.EBUSY:
        return "busy; stop the other program that uses it"
    return f"cannot be opened ({error.strerror or error})"


class ReopeningBus:
    """An I2C adapter that comes back after its plug was pulled, whatever number it then has.

    As long as anybody holds a file of an adapter that is gone, the kernel keeps its number, and its USB hub sees nothing
    new. So after an error the name is looked at: where it leads elsewhere, or nowhere, the file is closed and the name is
    tried again once a second. `device` should be a name that udev keeps. Time-outs are shortened so that a held bus costs
    one scan little. Raises OSError.
    """

    def __init__(self, device: str, timeout_ms: int, clock: Clock) -> None:
        self._device = device
        self._timeout = timeout_ms // 10
        self._clock = clock
        self._retry_ns = self._look_ns = 0
        self._bus: SMBus | None = None
        self._why = ""  # of the last time it could not be opened
        self.absence = ""
        """Why it could not be opened at the start; empty when it could."""
        try:
            self._usable()
            self._retry_ns = 0
        except OSError as error:
            self.absence = error.strerror or str(error)

    def read_byte_data(self, i2c_addr: int, register: int, /) -> int:
        try:
            return int(self._usable().read_byte_data(i2c_addr, register))
        except OSError:
            self._look()
            raise

    def write_byte_data(self, i2c_addr: int, register: int, value: int, /) -> None:
        try:
            self._usable().write_byte_data(i2c_addr, register, value)
        except OSError:
            self._look()
            raise

    def read_i2c_block_data(self, i2c_addr: int, register: int, length: int, /) -> list[int]:
        try:
            return list(self._usable().read_i2c_block_data(i2c_addr, register, length))
        except OSError:
            self._look()
            raise

    def write_i2c_block_data(self, i2c_addr: int, register: int, data: Sequence[int], /) -> None:
        try:
            self._usable().write_i2c_block_data(i2c_addr, register, data)
        except OSError:
            self._look()
            raise

    def i2c_rdwr(self, *i2c_msgs: Any) -> None:
        try:
            self._usable().i2c_rdwr(*i2c_msgs)
        except OSError:
            self._look()
            raise

    def close(self) -> None:
        if self._bus is not None:
            self._bus.close()
            self._bus = None

    def _open(self) -> "SMBus":
        from smbus2 import SMBus

        bus = SMBus(self._device)
        try:
            fcntl.ioctl(bus.fd, I2C_TIMEOUT, self._timeout)
            fcntl.ioctl(bus.fd, I2C_RETRIES, 0)
        except OSError:
            bus.close()
            raise
        return bus

    def _usable(self) -> "SMBus":
        if self._bus is None:
            now = self._clock.monotonic_ns()
            if now < self._retry_ns:
                raise HardwareAbsent(errno.ENODEV, self._why or f"{self._device} is gone")
            self._retry_ns = now + REOPEN_AFTER_NS
            try:
                self._bus = self._open()
            except OSError as error:
                advice = _advice(error, "enable I2C (raspi-config, or dtparam=i2c_arm=on)")
                self._why = f"{self._device}: {advice}"
                raise HardwareAbsent(errno.ENODEV, self._why) from error
        return self._bus

    def _look(self) -> None:
        """After an error: let go of an adapter that is no longer there. Not at every error: a chip may be missing for hours."""
        now = self._clock.monotonic_ns()
        if self._bus is None or now < self._look_ns:
            return
        self._look_ns = now + LOOK_AFTER_NS
        held = os.fstat(self._bus.fd)
        try:
            named = Path(self._device).stat()
            there = (held.st_dev, held.st_ino) == (named.st_dev, named.st_ino)
        except OSError:
            there = False
        if not there:
            self.close()


class ReopeningPort:
    """A serial port that comes when it is plugged in, and comes back after its plug was pulled: it is tried once a second.

    Everything but making it raises OSError while it is away, with a sentence that names it.
    """

    def __init__(self, device: str, baud: int, clock: Clock) -> None:
        import serial

        self._open = lambda: serial.Serial(device, baud, timeout=0, write_timeout=0, exclusive=True)
        self._device = device
        self._clock = clock
        self._retry_ns = 0
        self._port: serial.Serial | None = None
        self._why = ""  # of the last time it could not be opened
        self.absence = ""
        """Why it could not be opened at the start; empty when it could."""
        try:
            self._usable()
            self._retry_ns = 0
        except OSError as error:
            self.absence = error.strerror or str(error)

    @property
    def in_waiting(self) -> int:
        port = self._usable()
        try:
            return int(port.in_waiting)
        except OSError:
            self._drop()
            raise

    def read(self, size: int = 1, /) -> bytes:
        port = self._usable()
        try:
            return bytes(port.read(size))
        except OSError:
            self._drop()
            raise

    def write(self, data: bytes, /) -> int | None:
        port = self._usable()
        try:
            return port.write(data)
        except OSError:
            self._drop()
            raise

    def close(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None

    def _usable(self) -> "SerialPort":
        if self._port is None:
            now = self._clock.monotonic_ns()
            if now < self._retry_ns:
                raise HardwareAbsent(errno.ENODEV, self._why or f"{self._device} is gone")
            self._retry_ns = now + REOPEN_AFTER_NS
            try:
                self._port = self._open()
            except OSError as error:
                self._why = self._why_not(error)
                raise HardwareAbsent(errno.ENODEV, self._why) from error
        return self._port

    def _why_not(self, error: OSError) -> str:
        if error.errno in (errno.EBUSY, errno.EAGAIN) or "lock" in str(error):
            return f"serial port {self._device}: busy; stop the other program that uses it"
        if error.errno == errno.EACCES:
            return f"serial port {self._device}: no permission; add the user to the group dialout"
        if error.errno == errno.ENOENT:
            return f"serial port {self._device}: no such device; plug it in, or name it as it stands in {LASTING_NAMES}"
        return f"serial port {self._device}: cannot be opened ({error.strerror or error})"

    def _drop(self) -> None:
        self._retry_ns = self._clock.monotonic_ns() + REOPEN_AFTER_NS
        self.close()


class SysfsPulse:
    """Edges of a pulse-per-second line from the kernel's sysfs file, as monotonic times.

    The kernel stamps edges in UTC as the system believes it (`seconds.nanoseconds#count`); the stamp is carried to the
    monotonic clock by reading both clocks now, so a step of the system's UTC in between spoils one edge at most.
    """

    def __init__(self, path: Path, clock: Clock) -> None:
        self._path = path
        self._clock = clock
        self._count = -1
        self.absence = ""
        """Why there was no such source at the start; empty when there was."""
        try:
            path.read_text()
        except OSError as error:
            cure = "load the pps-gpio overlay or remove sensors.gnss.pps"
            self.absence = f"{path}: no pulse-per-second source ({error.strerror}); {cure}"

    def __call__(self) -> int | None:
        try:
            stamp, _, count = self._path.read_text().strip().partition("#")
        except OSError:  # not loaded yet, or the driver has gone
            return None
        if not count or int(count) == self._count:
            return None
        self._count = int(count)
        seconds, _, nanoseconds = stamp.partition(".")
        age = self._clock.utc_ns() - (int(seconds) * 1_000_000_000 + int(nanoseconds))
        if not 0 <= age < 2_000_000_000:
            return None
        return self._clock.monotonic_ns() - age
