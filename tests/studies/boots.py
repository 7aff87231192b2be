"""The logger started as the service starts it, a hundred times, with bus, GNSS and radio there, absent, late or pulled and back.

    python -m tests.studies.boots [BOOTS] [SEED] [AT_ONCE]

The command is `sideslip record --override`; ports are pseudo-terminals behind names that come and go, the bus a file's name with
recorded answers behind it. Each boot must end with status 0 or 130, leave a recording whose counts close, name what was absent at
its start, and hold a part's channels exactly where that part was there long enough. The last result is in docs/logger.md.
"""

import errno
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import chain, cycle
from pathlib import Path

import numpy as np

from daq.contract.recordings.accounting import verify
from daq.contract.recordings.reading import read_recording
from firmware_sim.hardware.registers.ublox import ReceiverFix, UbloxReceiver
from firmware_sim.hardware.serial import PseudoTerminal
from tests.benchmarks.bench_logger import record_answers
from tests.benchmarks.replayed_bus import ReplayedBus
from tests.support.paths import ROOT

SECONDS = 40.0
JOINS_S = 15.0
"""A part that is there for so long without a break must be in the file: looked for once a second, then set up."""
LOOKS_S = tuple(range(15))
"""The radio is looked for after set-up and preflight, 7 s after the bus, later on a busy machine; what is
absent until then must be named."""
PARTS = {"bus": "gyro_x", "gnss": "latitude_e7", "radio": ""}
"""Part -> a channel that it alone measures."""
MADE_OVER = {
    "/var/lib/sideslip/recordings": "{folder}/rec",
    "/dev/i2c-1": "{folder}/bus",
    "/dev/serial0": "{folder}/gnss",
    "serial:/dev/ttyUSB0:57600": "{radio}",
    'calibration = "/etc/sideslip/calibration"': "",
}
"""What of the example configuration is another one here."""

Span = tuple[float, float]


@dataclass(frozen=True)
class Boot:
    """One start: part -> spans [s from when the logger first looks for its bus] in which it is there. port: of the radio."""

    number: int
    spans: Mapping[str, tuple[Span, ...]]
    port: str

    def there(self, part: str, at_s: float) -> bool:
        return any(a <= min(at_s, SECONDS - 1e-3) < b for a, b in self.spans[part])

    def joins(self, part: str, looked_s: float) -> bool:
        """Is it there for long enough after the logger looked for it first, within `SECONDS`?"""
        ends = ((a, b if b < SECONDS else looked_s + SECONDS) for a, b in self.spans[part])
        return any(b - max(a, looked_s) >= JOINS_S for a, b in ends)


def boots(count: int, seed: int) -> Iterator[Boot]:
    """Starts in random orders."""
    rng = np.random.default_rng([44, seed])
    for number in range(count):
        spans = {part: _spans(rng) for part in PARTS}
        ports = ("serial:{folder}/radio:57600", "udp:groundstation.invalid:14550", "udp:127.0.0.1:14599")
        yield Boot(number, spans, ports[rng.choice(3, p=(0.6, 0.2, 0.2))])


def _spans(rng: np.random.Generator) -> tuple[Span, ...]:
    kind = rng.choice(("always", "never", "late", "pulled"), p=(0.35, 0.2, 0.25, 0.2))
    late, pulled, away = rng.uniform(1.0, 20.0), rng.uniform(16.0, 22.0), rng.uniform(0.5, 3.0)
    ways: Mapping[str, tuple[Span, ...]] = {
        "always": ((0.0, SECONDS),),
        "never": (),
        "late": ((late, SECONDS),),
        "pulled": ((0.0, pulled), (pulled + away, SECONDS)),
    }
    return ways[str(kind)]


class Receiver:
    """A u-blox receiver on a table: answers its configuration, sends a fix each period."""

    def __init__(self) -> None:
        self._receiver, self._answers, self._next_ns = UbloxReceiver(), b"", 0

    def receive(self, data: bytes, now_ns: int) -> None:
        self._answers += self._receiver.command(data)

    def bytes_until(self, now_ns: int) -> bytes:
        data, self._answers = self._answers, b""
        if now_ns >= self._next_ns:
            self._next_ns = now_ns + self._receiver.period_ms * 1_000_000
            fix = ReceiverFix(time.time_ns(), 3, 12, 47.0, 8.0, 450.0, (0.0, 0.0, 0.0), 3e-8, 1.0, 1.5, 0.1)
            data += self._receiver.report(fix)
        return data


class Radio:
    """Counts what the logger sends."""

    def __init__(self) -> None:
        self.heard = 0

    def receive(self, data: bytes, now_ns: int) -> None:
        self.heard += len(data)

    def bytes_until(self, now_ns: int) -> bytes:
        return b""


class Bench:
    """The parts of one boot, plugged and pulled by the clock."""

    def __init__(self, boot: Boot, folder: Path) -> None:
        self.boot, self.folder, self.radio = boot, folder, Radio()
        self._talkers = {"gnss": Receiver(), "radio": self.radio}
        self._lines: dict[str, PseudoTerminal] = {}
        self.turn(0.0)

    def turn(self, at_s: float) -> None:
        """What is there at an instant, and the bytes until then."""
        bus = self.folder / "bus"
        (bus.touch if self.boot.there("bus", at_s) else lambda: bus.unlink(missing_ok=True))()
        for part, talker in self._talkers.items():
            there, line, name = self.boot.there(part, at_s), self._lines.get(part), self.folder / part
            if there and line is None:
                self._lines[part] = line = PseudoTerminal(talker)
                name.symlink_to(line.path)
            elif not there and line is not None:
                name.unlink()
                self._lines.pop(part).close()
        for line in self._lines.values():
            line.pump(time.monotonic_ns())


def start(boot: Boot, answers: Path) -> list[str]:
    """One boot; gives what is wrong."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        text = (ROOT / "daq/configs/cdfp.toml").read_text()
        for old, new in MADE_OVER.items():
            text = text.replace(old, new.format(folder=folder, radio=boot.port.format(folder=folder)))
        (folder / "logger.toml").write_text(text)
        bench = Bench(boot, folder)
        command = [sys.executable, "-m", "tests.studies.boots", "record", str(answers), str(folder / "logger.toml")]
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        pipe = subprocess.PIPE
        with subprocess.Popen(
            command, cwd=ROOT, env=environment, stdout=pipe, stderr=subprocess.STDOUT, text=True
        ) as process:
            output: list[str] = []
            reader = threading.Thread(target=lambda: output.append(process.stdout.read()))  # type: ignore[union-attr]
            reader.start()
            while not (folder / "looked").exists() and process.poll() is None:
                bench.turn(0.0)
                time.sleep(0.02)
            begin = time.monotonic()
            while (at_s := time.monotonic() - begin) < SECONDS and process.poll() is None:
                bench.turn(at_s)
                time.sleep(0.02)
            process.send_signal(signal.SIGTERM)  # as systemd does
            process.wait(60.0)
            reader.join()
        return list(_wrong(boot, folder, process.returncode, output[0], bench.radio.heard))


def _wrong(boot: Boot, folder: Path, status: int, output: str, heard: int) -> Iterator[str]:
    if status not in (0, 130):
        yield f"status {status}: {output[-400:]}"
        return
    sessions = sorted(p for p in (folder / "rec").iterdir() if p.is_dir() and not p.name.startswith("."))
    if len(sessions) != 1:
        yield f"{len(sessions)} sessions"
        return
    yield from misheld(boot, sessions[0], output, heard, {part: str(folder / part) for part in PARTS})


def misheld(
    boot: Boot, session: Path, output: str, heard: int, devices: Mapping[str, str], looked_s: float = 0.0
) -> Iterator[str]:
    """What is wrong with a boot's recording. output: what the logger printed; heard: bytes of the radio; devices: part -> its
    name in the configuration; looked_s: when the logger looked for its parts first, on the clock of the spans.
    """
    if not verify(session).ok:
        yield "its counts do not close"
    scans = list(read_recording(session).scans())
    if not scans:
        yield "no scan"
    for part, channel in PARTS.items():
        if part == "radio" and not boot.port.startswith("serial"):
            continue
        has = heard > 0 if part == "radio" else any(channel in s.values for s in scans)
        if boot.joins(part, looked_s) and not has:
            yield f"{part} was there and is not in the file"
        if not boot.spans[part] and has:
            yield f"{part} was never there and is in the file"
        looks = chain(range(int(looked_s)), (looked_s + at_s for at_s in LOOKS_S))
        if not any(boot.there(part, at_s) for at_s in looks) and devices[part] not in output:
            yield f"{part} was absent and is not named"


def record(answers: Path, configuration: Path) -> None:
    """`sideslip record`, with recorded answers behind the bus file."""
    from daq.sensors.open import ReopeningBus
    from sideslip.entry import main

    class FileBus(ReplayedBus):
        def __init__(self, device: str) -> None:
            Path(device).with_name("looked").touch()
            if not Path(device).exists():
                raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), device)
            super().__init__(answers)
            first, later = self._setup, self.scan_answers
            self._next = {
                q: chain(first.get(q, ()), cycle(later.get(q) or first[q])).__next__ for q in {**first, **later}
            }
            self.fd = os.open(device, os.O_RDONLY)
            self._device = Path(device)

        def read_i2c_block_data(self, address: int, register: int, length: int, /) -> list[int]:
            if not self._device.exists():
                raise OSError(errno.EREMOTEIO, "the adapter is gone")
            return super().read_i2c_block_data(address, register, length)

        def close(self) -> None:
            os.close(self.fd)

    ReopeningBus._open = lambda bus: FileBus(bus._device)  # type: ignore[method-assign]
    sys.argv = ["sideslip", "record", str(configuration), "--override", "started by the service"]
    sys.exit(main())


def study(count: int, seed: int, at_once: int) -> None:
    """All boots; prints what was wrong, and the sum."""
    with tempfile.TemporaryDirectory() as name:
        answers = record_answers(Path(name))
        with ThreadPoolExecutor(at_once) as pool:
            outcomes = list(pool.map(lambda boot: (boot, start(boot, answers)), boots(count, seed)))
    for boot, wrong in outcomes:
        if wrong:
            print(
                json.dumps({"boot": boot.number, "spans": boot.spans, "port": boot.port, "wrong": wrong}, default=str)
            )
    print(f"{count} boots, {sum(bool(w) for _, w in outcomes)} with something wrong")


if __name__ == "__main__":
    if sys.argv[1:2] == ["record"]:
        record(Path(sys.argv[2]), Path(sys.argv[3]))
    else:
        numbers = [int(word) for word in sys.argv[1:4]]
        study(*numbers, *(100, 1, 4)[len(numbers) :])
