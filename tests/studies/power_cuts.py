"""Power cuts by the hundred, and what other ways of syncing would lose and write. Run: python -m tests.studies.power_cuts

The cuts need FUSE; what reaches the medium is counted on an ext4 image behind a loop device, which needs root.
"""

import os
import random
import statistics
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from daq.recorder.storage import RealFile, StorageFile
from tests.chain.card.cuts import Case, cut_flight, next_session
from tests.chain.card.flight import SLOW, SOUND, CardFlight, Slowness
from tests.chain.card.forgetting import CUTS
from tests.chain.card.mounted import mounted

_COUNTED_S = 120.0  # of flight, for bytes; one file of the default length
_SECTOR = 512


def cuts(instants: int, seed: int, slowness: Slowness, folder: Path) -> list[Case]:
    """Cut flights at random instants, ten to a flight, in all ways."""
    rng = random.Random(seed)
    found: list[Case] = []
    for flight in range(-(-instants // 10)):
        at = [rng.uniform(0.2, 14.0) for _ in range(min(10, instants - 10 * flight))]
        with mounted(folder / f"card{flight}") as card:
            found += cut_flight(
                card,
                folder / f"cuts{flight}",
                at,
                slowness=slowness,
                recorder={"segment_s": rng.choice([3.0, 5.0, 120.0])},
            )
    return found


def cut_table(instants: int = 30, seed: int = 1) -> None:
    """One row for each way of cutting, on the slow card; every tenth is followed by another session."""
    with tempfile.TemporaryDirectory() as name:
        found = cuts(instants, seed, SLOW, Path(name))
        print(
            "| kept of the unsynced | cuts | scans lost, mean | worst | wrong without saying so | next session starts |"
        )
        print("|---|---|---|---|---|---|")
        for cut in CUTS:
            here = [c for c in found if c.cut == cut]
            lost = [c.left.lost for c in here]
            wrong = sum(bool(c.left.wrong) for c in here)
            tried = here[::10]
            starts = sum(not next_session(c.directory) for c in tried)
            row = (cut.name, len(here), f"{statistics.mean(lost):.1f}", max(lost), wrong, f"{starts} of {len(tried)}")
            print("| " + " | ".join(map(str, row)) + " |", flush=True)


# --------------------------------------------------------------------------------------------- ways to write and sync


class Fsync(RealFile):
    """fsync in place of fdatasync."""

    def sync(self) -> None:
        os.fsync(self._descriptor)
        super().sync()


class Reserved(RealFile):
    """Room taken in advance with fallocate and given back at the end: the size does not change with every sync."""

    room = 1 << 20

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        os.posix_fallocate(self._descriptor, 0, self.room)

    def close(self) -> None:
        os.ftruncate(self._descriptor, self._at)
        super().close()


class Zeroed(Reserved):
    """The same room, filled with zeros and synced, so that later syncs move data only."""

    def __init__(self, path: Path) -> None:
        RealFile.__init__(self, path)
        os.pwrite(self._descriptor, bytes(self.room), 0)
        os.fsync(self._descriptor)


@dataclass(frozen=True, slots=True)
class Way:
    """A way to write and sync."""

    name: str
    flush_s: float
    sync_s: float
    make: Callable[[Path], StorageFile] = RealFile
    sync: bool = True

    def recorder(self, segment_s: float) -> dict[str, object]:
        """`[recorder]` for it."""
        return {"flush_s": self.flush_s, "sync_s": self.sync_s, "sync": self.sync, "segment_s": segment_s}


WAYS = (
    Way("no sync at all", 0.5, 0.5, sync=False),
    Way("fdatasync every 1 s", 0.5, 1.0),
    Way("fdatasync every 0.5 s (chosen)", 0.5, 0.5),
    Way("fdatasync every 0.25 s, chunks of 0.25 s", 0.25, 0.25),
    Way("fsync every 0.5 s", 0.5, 0.5, Fsync),
    Way("fdatasync every 0.5 s, room by fallocate", 0.5, 0.5, Reserved),
    Way("fdatasync every 0.5 s, room filled with zeros", 0.5, 0.5, Zeroed),
)


def lost(way: Way, slowness: Slowness, folder: Path, instants: int = 120) -> list[int]:
    """Scans lost at instants close together, when nothing unsynced survives."""
    with mounted(folder / "card") as card:
        at = [3.0 + 0.0931 * i for i in range(instants)]
        found = cut_flight(
            card, folder / "cuts", at, slowness=slowness, recorder=way.recorder(5.0), cuts=CUTS[:1], make=way.make
        )
    return [c.left.lost for c in found]


@contextmanager
def ext4(folder: Path) -> Iterator[tuple[Path, Callable[[], int]]]:
    """An ext4 file system as on the aircraft, and a function that gives the bytes written to its device so far."""
    image, place = folder / "image", folder / "ext4"
    place.mkdir()
    with image.open("wb") as file:
        file.truncate(256 << 20)
    subprocess.run(["mkfs.ext4", "-q", "-E", "lazy_itable_init=0,lazy_journal_init=0", str(image)], check=True)
    loop = subprocess.run(
        ["losetup", "--find", "--show", str(image)], check=True, capture_output=True, text=True
    ).stdout.strip()
    try:
        subprocess.run(["mount", "-o", "noatime", loop, str(place)], check=True)
        state = Path("/sys/block") / Path(loop).name / "stat"
        yield place, lambda: int(state.read_text().split()[6]) * _SECTOR
    finally:
        subprocess.run(["umount", str(place)], check=False)
        subprocess.run(["losetup", "-d", loop], check=False)


def written(way: Way, folder: Path, seconds: float = _COUNTED_S) -> tuple[float, float, int]:
    """(MB on the medium, MB of the recording, syncs) for an hour of flight."""
    with ext4(folder) as (place, so_far):
        os.sync()
        begun = so_far()
        flight = CardFlight(place / "flight", recorder=way.recorder(120.0), make=way.make)
        flight.fly(seconds)
        size = sum(p.stat().st_size for p in flight.directory.glob("*.mcap"))
        os.sync()
        hours = flight.taken / 20 / 3600
        return (so_far() - begun) / 1e6 / hours, size / 1e6 / hours, round(len(flight.storage.syncs_s) / hours)


def way_table() -> None:
    """One row for each way of syncing."""
    print(
        "| way | scans lost on a sound card, mean / worst | at 0.2 s a sync | syncs an hour | MB an hour to the card |"
    )
    print("|---|---|---|---|---|")
    for way in WAYS:
        cells = []
        for slowness in (SOUND, SLOW):
            with tempfile.TemporaryDirectory() as name:
                found = lost(way, slowness, Path(name))
            cells.append(f"{statistics.mean(found):.1f} / {max(found)}")
        with tempfile.TemporaryDirectory() as name:
            medium, _, syncs = written(way, Path(name))
        print(f"| {way.name} | " + " | ".join([*cells, str(syncs), f"{medium:.0f}"]) + " |", flush=True)


if __name__ == "__main__":
    cut_table()
    way_table()
