"""The simulated aircraft on the far side of the machine's sockets: chips behind a USB adapter, GPS and radio behind serial lines.

One thread serves them all, on simulated time that follows the clock on the wall: the machine's own speed is its own affair.
"""

import selectors
import socket
import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType

from daq.clock import SimulatedClock
from firmware_sim.hardware.board import ADDRESSES
from firmware_sim.hardware.bus import SimulatedBus
from firmware_sim.hardware.faults import FaultSet
from firmware_sim.hardware.registers.ads1115 import Ads1115Chip
from firmware_sim.hardware.sensing.sensor_models import SensorModels, parse_sensors
from firmware_sim.runs.flight import SimulatedHardware, build_aircraft
from firmware_sim.world.scenario import Scenario, load_scenario
from firmware_sim.world.truth import Truth
from firmware_sim.world.world import World
from tests.rig.tiny_usb import TinyUsb
from tests.rig.usbredir import RedirectedDevice

SOCKETS = ("sensors", "spare", "gps", "radio")
"""Sockets that the machine connects to: two USB devices, of which the second has nothing on its bus, and two serial lines."""
_TICK_S = 0.01
_LOOK_NS = 1_000_000_000  # well within the time for which instruments remember
_BURST_BYTES = 14
_KEPT = 4_000_000  # bytes of the radio


class Waiting:
    """A truth source that stands still at the start of its flight until it is let go, and again at the flight's end."""

    def __init__(self, scenario: Scenario) -> None:
        self._world = World(scenario)
        self._released_s: float | None = None
        self._now_s = 0.0
        self.flown = threading.Event()

    def release(self) -> None:
        """Fly, from now on."""
        self._released_s = self._now_s

    def advance(self, to_time: float) -> Truth:
        """See `TruthSource`."""
        self._now_s = to_time
        airborne = 0.0 if self._released_s is None else to_time - self._released_s
        if airborne >= self._world.duration:
            self.flown.set()
        truth = self._world.advance(max(self._world.time, min(airborne, self._world.duration)))
        return replace(truth, time=to_time)


@dataclass
class _Line:
    """One connection of the machine; usb: the device behind it, None for a serial line."""

    name: str
    connection: socket.socket
    usb: RedirectedDevice | None = None


class Bench:
    """Serves one machine at a time over sockets in `folder`; a context manager.

    adapter: the sensors' bus. heard: what the radio has sent. readings: every burst of accelerations, rates and
    temperature that the IMU has given away, 14 bytes as on the bus, with the last time it did [s, monotonic].
    """

    def __init__(self, folder: Path, scenario: str = "quiet", seed: int = 1) -> None:
        self.folder = folder
        self.heard = bytearray()
        self._lock = threading.Lock()
        loaded = load_scenario(scenario).altered(flight={"seed": seed})
        self._clock = SimulatedClock(time.time_ns())
        self._origin_ns = time.monotonic_ns()
        self.truth = Waiting(loaded)
        models: SensorModels = parse_sensors(loaded.sensors, loaded.name)
        self.aircraft: SimulatedHardware = build_aircraft(self.truth, models, FaultSet((), 0, seed), self._clock, seed)
        self.adapter = TinyUsb(self.aircraft.bus, self._catch_up)
        self.readings: dict[bytes, float] = {}
        self.adapter.on_read = self._note
        self._plugged = {"sensors": True, "spare": False}
        self._lines: dict[str, _Line] = {}
        self._next_look_ns = 0
        self._selector = selectors.DefaultSelector()
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="bench", daemon=True)

    def __enter__(self) -> "Bench":
        for name in SOCKETS:
            listener = socket.socket(socket.AF_UNIX)
            listener.bind(str(self.folder / name))
            listener.listen(1)
            self._selector.register(listener, selectors.EVENT_READ, name)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ending.set()
        self._thread.join()
        for key in list(self._selector.get_map().values()):
            assert isinstance(key.fileobj, socket.socket)
            key.fileobj.close()
        self._selector.close()
        for name in SOCKETS:
            (self.folder / name).unlink()

    def plug(self, name: str, there: bool) -> None:
        """Plug a USB adapter (`sensors`, `spare`) in, or pull it."""
        with self._lock:
            self._plugged[name] = there
            line = self._lines.get(name)
            if line is not None and line.usb is not None:
                if there:
                    line.usb.plug_in()
                else:
                    line.usb.unplug()

    def power_cycle(self) -> None:
        """The sensors' supply goes and comes with the machine's."""
        with self._lock:
            self.aircraft.bus.set_power(False)
            self.aircraft.bus.set_power(True)

    def _note(self, address: int, data: bytes) -> None:
        if address == ADDRESSES["imu"] and len(data) == _BURST_BYTES:
            self.readings[data] = time.monotonic()

    def _catch_up(self) -> None:
        self._clock.advance_to(time.monotonic_ns() - self._origin_ns)

    def _serve(self) -> None:
        self._clock.drive()
        while not self._ending.is_set():
            ready = self._selector.select(_TICK_S)
            with self._lock:
                self._catch_up()
                for key, _ in ready:
                    if isinstance(key.data, str):
                        self._accept(key.data, key.fileobj)  # type: ignore[arg-type]  # sockets only
                    else:
                        self._receive(key.data)
                self._send_gps()
                self._keep_up()

    def _accept(self, name: str, listener: socket.socket) -> None:
        connection, _ = listener.accept()
        line = _Line(name, connection)
        if name in self._plugged:
            device = self.adapter if name == "sensors" else TinyUsb(SimulatedBus(self._clock, {}), self._catch_up)
            line.usb = RedirectedDevice(device, connection.sendall)
            if self._plugged[name]:
                line.usb.plug_in()
        self._lines[name] = line
        self._selector.register(connection, selectors.EVENT_READ, line)

    def _receive(self, line: _Line) -> None:
        try:
            data = line.connection.recv(65536)
            if data and line.usb is not None:
                line.usb.receive(data)
        except OSError:  # the machine was killed in the middle of it
            data = b""
        if not data:
            self._drop(line)
        elif line.name == "gps":
            self.aircraft.gnss.receive(data, self._clock.monotonic_ns())
        elif line.name == "radio" and len(self.heard) < _KEPT:
            self.heard += data

    def _send_gps(self) -> None:
        data = self.aircraft.gnss.bytes_until(self._clock.monotonic_ns())
        line = self._lines.get("gps")
        if data and line is not None:
            try:
                line.connection.send(data, socket.MSG_DONTWAIT)
            except BlockingIOError:
                pass  # nobody reads: on a wire the bytes would be gone too
            except OSError:
                self._drop(line)

    def _keep_up(self) -> None:
        """Have the converters take what they were asked to convert, also when nobody comes for it before it is forgotten."""
        now = self._clock.monotonic_ns()
        if now < self._next_look_ns:
            return
        self._next_look_ns = now + _LOOK_NS
        for chip in self.aircraft.bus.chips.values():
            if isinstance(chip, Ads1115Chip):
                chip.read(2, now)

    def _drop(self, line: _Line) -> None:
        self._selector.unregister(line.connection)
        line.connection.close()
        if self._lines.get(line.name) is line:
            del self._lines[line.name]
