"""The edge: what opens hardware, what must never see it, and how a laboratory adds a sensor."""

import ast
import ctypes
import errno
import fcntl
import os
import pty
import re
import select
import subprocess
import sys
import textwrap
import threading
import tty
from pathlib import Path
from typing import Any

import pytest
import smbus2
from smbus2.smbus2 import I2C_M_RD, I2C_RDWR, I2C_SLAVE

from daq.acquisition.sampler import Sampler
from daq.clock import RealClock, SimulatedClock
from daq.sensors import transfers
from daq.sensors.base import DriverConfigError
from daq.sensors.bus import I2cBus, SerialPortCalls, read_raw, read_words, write_raw
from daq.sensors.config import BusConfig, SensorsConfig
from daq.sensors.open import REOPEN_AFTER_NS, ReopeningBus, ReopeningPort, SysfsPulse, open_hardware
from daq.sensors.transfers import PreparedBus, prepared
from daq.sensors.ublox import GnssConfig
from tests.unit.daq.cdfp_fit import cdfp_sensors
from tests.unit.daq.fakes import FakeBus

MAY_IMPORT_HARDWARE = {"daq/sensors/bus.py", "daq/sensors/open.py", "daq/sensors/transfers.py"}
DRIVER_CODE = (
    "daq/sensors",
    "daq/acquisition/sampler.py",
    "daq/acquisition/supervisor.py",
    "daq/acquisition/health.py",
    "daq/acquisition/attitude.py",
    "daq/sensors/bus.py",
)


def imported(path: Path) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {a.name.split(".")[0] for a in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module.split(".")[0])
    return names


def test_only_the_edge_knows_hardware_libraries_and_nobody_the_simulator(root: Path) -> None:
    files = [f for d in DRIVER_CODE for f in ([root / d] if d.endswith(".py") else sorted((root / d).rglob("*.py")))]
    assert len(files) > 15
    for file in files:
        name = str(file.relative_to(root))
        found = imported(file)
        assert not found & {"firmware_sim", "groundstation", "estimation", "sideslip"}, name
        if name not in MAY_IMPORT_HARDWARE:
            assert not found & {"smbus2", "serial"}, name


def run_python(code: str, root: Path) -> str:
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)], cwd=root, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_importing_all_drivers_loads_neither_simulator_nor_heavy_libraries(root: Path) -> None:
    loaded = run_python(
        """
        import importlib, pkgutil, sys
        import daq.acquisition.sampler, daq.sensors
        for module in pkgutil.iter_modules(daq.sensors.__path__):
            importlib.import_module(f"daq.sensors.{module.name}")
        print(" ".join(sorted({m.split(".")[0] for m in sys.modules})))
        """,
        root,
    ).split()
    assert "daq" in loaded
    for unwanted in ("firmware_sim", "serial", "torch", "casadi", "rerun", "matplotlib", "scipy", "groundstation"):
        assert unwanted not in loaded


def test_real_bus_class_fits_the_protocol_and_its_calls() -> None:
    """The very `smbus2.SMBus`, on a device that is no I2C adapter: drivers get as far as the first transfer."""
    assert issubclass(smbus2.SMBus, I2cBus)
    bus = smbus2.SMBus()
    bus.fd = os.open(os.devnull, os.O_RDWR)  # every ioctl on it fails with ENOTTY, an OSError
    bus.funcs = 0
    try:
        sampler = Sampler(cdfp_sensors().model_copy(update={"gnss": None}), bus, None, SimulatedClock())
        health = sampler.start()
        scan = sampler.finish(sampler.take(1, 0))
    finally:
        bus.close()
    assert all("Inappropriate ioctl" in g.detail for g in health.failing if g.group not in ("attitude", "mag"))
    assert not any(s.state.usable for s in scan.groups.values())
    assert scan.values == {}


def test_a_missing_bus_or_port_is_one_sentence_and_no_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bus = cdfp_sensors().model_copy(update={"bus": BusConfig(device=str(tmp_path / "i2c-9"))})
    hardware = open_hardware(bus, RealClock())
    assert re.match(r".*i2c-9: no such device; enable I2C .* key sensors.bus.device", hardware.absent[0])
    hardware.close()
    hardware = open_hardware(SensorsConfig(gnss=GnssConfig(device=str(tmp_path / "ttyX"))), RealClock())
    assert re.match(r"serial port .*ttyX: no such device; .*by-id", hardware.absent[0])
    assert hardware.absent[0].count("ttyX") == 1
    (tmp_path / "usb-u-blox_7-if00").touch()
    monkeypatch.setattr("daq.sensors.open.BY_ID", tmp_path)
    present = open_hardware(SensorsConfig(gnss=GnssConfig(device=str(tmp_path / "ttyX"))), RealClock()).absent[0]
    assert present.endswith(f"under {tmp_path} are usb-u-blox_7-if00")
    with pytest.raises(OSError, match="ttyX"):
        hardware.devices[0].read(1)  # type: ignore[union-attr]
    hardware.close()


def test_a_port_that_comes_late_joins(tmp_path: Path) -> None:
    clock = SimulatedClock()
    port = ReopeningPort(str(tmp_path / "ttyLate"), 115200, clock)
    near, far = pty.openpty()
    tty.setraw(far)
    (tmp_path / "ttyLate").symlink_to(os.ttyname(far))
    with pytest.raises(OSError, match="is not there"):
        port.read(1)  # not before a second has passed
    clock.sleep_until(clock.monotonic_ns() + REOPEN_AFTER_NS)
    assert port.read(1) == b""  # opened
    os.write(near, b"fix")
    assert select.select([far], [], [], 5.0)[0]
    assert port.read(3) == b"fix"
    port.close()
    os.close(near)
    os.close(far)


def test_driver_without_its_port_or_unknown_is_refused() -> None:
    with pytest.raises(DriverConfigError, match=r"sensors\.gnss needs a serial port"):
        Sampler(SensorsConfig(gnss=GnssConfig()), None, None, SimulatedClock())
    with pytest.raises(DriverConfigError, match=r"sensors\.pitot\.driver: no driver 'ms5611' .* use ms4525do"):
        Sampler(SensorsConfig.model_validate({"pitot": {"driver": "ms5611"}}), FakeBus({}), None, SimulatedClock())
    extra = {"extra": {"thrust": {"driver": "no.such.module:Cell"}}}
    with pytest.raises(DriverConfigError, match=r"extra\.thrust\.driver: .* cannot be loaded"):
        Sampler(SensorsConfig.model_validate(extra), FakeBus({}), None, SimulatedClock())


def test_busy_port_is_named() -> None:
    near, far = pty.openpty()
    name = os.ttyname(far)
    first = ReopeningPort(name, 115200, RealClock())
    try:
        assert "busy; stop the other program" in ReopeningPort(name, 115200, RealClock()).absent
    finally:
        first.close()
        os.close(near)
        os.close(far)


def received(port: ReopeningPort, count: int) -> bytes:
    """`count` bytes; the kernel carries them from one end of a pseudo-terminal to the other in its own time."""
    pause = threading.Event()
    for _ in range(1000):
        if port.in_waiting >= count:
            break
        pause.wait(0.002)
    return port.read(count)


def test_serial_port_comes_back_after_its_plug_was_pulled(tmp_path: Path) -> None:
    link = tmp_path / "gps"
    clock = SimulatedClock()
    near, far = pty.openpty()
    link.symlink_to(os.ttyname(far))
    os.close(far)
    port = ReopeningPort(str(link), 115200, clock)
    assert isinstance(port, SerialPortCalls)
    os.write(near, b"abc")
    assert received(port, 3) == b"abc"
    os.close(near)  # unplugged
    link.unlink()
    with pytest.raises(OSError, match=r".+"):
        port.in_waiting or port.read(1)
    with pytest.raises(OSError, match="is not there"):
        port.read(1)
    near, far = pty.openpty()
    link.symlink_to(os.ttyname(far))
    clock.sleep_until(2_000_000_000)
    assert port.in_waiting == 0  # opens it again
    os.write(near, b"de")
    assert received(port, 2) == b"de"
    port.close()
    os.close(near)
    os.close(far)


class Adapter:
    """Stands for `smbus2.SMBus` on a file: answers with what is in it; one that was pulled answers EIO, as i2c-tiny-usb does."""

    funcs = 0  # of smbus2.SMBus only
    pulled: frozenset[str] = frozenset()
    closed: tuple[str, ...] = ()

    def __init__(self, device: str) -> None:
        self.fd = os.open(device, os.O_RDONLY)
        self.where = str(Path(device).resolve())

    def read_byte_data(self, i2c_addr: int, register: int, /) -> int:
        if self.where in Adapter.pulled:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return os.pread(self.fd, 1, register)[0]

    def close(self) -> None:
        Adapter.closed += (Path(self.where).name,)
        os.close(self.fd)


@pytest.fixture
def adapters(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with two adapters, 5 and 7, and the name that leads to the first."""
    (tmp_path / "i2c-5").write_bytes(b"\x05")
    (tmp_path / "i2c-7").write_bytes(b"\x07")
    (tmp_path / "sensors").symlink_to("i2c-5")
    monkeypatch.setattr("smbus2.SMBus", Adapter)
    monkeypatch.setattr(fcntl, "ioctl", lambda *_: 0)
    monkeypatch.setattr(Adapter, "pulled", frozenset())
    monkeypatch.setattr(Adapter, "closed", ())
    return tmp_path


def test_bus_that_was_pulled_is_let_go_and_found_under_another_number(
    adapters: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = SimulatedClock()
    bus = ReopeningBus(str(adapters / "sensors"), 10, clock)
    assert isinstance(bus, I2cBus)
    assert bus.read_byte_data(0x68, 0) == 5
    monkeypatch.setattr(Adapter, "pulled", frozenset({str(adapters / "i2c-5")}))
    (adapters / "sensors").unlink()
    with pytest.raises(OSError, match="Input/output"):
        bus.read_byte_data(0x68, 0)
    assert Adapter.closed == ("i2c-5",)  # at once: the kernel's hub waits for it
    with pytest.raises(OSError, match="sensors is not there"):  # named from the first try on
        bus.read_byte_data(0x68, 0)
    (adapters / "sensors").symlink_to("i2c-7")
    with pytest.raises(OSError, match="is not there"):
        bus.read_byte_data(0x68, 0)  # not tried more often than once a second
    clock.sleep_until(1_500_000_000)
    assert bus.read_byte_data(0x68, 0) == 7
    bus.close()


def test_bus_that_is_there_is_kept_however_often_a_chip_fails(adapters: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SimulatedClock()
    bus = ReopeningBus(str(adapters / "sensors"), 10, clock)
    monkeypatch.setattr(Adapter, "pulled", frozenset({str(adapters / "i2c-5")}))
    for _ in range(50):
        clock.advance(100_000_000)
        with pytest.raises(OSError, match="Input/output"):
            bus.read_byte_data(0x68, 0)
    assert Adapter.closed == ()
    monkeypatch.setattr(Adapter, "pulled", frozenset())
    assert bus.read_byte_data(0x68, 0) == 5
    bus.close()


def test_pulse_stamps_are_carried_to_the_monotonic_clock(tmp_path: Path) -> None:
    file = tmp_path / "assert"
    file.write_text("1000.000002500#41\n")
    clock = SimulatedClock(1_000_300_000_000, start_monotonic_ns=7_000_000_000)
    pulse = SysfsPulse(file, clock)
    assert pulse() == 7_000_000_000 - 300_000_000 + 2_500
    assert pulse() is None  # the same edge once only
    missing = SysfsPulse(tmp_path / "none", clock)
    assert "no pulse-per-second source" in missing.absent
    assert missing() is None


class Kernel:
    """Stands for `ioctl` on an adapter: transactions go to a chip of 256 registers with a running pointer."""

    def __init__(self, address: int, taken: frozenset[int] = frozenset()) -> None:
        self.address, self.taken, self.calls = address, taken, 0
        self.registers, self.pointer = bytearray(range(256)), 0

    def __call__(self, fd: int, request: int, argument: Any) -> None:
        self.calls += 1
        if request == I2C_SLAVE and argument in self.taken:
            raise OSError(errno.EBUSY, os.strerror(errno.EBUSY))
        for message in argument.msgs[: argument.nmsgs] if request == I2C_RDWR else ():
            if message.addr != self.address:
                raise OSError(errno.EREMOTEIO, os.strerror(errno.EREMOTEIO))
            if message.flags & I2C_M_RD:
                ctypes.memmove(
                    message.buf, bytes(self.registers[self.pointer : self.pointer + message.len]), message.len
                )
            else:
                self.pointer, *data = bytes(message)
                self.registers[self.pointer : self.pointer + len(data)] = data


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch) -> Kernel:
    made = Kernel(0x48, frozenset({0x68}))
    monkeypatch.setattr(transfers, "ioctl", made)
    monkeypatch.setattr(smbus2.smbus2, "ioctl", made)
    return made


def test_ready_transfers_carry_what_smbus2_would(kernel: Kernel) -> None:
    bus = PreparedBus(smbus2.SMBus())
    assert isinstance(bus, I2cBus)
    for _ in range(2):  # made, and used again
        assert bus.read_i2c_block_data(0x48, 0x10, 3) == [0x10, 0x11, 0x12]
        assert bus.read_byte_data(0x48, 0xFF) == 0xFF
        assert read_words(bus, 0x48, 0x20, 0x30) == (0x2021, 0x3031)
        assert read_raw(bus, 0x48, 2) == b"\x30\x31"  # from where the pointer stands
        bus.write_i2c_block_data(0x48, 0x20, [0xAB, 0xCD])
        assert read_words(bus, 0x48, 0x20, 0x30) == (0xABCD, 0x3031)
        bus.write_byte_data(0x48, 0x20, 0x20)
        bus.write_byte_data(0x48, 0x21, 0x21)
    write_raw(bus, 0x48, b"\x40\x01")
    assert kernel.registers[0x40] == 1
    calls = kernel.calls
    bus.read_i2c_block_data(0x48, 0x10, 3)
    assert kernel.calls == calls + 1
    with pytest.raises(OSError, match="Remote I/O"):
        bus.read_byte_data(0x49, 0)


def test_chip_that_a_kernel_driver_has_taken_is_busy(kernel: Kernel) -> None:
    bus = PreparedBus(smbus2.SMBus())
    for _ in range(2):
        with pytest.raises(OSError, match="busy"):
            bus.read_byte_data(0x68, 0)
        with pytest.raises(OSError, match="busy"):
            bus.write_byte_data(0x68, 0, 1)
        with pytest.raises(OSError, match="busy"):
            read_words(bus, 0x68, 0, 1)


def test_adapter_of_a_pc_is_used_through_smbus2_itself() -> None:
    bus = smbus2.SMBus()
    bus.funcs = smbus2.I2cFunc.SMBUS_READ_BYTE_DATA
    assert prepared(bus) is bus
    bus.funcs |= smbus2.I2cFunc.I2C
    assert isinstance(prepared(bus), PreparedBus)
