"""Mutated recordings, flights and telemetry logs by seed, and everything that reads them: shared by the test and the study."""

import random
import struct
import tempfile
import warnings
from collections.abc import Callable, Mapping
from functools import cache
from io import BytesIO
from pathlib import Path

import numpy as np

from daq.contract.recordings.accounting import verify
from daq.contract.recordings.recording import RecordedMessage, RecordingWriter
from daq.contract.recordings.recovery import recover
from daq.contract.recordings.summary import info_mcap
from daq.contract.scan import encode_scan
from daq.contract.seal import SEAL_SIZE, seal
from daq.transport.mavlink_codec import FrameEncoder
from daq.utilities.errors import UserError
from groundstation.calibration.recording import calibrate_recording
from groundstation.flight import Flight, read_flight, write_flight
from groundstation.receiver.tlog import info_tlog
from tests.unit.daq.synthetic import make_info, make_scan, write_recording

Bytes = Callable[[bytes, random.Random], bytes]


def flip(data: bytes, rng: random.Random) -> bytes:
    damaged = bytearray(data)
    for _ in range(rng.choice((1, 1, 3, 30))):
        damaged[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(damaged)


def length(data: bytes, rng: random.Random) -> bytes:
    """A length or number somewhere becomes an extreme one."""
    at, width = rng.randrange(len(data)), rng.choice((1, 2, 4, 8))
    value = rng.choice((0, 1, 2**31, 2**32 - 1, 2**62, 2**64 - 1, len(data), rng.randrange(2**40)))
    return data[:at] + struct.pack("<Q", value)[:width] + data[at + width :]


def cut(data: bytes, rng: random.Random) -> bytes:
    a, b = sorted(rng.randrange(len(data)) for _ in range(2))
    return data[:a] + data[b:] if rng.random() < 0.5 else data[a:b]


def repeat(data: bytes, rng: random.Random) -> bytes:
    a, b = sorted(rng.randrange(len(data)) for _ in range(2))
    return data[:a] + data[a:b] * rng.choice((2, 3, 20)) + data[b:]


def sectors(data: bytes, rng: random.Random) -> bytes:
    size = rng.choice((64, 512, 4096))
    parts = [data[i : i + size] for i in range(0, len(data), size)]
    rng.shuffle(parts)
    return b"".join(parts)


def splice(data: bytes, rng: random.Random) -> bytes:
    other = seeds()[rng.choice(sorted(seeds()))]
    at = rng.randrange(len(data))
    return data[:at] + other[rng.randrange(len(other)) :] + data[at:]


def noise(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data))
    return data[:at] + rng.randbytes(rng.randrange(2000)) + data[at:]


def forged(data: bytes, rng: random.Random) -> bytes:
    """A sound recording of scans whose content was altered before it was sealed: every check holds."""
    stream = BytesIO()
    writer = RecordingWriter(stream, make_info(rng.choice(("s1", "", "x" * 200))), compress=rng.random() < 0.5)
    for n in range(30):
        content = MUTATIONS[rng.choice(("flip", "length", "cut"))](encode_scan(make_scan(n))[:-SEAL_SIZE], rng)
        number, time = (rng.choice((n, 0, 2**32 - 1)), rng.choice((n, 0, 2**64 - 1)))
        writer.write(RecordedMessage("/scan", time, time, number, seal("sideslip.Scan", content)))
    writer.finish()
    return stream.getvalue()


MUTATIONS: Mapping[str, Bytes] = {f.__name__: f for f in (flip, length, cut, repeat, sectors, splice, noise, forged)}


@cache
def seeds() -> Mapping[str, bytes]:
    """Sound files to start from: ending -> bytes, by name."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_recording(folder / "plain.mcap", scans=40)
        write_recording(folder / "zstd.mcap", scans=40, compress=True)
        time = np.arange(60) / 20
        flight = Flight.build("f", time, {"p": np.sin(time), "alpha": np.where(time > 1, np.nan, 0.1)})
        for ending in ("mcap", "csv", "parquet"):
            write_flight(flight, folder / f"flight.{ending}")
        encoder = FrameEncoder(1, 1)
        stamps = (1_790_000_000_000_000 + i * 50_000 for i in range(60))
        frames = b"".join(struct.pack(">Q", t) + encoder.message("HEARTBEAT", type=1) for t in stamps)
        (folder / "link.tlog").write_bytes(frames)
        return {p.name: p.read_bytes() for p in sorted(folder.iterdir())}


def mutated(seed: int) -> tuple[str, bytes]:
    """Ending and bytes of one case."""
    rng = random.Random(seed)
    name = rng.choice(sorted(seeds()))
    data = seeds()[name]
    for _ in range(rng.choice((1, 1, 2, 4))):
        if data:
            data = MUTATIONS[rng.choice(sorted(MUTATIONS))](data, rng)
    return Path(name).suffix, data


def answered(path: Path) -> list[str]:
    """What every reader said of a file: a word, or the sentence of its error. Anything but a UserError passes through."""
    recovered = path.with_name("recovered.mcap")
    recovered.unlink(missing_ok=True)
    readers: tuple[Callable[[], object], ...] = (
        lambda: verify(path).to_dict(),
        lambda: info_tlog(path) if path.suffix == ".tlog" else info_mcap(path),
        lambda: recover(path, recovered).to_dict(),
        lambda: calibrate_recording(path, "cdfp", salvage=True),
        lambda: read_flight(path),
    )
    said = []
    for reader in readers:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RuntimeWarning)  # made-up counts are no atmosphere
                reader()
            said.append("read")
        except UserError as error:
            said.append(str(error))
    return said
