"""A hostile sender at full loopback speed against the ground station as a process: what does it cost the aircraft's frames?

Run: python -m tests.studies.hostile_sender [SECONDS]. The last result is kept in docs/ground.md.
"""

import json
import multiprocessing
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from daq.clock import RealClock
from daq.contract.link.wire import SCAN_FAST_ID, layouts, pack_scan
from daq.contract.recordings.recording import RecordingInfo
from daq.contract.scan import Scan
from daq.telemetry.config import DownlinkConfig
from daq.telemetry.link import radio_link
from daq.transport.mavlink_codec import FrameEncoder
from daq.transport.ports import UdpPort
from groundstation.receiver.timeline import NS
from tests.support.link_rig import FakeLogger, quiet_scan

PERIOD_S = 0.05
AHEAD_S = 2.0
"""The aircraft flies so long before the hostile sender begins."""


def noise(_: int) -> bytes:
    return b"\xfd" * 60_000


def small_noise(_: int) -> bytes:
    return b"\xfd\x09\x00" * 6


def forged_scans(i: int) -> bytes:
    scan = Scan(i * 7919 % 2**32, i * NS, values={"accel_x": i % 30_000})
    encoder = FrameEncoder(1, 1)
    encoder._sequence = i & 255
    return encoder.frame(SCAN_FAST_ID, pack_scan(layouts()[SCAN_FAST_ID], scan, i % 251))


def other_aircraft(i: int) -> bytes:
    encoder = FrameEncoder(2 + i % 250, 1)
    encoder._sequence = i // 250 & 255
    return encoder.frame(SCAN_FAST_ID, pack_scan(layouts()[SCAN_FAST_ID], Scan(i // 250, i // 250 * NS // 20 + 1), 9))


def texts(i: int) -> bytes:
    return FrameEncoder(1, 1).message("STATUSTEXT", severity=0, text=f"\x1b[2Jland at once {i}")


KINDS: dict[str, Callable[[int], bytes]] = {
    "60 kB of 0xFD": noise,
    "18 B of false headers": small_noise,
    "forged scans of the same aircraft": forged_scans,
    "scans of 250 other aircraft": other_aircraft,
    "texts with terminal sequences": texts,
}


def flood(kind: str, port: int, seconds: float, sent: "multiprocessing.Queue[int]") -> None:
    """The hostile sender: as fast as its processor allows, one prepared datagram after another."""
    prepared = [KINDS[kind](i) for i in range(4096)]
    count, until = 0, time.monotonic() + seconds
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
        while time.monotonic() < until:
            for data in prepared[:256] if len(prepared[0]) > 1000 else prepared:
                wire.sendto(data, ("127.0.0.1", port))
                count += 1
    sent.put(count)


def fly(
    port: int, seconds: float, key: Path | None, state: Path, sent: "multiprocessing.Queue[tuple[int, int]]"
) -> None:
    """The aircraft: scans in real time through the real downlink."""
    clock = RealClock()
    wire = UdpPort(remote=("127.0.0.1", port))
    config = DownlinkConfig(budget_bytes_per_s=20_000, key_file=key, signing_state=state)
    info = RecordingInfo("flight1", "simulated", "cdfp")
    link = radio_link(config, wire, clock, papers=lambda: info, boot=7)
    rng, logger = np.random.default_rng(1), FakeLogger()
    begun = time.monotonic()
    number = 0
    while time.monotonic() - begun < seconds + 4.0:  # then it is silent, but answers, so that the maps come through
        if time.monotonic() - begun < seconds:
            link.offer(quiet_scan(number, rng, time_ns=clock.monotonic_ns()))
            number += 1
        link.service(clock.monotonic_ns())
        link.uplink.service(clock.monotonic_ns(), logger)
        time.sleep(max(0.0, PERIOD_S - (time.monotonic() - begun) % PERIOD_S))
    sent.put((len(link.downlink.sent), link.downlink.send_queue.frames_sent))
    link.close()
    wire.close()


@dataclass(frozen=True)
class Result:
    """One run. sent, received: scans. ended_s: from SIGTERM to the end of the process. memory_mb: its peak."""

    kind: str
    key: bool
    first: bool
    hostile: int
    sent: int
    received: int
    uncounted: int
    ended_s: float
    memory_mb: float
    files: int
    summary: dict[str, object]

    def row(self) -> str:
        lost = 100 * (self.sent - self.received) / self.sent
        keyed = ("key" if self.key else "no key") + (", there first" if self.first else "")
        return (
            f"| {self.kind} | {keyed} | {self.hostile:,} | {self.sent} | {self.received} | {lost:.2f} % "
            f"| {self.uncounted} | {self.ended_s:.1f} | {self.memory_mb:.0f} | {self.files} |"
        )


HEAD = (
    "| hostile datagrams | | sent | scans sent | received | lost | uncounted | ends [s] | memory [MB] | files |\n"
    "|---|---|---|---|---|---|---|---|---|---|"
)


def run(kind: str, seconds: float, folder: Path, *, key: bool, first: bool = False) -> Result:
    """One flight of `seconds` under a flood that begins when the aircraft has been heard for two, or before it (`first`)."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = int(probe.getsockname()[1])
    key_file = folder / "key"
    key_file.write_bytes(bytes(range(32)))
    key_file.chmod(0o600)
    keyed = f'key_file = "{key_file}"\n' if key else ""
    (folder / "ground.toml").write_text(
        f'[link]\nports = ["udpin:{port}"]\nbackfill = "off"\n{keyed}[output]\ndirectory = "{folder}/out"\ndated = false\n'
    )
    command = [sys.executable, "-m", "sideslip", "ground", "ground.toml", "--json", "ground.json"]
    log = (folder / "said.txt").open("w")
    station = subprocess.Popen(command, cwd=folder, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
    context = multiprocessing.get_context("spawn")
    flown: multiprocessing.Queue[tuple[int, int]] = context.Queue()
    flooded: multiprocessing.Queue[int] = context.Queue()
    aircraft_key = key_file if key else None
    aircraft = context.Process(target=fly, args=(port, seconds + AHEAD_S, aircraft_key, folder / "air", flown))
    hostile = context.Process(target=flood, args=(kind, port, seconds, flooded))
    try:
        while "listening" not in (folder / "said.txt").read_text():
            time.sleep(0.1)
        early, late = (hostile, aircraft) if first else (aircraft, hostile)
        early.start()
        time.sleep(AHEAD_S + 2.0)  # a new process takes a while to begin
        late.start()
        sent, _ = flown.get(timeout=seconds + 60)
        memory = _peak_mb(station.pid)
        station.send_signal(signal.SIGTERM)
        at = time.monotonic()
        station.wait(60)
        ended = time.monotonic() - at
        count = flooded.get(timeout=60)
    finally:
        for process in (aircraft, hostile):
            if process.pid is not None:
                process.join(60)
        station.kill()
        station.wait()
        log.close()
    summary = json.loads((folder / "ground.json").read_text())
    genuine = [s for s in summary["sessions"] if (s["system"], s["boot"]) == (1, 7)]
    received = sum(s["scans_received"] for s in genuine)
    known_lost = sum(b - a + 1 for s in genuine for a, b in s["scans_lost"])
    files = sum(1 for _ in (folder / "out").iterdir())
    return Result(kind, key, first, count, sent, received, sent - received - known_lost, ended, memory, files, summary)


def _peak_mb(pid: int) -> float:
    rows = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(row.split()[1]) / 1024 for row in rows if row.startswith("VmHWM"))


def results(seconds: float) -> Iterator[Result]:
    """All kinds without a key; forged scans with one; noise, and other aircraft, that were there before the aircraft."""
    for kind in KINDS:
        with tempfile.TemporaryDirectory() as folder:
            yield run(kind, seconds, Path(folder), key=False)
    with tempfile.TemporaryDirectory() as folder:
        yield run("forged scans of the same aircraft", seconds, Path(folder), key=True)
    for kind in ("60 kB of 0xFD", "18 B of false headers", "scans of 250 other aircraft"):
        with tempfile.TemporaryDirectory() as folder:
            yield run(kind, seconds, Path(folder), key=False, first=True)


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 30.0
    print(HEAD)
    for result in results(seconds):
        print(result.row(), flush=True)
        shown = (
            "frames_lost",
            "frames_damaged",
            "bytes_received",
            "bytes_refused",
            "datagrams_dropped",
            "frames_contested",
        )
        print({k: result.summary[k] for k in shown}, result.summary["doubted"][:3], file=sys.stderr)  # type: ignore[index]


if __name__ == "__main__":
    main()
