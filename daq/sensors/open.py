"""Opening of real hardware: the only module that uses smbus2.SMBus and serial.Serial.

All others use `daq.sensors.bus.I2cBus` and `daq.sensors.bus.SerialPortCalls`.
"""

import errno
import fcntl
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from daq.clock import Clock
from daq.sensors.config import SensorsConfig
from daq.sensors.sbus import FRAMING

I2C_TIMEOUT = 0x0702  # linux/i2c-dev.h, unit 10 ms
I2C_RETRIES = 0x0701
REOPEN_AFTER_NS = 1_000_000_000
BY_ID = Path("/dev/serial/by-id")
"""Names of serial adapters that do not depend on the order of plugging in."""
LOOK_AFTER_NS = 200_000_000  # between two checks whether a bus that fails is still present


@dataclass(frozen=True, slots=True)
class Hardware:
    """The devices of the sampler, each None when no fitted sensor needs it."""

    bus: "ReopeningBus | None"
    gnss: "ReopeningPort | None"
    autopilot: "ReopeningPort | None"
    pulse: "SysfsPulse | None"

    @property
    def devices(self) -> tuple["_Reopening", ...]:
        """The bus and ports that are needed, opened or not."""
        return tuple(d for d in (self.bus, self.gnss, self.autopilot) if d is not None)

    @property
    def absent(self) -> tuple[str, ...]:
        """A sentence on every bus, port and pulse that was missing at start."""
        pulse = () if self.pulse is None else (self.pulse.absent,)
        return tuple(reason for reason in (*(d.absent for d in self.devices), *pulse) if reason)

    def close(self) -> None:
        """Close all devices."""
        for device in self.devices:
            device.close()


def open_hardware(config: SensorsConfig, clock: Clock) -> Hardware:
    """Open the bus and ports that the configuration needs; a missing one is opened later, tried once a second."""
    of_port = {"gnss", *config.derived, *config.from_sender, *(("capture",) if config.without_bus else ())}
    bus = None
    if set(config.fitted) - of_port:
        bus = ReopeningBus(config.bus.device, config.bus.timeout_ms, clock)
    gnss = autopilot = None
    if config.gnss is not None and "gnss" not in config.from_sender:
        gnss = ReopeningPort(config.gnss.device, config.gnss.baud, clock)
    if config.autopilot_port is not None:
        autopilot = ReopeningPort(*config.autopilot_port, clock, FRAMING if config.has_sbus else {})
    pps = config.gnss.pps if config.gnss else None
    return Hardware(bus, gnss, autopilot, SysfsPulse(Path(pps), clock) if pps else None)


class _Reopening:
    """A device that is opened again, tried once a second, while it is missing; meanwhile every call raises OSError.

    absent: why it was missing at start, or "".
    """

    def __init__(self, device: str, clock: Clock) -> None:
        self._device = device
        self._clock = clock
        self._retry_ns = 0
        self._opened: Any = None
        self.absent = ""
        try:
            self._opened = self._open()
        except OSError as error:
            self._retry_ns = clock.monotonic_ns() + REOPEN_AFTER_NS
            self.absent = self._advice(error)

    def _open(self) -> Any:
        raise NotImplementedError

    def _advice(self, error: OSError) -> str:
        raise NotImplementedError

    def _failed(self) -> None:
        """Close the device after a failed call, if it must be opened again."""
        raise NotImplementedError

    def _device_or_open(self) -> Any:
        """The device, opened if it is not yet. Raises OSError while it is missing."""
        if self._opened is None:
            now_ns = self._clock.monotonic_ns()
            if now_ns < self._retry_ns:
                raise OSError(errno.ENODEV, f"{self._device} is not there")
            self._retry_ns = now_ns + REOPEN_AFTER_NS
            try:
                self._opened = self._open()
            except FileNotFoundError as error:  # smbus2's message does not name the device
                raise OSError(errno.ENODEV, f"{self._device} is not there") from error
        return self._opened

    def _use(self, method: str, *arguments: Any) -> Any:
        device = self._opened or self._device_or_open()
        try:
            return getattr(device, method)(*arguments)
        except OSError:
            self._failed()
            raise

    def close(self) -> None:
        if self._opened is not None:
            self._opened.close()
            self._opened = None


class ReopeningBus(_Reopening):
    """An I2C adapter that is opened again after it was unplugged, whatever number it then has.

    While a process holds the file of an adapter that is gone, the kernel reserves its number, and the USB hub reports no new
    device. After an error, therefore, the file is closed if the name no longer leads to it, and the name is opened again, tried
    once a second. `device` should be a persistent udev name. timeout_ms: of a transfer, short so that a held bus delays one scan
    only a little.
    """

    def __init__(self, device: str, timeout_ms: int, clock: Clock) -> None:
        self._timeout = timeout_ms // 10
        self._look_ns = 0
        super().__init__(device, clock)

    def read_byte_data(self, i2c_addr: int, register: int, /) -> int:
        return int(self._use("read_byte_data", i2c_addr, register))

    def write_byte_data(self, i2c_addr: int, register: int, value: int, /) -> None:
        self._use("write_byte_data", i2c_addr, register, value)

    def read_i2c_block_data(self, i2c_addr: int, register: int, length: int, /) -> list[int]:
        bus = self._opened or self._device_or_open()  # not `_use`: this and the next run forty times a scan
        try:
            data: list[int] = bus.read_i2c_block_data(i2c_addr, register, length)
        except OSError:
            self._failed()
            raise
        return data

    def write_i2c_block_data(self, i2c_addr: int, register: int, data: Sequence[int], /) -> None:
        bus = self._opened or self._device_or_open()
        try:
            bus.write_i2c_block_data(i2c_addr, register, data)
        except OSError:
            self._failed()
            raise

    def i2c_rdwr(self, *i2c_msgs: Any) -> None:
        self._use("i2c_rdwr", *i2c_msgs)

    def _open(self) -> Any:
        from smbus2 import SMBus

        from daq.sensors.transfers import prepared

        bus = SMBus(self._device)
        try:
            fcntl.ioctl(bus.fd, I2C_TIMEOUT, self._timeout)
            fcntl.ioctl(bus.fd, I2C_RETRIES, 0)
        except OSError:
            bus.close()
            raise
        return prepared(bus)

    def _advice(self, error: OSError) -> str:
        if error.errno == errno.ENOENT:
            enable = "enable I2C (raspi-config, or dtparam=i2c_arm=on)"
            advice = f"no such device; {enable} or correct the key sensors.bus.device"
        elif error.errno == errno.EACCES:
            advice = "no permission; add the user to the group i2c"
        elif error.errno == errno.EBUSY:
            advice = "busy; stop the other program that uses it"
        else:
            advice = f"cannot be opened ({error.strerror or error})"
        return f"{self._device}: {advice}"

    def _failed(self) -> None:
        """Close an adapter that is no longer present. Not checked at every error, for a chip may be missing for hours."""
        now_ns = self._clock.monotonic_ns()
        if self._opened is None or now_ns < self._look_ns:
            return
        self._look_ns = now_ns + LOOK_AFTER_NS
        open_file = os.fstat(self._opened.fd)
        try:
            device_file = Path(self._device).stat()
            present = (open_file.st_dev, open_file.st_ino) == (device_file.st_dev, device_file.st_ino)
        except OSError:
            present = False
        if not present:
            self.close()


class ReopeningPort(_Reopening):
    """A serial port that is opened again after it was unplugged. framing: further arguments of `serial.Serial`."""

    def __init__(self, device: str, baud: int, clock: Clock, framing: Mapping[str, Any] = MappingProxyType({})) -> None:
        self._baud, self._framing = baud, framing
        super().__init__(device, clock)

    @property
    def in_waiting(self) -> int:
        return int(self._use("__getattribute__", "in_waiting"))  # a property

    def read(self, size: int = 1, /) -> bytes:
        return bytes(self._use("read", size))

    def write(self, data: bytes, /) -> int | None:
        accepted: int | None = self._use("write", data)
        return accepted

    def _open(self) -> Any:
        import serial

        return serial.Serial(self._device, self._baud, timeout=0, write_timeout=0, exclusive=True, **self._framing)

    def _advice(self, error: OSError) -> str:
        if error.errno in (errno.EBUSY, errno.EAGAIN) or "lock" in str(error):
            advice = "busy; stop the other program that uses it"
        elif error.errno == errno.EACCES:
            advice = "no permission; add the user to the group dialout"
        elif error.errno == errno.ENOENT:
            present = ", ".join(sorted(p.name for p in BY_ID.glob("*")))
            advice = (
                f"no such device; {f'under {BY_ID} are {present}' if present else f'nothing is under {BY_ID} either'}"
            )
        else:
            advice = f"cannot be opened ({error}); a name under {BY_ID} stays the same on every plug"
        return f"serial port {self._device}: {advice}"

    def _failed(self) -> None:
        self._retry_ns = self._clock.monotonic_ns() + REOPEN_AFTER_NS
        self.close()


class SysfsPulse:
    """Edges of a pulse-per-second line from the kernel's sysfs file; a call returns the monotonic time of a new one [ns], or
    None.

    The kernel stamps edges in the system's UTC (`seconds.nanoseconds#count`). The stamp is converted to the monotonic clock by
    reading both clocks now, so that a step of UTC in between spoils at most one edge.
    """

    def __init__(self, path: Path, clock: Clock) -> None:
        self._path = path
        self._clock = clock
        self._count = -1
        self.absent = ""
        try:
            path.read_text()
        except OSError as error:
            reason = f"no pulse-per-second source ({error.strerror})"
            self.absent = f"{path}: {reason}; load the pps-gpio overlay or remove sensors.gnss.pps"

    def __call__(self) -> int | None:
        try:
            stamp, _, count = self._path.read_text().strip().partition("#")
        except OSError:  # no source, or not yet
            return None
        if not count or int(count) == self._count:
            return None
        self._count = int(count)
        seconds, _, nanoseconds = stamp.partition(".")
        age = self._clock.utc_ns() - (int(seconds) * 1_000_000_000 + int(nanoseconds))
        if not 0 <= age < 2_000_000_000:
            return None
        return self._clock.monotonic_ns() - age
