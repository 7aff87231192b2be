"""An aircraft's link and a ground station joined in memory, with everything between them under the test's control."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from daq.clock import SimulatedClock
from daq.contract.channels import CHANNELS, GROUP_NAMES, Rate
from daq.contract.manoeuvre import ManoeuvreCheck
from daq.contract.recordings.messages import EventMessage
from daq.contract.recordings.recording import RecordingInfo
from daq.contract.scan import GroupStatus, Scan, SensorState
from daq.telemetry.config import DownlinkConfig
from daq.telemetry.link import RadioLink, radio_link
from daq.transport.ports import memory_pair
from groundstation.receiver import events as ev
from groundstation.receiver.ports import LinkConfig
from groundstation.receiver.receive import Receiver

START_UTC_NS = 1_795_000_000_000_000_000
PERIOD_NS = 50_000_000


def random_scan(number: int, rng: np.random.Generator, *, time_ns: int | None = None, gnss: bool | None = None) -> Scan:
    """A scan with values anywhere in their raw types, as a hostile sensor would deliver."""
    values: dict[str, int | float] = {}
    with_gnss = number % 2 == 0 if gnss is None else gnss
    for c in CHANNELS:
        if c.rate is Rate.SLOW and not with_gnss:
            continue
        low, high = c.limits()
        if c.name in ("static_pressure", "static_temperature"):
            high = 2**24 - 1
        if c.name == "thrust_load":
            low, high = -(2**23), 2**23 - 1
        values[c.name] = int(
            rng.integers(int(low), int(high), endpoint=True, dtype=np.uint64 if low >= 0 else np.int64)
        )
    groups = {g: GroupStatus(SensorState(int(rng.integers(0, 8))), int(rng.integers(0, 12000))) for g in GROUP_NAMES}
    at = number * PERIOD_NS + int(rng.integers(0, 100_000)) if time_ns is None else time_ns
    return Scan(number, at, START_UTC_NS + at, 25_000, int(rng.integers(0, 3000)), groups, values)


def quiet_scan(number: int, rng: np.random.Generator, *, time_ns: int, speed_mm_s: int = 0) -> Scan:
    """A scan of a healthy aircraft standing still (or moving north at `speed_mm_s`), with realistic noise."""
    values: dict[str, int | float] = {}
    for c in CHANNELS:
        if c.rate is Rate.SLOW and number % 2:
            continue
        values[c.name] = 0 if c.raw_type == "bit" else int(abs(rng.normal(100, 3)))
    values |= {"accel_z": -4096 + int(rng.normal(0, 4)), "quaternion_w": 32767, "quaternion_x": 0}
    values |= {"quaternion_y": 0, "quaternion_z": 0, "pwm_4": 10000, "pitot_pressure": 8192 + int(rng.normal(0, 2))}
    values |= {"gyro_x": int(rng.normal(0, 3)), "gyro_y": 0, "gyro_z": 0}
    if not number % 2:
        values |= {"gnss_fix": 3, "gnss_satellites": 11, "latitude_e7": 473977420, "longitude_e7": 85455940}
        values |= {"height_msl_mm": 488000, "velocity_north_mm": speed_mm_s, "velocity_east_mm": 0}
        values |= {"velocity_down_mm": 0}
    groups = {g: GroupStatus(SensorState.OK, 300 + 40 * i) for i, g in enumerate(GROUP_NAMES)}
    return Scan(number, time_ns, START_UTC_NS + time_ns, 30, 12, groups, values)


@dataclass
class FakeLogger:
    """What commands act on."""

    recording: bool = True
    marks: list[tuple[str, str]] = field(default_factory=list)
    starts: int = 0
    stops: int = 0
    asked: list[int | None] = field(default_factory=list)
    answer: str = ""

    def start_recording(self) -> bool:
        self.starts += 1
        changed, self.recording = not self.recording, True
        return changed

    def stop_recording(self) -> bool:
        self.stops += 1
        changed, self.recording = self.recording, False
        return changed

    def mark_event(self, text: str, origin: str) -> EventMessage:
        self.marks.append((text, origin))
        return EventMessage(0, 0, len(self.marks), origin, text)

    def request_sequencer(self, digest: int | None) -> str:
        self.asked.append(digest)
        return self.answer

    check_manoeuvre: ManoeuvreCheck | None = None

    def statistics(self) -> None:
        return None


class Rig:
    """One aircraft and one ground station; `down` and `up` may change the bytes on their way."""

    def __init__(
        self,
        folder: Path | None,
        *,
        down: Callable[[bytes], bytes] = lambda data: data,
        up: Callable[[bytes], bytes] = lambda data: data,
        aircraft: DownlinkConfig | None = None,
        ground: LinkConfig | None = None,
        boot: int = 7,
        recordings: tuple[Path, ...] = (),
    ) -> None:
        self.clock = SimulatedClock(START_UTC_NS)
        self.down, self.up = down, up
        self.logger = FakeLogger()
        self.facts = {"static.t1": "27504"}
        self.scans: dict[int, Scan] = {}
        self.number = 0
        self.events: list[ev.Event] = []
        self._aircraft_end, self._air = memory_pair()
        self._ground_end, self._ground = memory_pair()
        self.aircraft_config = aircraft or DownlinkConfig(budget_bytes_per_s=20_000, backfill_memory_mb=8)
        self.ground_config = ground or LinkConfig(ports=("memory",))
        self._recordings = recordings
        self.link = self._link(boot)
        self.clock.follow(lambda: self.link.backfill.preparing)
        self.ground = Receiver(self.ground_config, {"memory": self._ground_end}, self.clock, folder=folder)

    def _link(self, boot: int) -> RadioLink:
        info = RecordingInfo("flight1", "simulated", "cdfp", details=self.facts, attachments={"config.toml": b"x=1"})
        return radio_link(
            self.aircraft_config,
            self._aircraft_end,
            self.clock,
            papers=lambda: replace(info, details=dict(self.facts)),
            recordings=self._recordings,
            boot=boot,
        )

    def restart_aircraft(self, boot: int) -> None:
        """The logger starts anew: numbers begin at 0 again."""
        self.link.uplink.close()
        self.link = self._link(boot)
        self.number = 0

    def exchange(self) -> None:
        """Move bytes both ways and let the ground look at them."""
        data = self._air.read(1 << 20)
        if data:
            self._ground.write(self.down(data))
        self.events += self.look()
        data = self._ground.read(1 << 20)
        if data:
            self._air.write(self.up(data))

    def look(self) -> list[ev.Event]:
        """Let the ground take what has arrived."""
        return self.ground.poll()

    def findings(self, kind: ev.ReceptionFindingKind) -> list[ev.ReceptionFinding]:
        return [e for e in self.events if isinstance(e, ev.ReceptionFinding) and e.kind is kind]

    def fly(self, scans: int, make: Callable[[int], Scan]) -> None:
        """So many scans at 20 Hz."""
        for _ in range(scans):
            self.clock.advance(PERIOD_NS)
            scan = make(self.number)
            self.scans[self.number] = scan
            self.number += 1
            self.link.offer(scan)
            self.link.service(self.clock.monotonic_ns())
            self.link.uplink.service(self.clock.monotonic_ns(), self.logger)
            self.exchange()

    def rest(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        """Time passes without scans, until something is so."""
        for _ in range(round(seconds * 20)):
            if until():
                return
            self.clock.advance(PERIOD_NS)
            self.link.idle(self.clock.monotonic_ns())
            self.exchange()

    def received(self) -> list[ev.ScanReceived]:
        """Scan events so far."""
        return [e for e in self.events if isinstance(e, ev.ScanReceived)]

    def close(self) -> None:
        self.link.close()
        self.ground.close()
