"""The ground station as a person starts it, for an hour of the clock: a recording flown over and over on a real port, the live
view on; what its memory does after a warm-up, and whether its sums close.

Run: python -m tests.torture.process_soak [SECONDS [PICTURE]]. PICTURE is the room of the view ("64MiB" as it comes, or "none" for
no view): a small one is full before the warm-up ends, and what grows afterwards is not the picture. The last result is kept in
docs/threat-model.md."""

import json
import multiprocessing
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from socket import SOCK_STREAM

from daq.clock import RealClock
from daq.contract.recordings.reading import read_recording
from daq.contract.recordings.recording import RecordingInfo
from daq.telemetry.config import DownlinkConfig
from daq.telemetry.link import radio_link
from daq.transport.ports import UdpPort
from tests.support.aircraft_process import numbered
from tests.support.free_ports import free_port
from tests.support.link_rig import FakeLogger
from tests.support.paths import ROOT

PERIOD_S = 0.05
WARM_S = 600.0
LOOK_S = 30.0
SILENT_S = 5.0  # at the end, in which the aircraft answers only
RECORDING = ROOT / "recordings" / "cdfp_ld4_raw.mcap"


@dataclass(frozen=True)
class HourOfGround:
    """memory: (seconds since the start, resident bytes). sent, received, lost: scans. status: of the ground station."""

    memory: list[tuple[float, int]]
    sent: int
    received: int
    lost: int
    status: int
    words: str

    @property
    def grown(self) -> int:
        """Bytes: the mean of the last tenth less that of the first tenth after the warm-up."""
        warm = [size for seconds, size in self.memory if seconds >= min(WARM_S, self.memory[-1][0] / 4)]
        tenth = max(1, len(warm) // 10)
        return round(sum(warm[-tenth:]) / tenth - sum(warm[:tenth]) / tenth)


def fly_recorded(port: int, seconds: float, sent: "multiprocessing.Queue[int]") -> None:
    """The aircraft's process: 20 scans a second through the real downlink, then it answers for a while."""
    source, clock = read_recording(RECORDING), RealClock()
    pool = list(source.scans())
    wire = UdpPort(remote=("127.0.0.1", port))
    info = RecordingInfo("flight1", "simulated", "cdfp", details=source.info.details)
    link = radio_link(DownlinkConfig(budget_bytes_per_s=20_000), wire, clock, papers=lambda: info, boot=7)
    logger, begun, number = FakeLogger(), time.monotonic(), 0
    while (past := time.monotonic() - begun) < seconds + SILENT_S:
        now = clock.monotonic_ns()
        if past < seconds:
            link.offer(numbered(pool[number % len(pool)], number, now))
            number += 1
        link.service(now)
        link.uplink.service(now, logger)
        time.sleep(max(0.0, PERIOD_S - (time.monotonic() - begun) % PERIOD_S))
    sent.put(len(link.downlink.sent))
    link.close()
    wire.close()


def hour_of_ground(seconds: float, picture: str = "64MiB") -> HourOfGround:
    """Fly for so long, end it by SIGTERM, read what it says of itself. picture: room of the view, or none."""
    with tempfile.TemporaryDirectory() as name:
        folder, port = Path(name), free_port()
        (folder / "g.toml").write_text(
            f'[link]\nports = ["udpin:127.0.0.1:{port}"]\n'
            f'[view]\nmemory_limit = "{"64MiB" if picture == "none" else picture}"\n'
            f"port = {free_port(SOCK_STREAM)}\nweb_port = {free_port(SOCK_STREAM)}\n[identification]\naircraft = 'cdfp'\n"
        )
        view = ["--view", "none" if picture == "none" else "web"]
        command = [sys.executable, "-m", "sideslip", "ground", "g.toml", "--out", "s", *view, "--json", "g.json"]
        context = multiprocessing.get_context("spawn")
        flown: multiprocessing.Queue[int] = context.Queue()
        aircraft = context.Process(target=fly_recorded, args=(port, seconds, flown))
        with (folder / "said").open("wb") as said:
            station = subprocess.Popen(command, cwd=folder, stdin=subprocess.DEVNULL, stdout=said, stderr=said)
            try:
                while b"listening" not in (folder / "said").read_bytes() and station.poll() is None:
                    time.sleep(0.2)
                aircraft.start()
                memory = _watched(station, seconds)
                sent = flown.get(timeout=60.0)
                station.send_signal(signal.SIGTERM)
                status = station.wait(120.0)
            finally:
                station.kill()
                aircraft.kill()
        summary = json.loads((folder / "g.json").read_text())
        lost = sum(b - a + 1 for a, b in summary["scans_lost"])
        return HourOfGround(
            memory, sent, summary["scans_received"], lost, status, (folder / "said").read_text("utf-8", "replace")
        )


def _watched(station: "subprocess.Popen[bytes]", seconds: float) -> list[tuple[float, int]]:
    begun, memory = time.monotonic(), []
    while (past := time.monotonic() - begun) < seconds:
        if station.poll() is not None:
            raise RuntimeError(f"the ground station ended by itself after {past:.0f} s with {station.returncode}")
        rows = Path(f"/proc/{station.pid}/status").read_text().splitlines()
        memory.append((past, 1024 * next(int(row.split()[1]) for row in rows if row.startswith("VmRSS"))))
        print(f"{past:7.0f} s {memory[-1][1] / 1e6:8.1f} MB", flush=True)
        time.sleep(min(LOOK_S, max(0.0, seconds - past)) + 0.01)
    return memory


def main() -> int:
    end = hour_of_ground(float(sys.argv[1]) if len(sys.argv) > 1 else WARM_S + 3600.0, *sys.argv[2:3])
    print(
        f"status {end.status}, {end.sent} scans sent, {end.received} received, {end.lost} lost, grown {end.grown / 1e6:+.1f} MB"
    )
    print(end.words[-600:])
    return 1 if end.status not in (0, 130) or end.received < end.sent or end.lost or "Traceback" in end.words else 0


if __name__ == "__main__":
    sys.exit(main())
