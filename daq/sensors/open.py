"""The edge where real hardware is opened: the only place that knows smbus2.SMBus and serial.Serial.

Everything behind it sees `daq.sensors.bus.I2cBus` and `daq.sensors.bus.SerialPort`.
"""

import errno
import fcntl
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from daq.clock import Clock
from daq.contract.errors import UserError
from daq.sensors.bus import I2cBus, SerialPort
from daq.sensors.config import SensorsConfig

I2C_TIMEOUT = 0x0702  # linux/i2c-dev.h, unit 10 ms
I2C_RETRIES = 0x0701
REOPEN_AFTER_NS = 1_000_000_000


class HardwareError(UserError):
    """A bus or port that cannot be opened."""


@dataclass(frozen=True, slots=True)
class Hardware:
    """What the sampler is given. Any of them is None when nothing fitted needs it."""

    bus: I2cBus | None
    gnss: SerialPort | None
    autopilot: SerialPort | None
    pulse: Callable[[], int | None] | None

    def close(self) -> None:
        """Release everything."""
        for device in (self.bus, self.gnss, self.autopilot):
            if device is not None:
                device.close()


def open_hardware(config: SensorsConfig, clock: Clock) -> Hardware:
    """Open the bus and ports that the configuration needs.

    Raises HardwareError naming the device and what to do.
    """
    capture_serial = config.capture is not None and config.capture.driver == "mavlink_servo"
    chips = [g for g in config.fitted if g not in ("attitude", "gnss") and not (g == "capture" and capture_serial)]
    bus = open_bus(config) if chips else None
    gnss = autopilot = None
    if config.gnss is not None:
        gnss = ReopeningPort(config.gnss.device, config.gnss.baud, clock)
    if capture_serial and config.capture is not None:
        autopilot = ReopeningPort(config.capture.device, config.capture.baud, clock)
    pps = config.gnss.pps if config.gnss else None
    return Hardware(bus, gnss, autopilot, SysfsPulse(Path(pps), clock) if pps else None)


def open_bus(config: SensorsConfig) -> I2cBus:
    """The I2C adapter, with its time-out shortened so that a held bus costs one scan little."""
    from smbus2 import SMBus

    device = config.bus.device
    try:
        bus = SMBus(device)
        fcntl.ioctl(bus.fd, I2C_TIMEOUT, config.bus.timeout_ms // 10)
        fcntl.ioctl(bus.fd, I2C_RETRIES, 0)
    except OSError as error:
        raise HardwareError(
            f"{device}: {_advice(error, 'enable I2C (raspi-config, or dtparam=i2c_arm=on)')}"
        ) from error
    return bus


def _advice(error: OSError, when_missing: str) -> str:
    if error.errno == errno.ENOENT:
        return f"no such device; {when_missing} or correct the key sensors.bus.device"
    if error.errno == errno.EACCES:
        return "no permission; add the user to the group i2c"
    if error.errno == errno.EBUSY:
        return "busy; stop the other program that uses it"
    return f"cannot be opened ({error.strerror or error})"


class ReopeningPort:
    """A serial port that comes back after its plug was pulled: after an error it is opened again, once a second.

    Raises HardwareError when it cannot be opened the first time, OSError later.
    """

    def __init__(self, device: str, baud: int, clock: Clock) -> None:
        import serial

        self._open = lambda: serial.Serial(device, baud, timeout=0, write_timeout=0, exclusive=True)
        self._device = device
        self._clock = clock
        self._retry_ns = 0
        try:
            self._port: serial.Serial | None = self._open()
        except OSError as error:
            busy = error.errno in (errno.EBUSY, errno.EAGAIN) or "lock" in str(error)
            advice = "busy; stop the other program that uses it" if busy else f"cannot be opened ({error})"
            raise HardwareError(f"serial port {device}: {advice}") from error

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
                raise OSError(errno.ENODEV, f"{self._device} is gone")
            self._retry_ns = now + REOPEN_AFTER_NS
            self._port = self._open()
        return self._port

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
        try:
            path.read_text()
        except OSError as error:
            raise HardwareError(
                f"{path}: no pulse-per-second source ({error.strerror}); load the pps-gpio overlay or remove sensors.gnss.pps"
            ) from error

    def __call__(self) -> int | None:
        stamp, _, count = self._path.read_text().strip().partition("#")
        if not count or int(count) == self._count:
            return None
        self._count = int(count)
        seconds, _, nanoseconds = stamp.partition(".")
        age = self._clock.utc_ns() - (int(seconds) * 1_000_000_000 + int(nanoseconds))
        if not 0 <= age < 2_000_000_000:
            return None
        return self._clock.monotonic_ns() - age
