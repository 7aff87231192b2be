"""Damages of a simulated flight's recording: what `recover` saves. Run: python -m tests.studies.damaged_recordings

The oracle is the file itself: a scan is intact when its bytes, as recorded, are still somewhere in the damaged file.
"""

import random
import struct
import tempfile
from collections.abc import Callable
from pathlib import Path

from daq.contract.recordings.accounting import verify
from daq.contract.recordings.reading import read_recording
from daq.contract.recordings.recording import RecordingError
from daq.contract.recordings.segments import read_parts
from firmware_sim.runs.flight import prepare_flight
from firmware_sim.world.scenario import load_scenario


def cut(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.randrange(1, len(data))]


def flip(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data))
    return data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :]


def zero_tail(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data))
    return data[:at] + bytes(len(data) - at)


def garble_sector(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data)) // 4096 * 4096
    return data[:at] + rng.randbytes(len(data[at : at + 4096])) + data[at + 4096 :]


def alter_code(data: bytes, rng: random.Random) -> bytes:
    """The code of a chunk becomes that of another record."""
    found, at = [], 8
    while at < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, at)
        found += [at] if opcode == 6 else []
        at += 9 + length
    at = rng.choice(found)
    return data[:at] + bytes([rng.choice((1, 2, 3, 4, 5, *range(7, 16)))]) + data[at + 1 :]


def reverse_sectors(data: bytes, rng: random.Random) -> bytes:
    size = rng.choice((512, 4096))
    skip = rng.randrange(size)
    parts = [data[:skip], *(data[at : at + size] for at in range(skip, len(data), size))]
    return b"".join(reversed(parts))


DAMAGES: tuple[Callable[[bytes, random.Random], bytes], ...] = (
    cut,
    flip,
    zero_tail,
    garble_sector,
    alter_code,
    reverse_sectors,
)


def main(files_each: int = 50) -> None:
    """Print one row of the table for each kind of damage."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare_flight(load_scenario("nominal"), folder / "flight", duration_s=60).run()
        original = next((folder / "flight/onboard").glob("*.mcap"))
        data = original.read_bytes()
        truth = {e.sequence: e.data for e in read_recording(original).entries if e.topic == "/scan"}
        print("| damage | files | intact scans | recovered | altered | damage unnoticed | sums that do not close |")
        print("|---|---|---|---|---|---|---|")
        for damage in DAMAGES:
            row = _row(damage, data, truth, folder / "x_000.mcap", files_each)
            print(f"| {damage.__name__} | {files_each} | " + " | ".join(map(str, row)) + " |")


def _row(
    damage: Callable[[bytes, random.Random], bytes], data: bytes, truth: dict[int, bytes], path: Path, files: int
) -> tuple[int, int, int, int, int]:
    rng = random.Random(damage.__name__)
    intact = recovered = altered = unnoticed = open_sums = 0
    for _ in range(files):
        damaged = damage(data, rng)
        path.write_bytes(damaged)
        intact += sum(1 for d in truth.values() if d in damaged)
        try:
            (segment,) = read_parts(path)
            result = verify(path)
        except RecordingError:
            continue
        got = {e.sequence: e.data for e in segment.entries if e.topic == "/scan"}
        recovered += len(got)
        altered += sum(1 for n, d in got.items() if truth[n] != d)
        unnoticed += segment.sound
        closes = result.slots == result.scans + sum(b - a + 1 for a, b in result.missing)
        open_sums += not (closes and result.slots == result.written + result.dropped + result.lost + result.missed)
    return intact, recovered, altered, unnoticed, open_sums


if __name__ == "__main__":
    main()
