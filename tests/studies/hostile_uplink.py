"""Somebody sends to the logger's radio port as fast as loopback goes: which slots does that cost, is each of them counted,
and does SIGTERM still end the process?

Run: python -m tests.studies.hostile_uplink [SECONDS] [--realtime] [KIND ...]. The last result is kept in docs/link.md.
With --realtime the logger runs at `realtime_priority = 50`: where others use the machine too, what is seen is then the
sender's doing.

The logger is the service of the benchmark: all sensors of the example configuration on a replayed bus whose transfers take
as long as at 400 kHz, recorder, downlink, and a listening UDP port without a key. Slots are counted here, from outside, by the
clock: those the logger ought to have had between its first scan and SIGTERM are compared with what its books say and with
what is in its files.
"""

import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from daq.contract.recordings.accounting import verify
from daq.contract.recordings.reading import read_recording
from tests.benchmarks.bench_logger import ROOT, bench_config, record_answers
from tests.support.hostile_sender import KINDS

RATE_HZ = 20.0
TRANSFER_US = 130.0
"""45 transfers take 5.84 ms of wire time at 400 kHz."""
LISTED_FILES = 2000  # recordings that are there already, to be listed


@dataclass(frozen=True)
class Row:
    """One run."""

    kind: str
    sent: int  # datagrams
    sent_mb: float
    seconds: float
    sessions: int
    written: int
    missed: int
    between: int  # slots between a recording's end and the next one's beginning, as commanded
    uncounted: int  # slots by the clock, less all of these; one more or less is a matter of rounding
    late: int
    end_s: float
    sound: bool

    @property
    def share(self) -> float:
        """Slots lost that should have been recorded [%]."""
        return 100 * (1 - self.written / (self.written + self.missed + max(0, self.uncounted)))


def free_udp_port() -> int:
    """A UDP port of the loopback that nobody uses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def run(folder: Path, answers: Path, kind: str, seconds: float, *, aside: bool = False, realtime: bool = False) -> Row:
    """Run the logger, flooded with a kind (none where it is empty) for a time, then end it with SIGTERM.

    aside: the flood goes to a port of nobody's, so that only what it takes of the machine is felt.
    """
    folder.mkdir()
    config = bench_config(folder)
    if realtime:
        config.write_text(config.read_text().replace("realtime_priority = 0 ", "realtime_priority = 50 "))
    _older_recordings(folder / "recordings")
    number = free_udp_port()
    arguments = [str(config), str(answers), str(seconds + 60), f"udpin:{number}", str(TRANSFER_US)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "NOTIFY_SOCKET": str(folder / "notify")}
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(folder / "notify"))
        systemd.settimeout(60)
        command = [sys.executable, str(ROOT / "tests/benchmarks/logger_process.py"), *arguments]
        with (
            (folder / "stderr").open("w") as said,
            subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=said, text=True) as logger,
        ):
            assert systemd.recv(1000).startswith(b"READY=1")
            target = free_udp_port() if aside else number
            sender = _flood(target, kind, seconds + 30, environment) if kind else None
            time.sleep(seconds)
            asked_ns = time.monotonic_ns()
            logger.send_signal(signal.SIGTERM)
            result, _ = logger.communicate(timeout=120)
            ended_ns = time.monotonic_ns()
    sent = _stop(sender) if sender is not None else {"datagrams": 0, "bytes": 0}
    name = f"{kind}, to another port" if aside else kind or "nothing"
    return _row(folder, name, sent, asked_ns, ended_ns, json.loads(result))


def _older_recordings(folder: Path) -> None:
    for n in range(LISTED_FILES):
        path = folder / f"older_{n // 100:03d}" / f"older_{n:05d}.mcap"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(bytes(100))


def _flood(number: int, kind: str, seconds: float, environment: dict[str, str]) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "tests.support.hostile_sender", str(number), kind, str(seconds)]
    return subprocess.Popen(command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True)


def _stop(sender: "subprocess.Popen[str]") -> dict[str, int]:
    """End the flood; what it sent, if it was at its end by itself."""
    sender.send_signal(signal.SIGINT)
    said, _ = sender.communicate()
    counts: dict[str, int] = json.loads(said)
    return counts


def _row(folder: Path, kind: str, sent: dict[str, int], asked_ns: int, ended_ns: int, result: dict[str, object]) -> Row:
    sessions = [p for p in (folder / "recordings").iterdir() if not p.name.startswith("older_")]
    recordings = [read_recording(s) for s in sessions]
    first_ns = min(s.time_monotonic_ns for r in recordings for s in r.scans())
    written = sum(len(r.numbers) for r in recordings)
    spans = sorted((b.first_number, b.next_number) for b in (r.statistics[-1] for r in recordings))
    between = sum(b[0] - a[1] for a, b in pairwise(spans))
    checks = [verify(s) for s in sessions]
    missed = sum(c.missed for c in checks)
    by_clock = int((asked_ns - first_ns) * 1e-9 * RATE_HZ) + 1
    late = int(str(result["later_than_5_ms"]))
    return Row(
        kind,
        sent["datagrams"],
        sent["bytes"] / 1e6,
        (asked_ns - first_ns) * 1e-9,
        len(sessions),
        written,
        missed,
        between,
        by_clock - written - missed - between,
        late,
        (ended_ns - asked_ns) * 1e-9,
        all(c.ok for c in checks) and bool(result["closes"]),
    )


def table(rows: list[Row]) -> str:
    """The result as it stands in docs/link.md."""
    head = ("what is sent", "datagrams/s", "MB/s", "slots", "written", "missed", "not recording", "uncounted", "lost")
    head += ("later than 5 ms", "recordings", "end [s]", "sound")
    cells = [
        (
            r.kind,
            f"{r.sent / r.seconds:,.0f}",
            f"{r.sent_mb / r.seconds:.1f}",
            *(str(n) for n in (r.written + r.missed + r.between, r.written, r.missed, r.between, r.uncounted)),
            f"{r.share:.2f} %",
            str(r.late),
            str(r.sessions),
            f"{r.end_s:.1f}",
            "yes" if r.sound else "NO",
        )
        for r in rows
    ]
    lines = ["| " + " | ".join(row) + " |" for row in (head, *cells)]
    lines.insert(1, "|---" * len(head) + "|")
    return "\n".join(lines)


def main(seconds: float, kinds: list[str], *, realtime: bool) -> None:
    """All kinds, each in a run of its own, one run without, and one with the flood going elsewhere."""
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        answers = record_answers(folder)
        for i, (kind, aside) in enumerate([("", False), ("all", True), *((k, False) for k in kinds or KINDS)]):
            rows.append(run(folder / f"run{i}", answers, kind, seconds, aside=aside, realtime=realtime))
            print(table(rows[-1:]).splitlines()[-1], flush=True)
    print(table(rows))


if __name__ == "__main__":
    wanted = [a for a in sys.argv[1:] if a != "--realtime"]
    main(float(wanted[0]) if wanted else 30.0, wanted[1:], realtime="--realtime" in sys.argv)
