"""What is on the card after the plug was pulled, held against what the chips have given away."""

import hashlib
import shutil
import struct
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from daq.contract.recordings.accounting import verify
from daq.contract.recordings.reading import read_recording
from daq.contract.recordings.recording import RecordingError
from daq.contract.recordings.recovery import recover
from daq.contract.scan import SensorState
from daq.utilities.ranges import count

_BURST = ("accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z", "imu_temperature")


@dataclass(frozen=True, slots=True)
class Session:
    """A session as it lies on the card.

    last_s: when the IMU was read for its last scan [s, monotonic]. readings_lost: how often it was after that. wrong: what would
    mislead somebody, in words; empty if nothing.
    """

    name: str
    ok: bool
    text: str
    scans: int
    missing: int
    last_s: float | None
    readings_lost: int
    wrong: tuple[str, ...]


@contextmanager
def mounted(card: Path) -> Iterator[Path]:
    """A copy of the card as the next start finds it: its journal replayed by this machine's kernel."""
    copy, at = card.with_suffix(".copy"), card.with_suffix(".mnt")
    at.mkdir(exist_ok=True)
    subprocess.run(["cp", "--sparse=always", str(card), str(copy)], check=True)
    subprocess.run(["mount", "-o", "loop,noatime", str(copy), str(at)], check=True)
    try:
        yield at
    finally:
        subprocess.run(["umount", str(at)], check=True)
        copy.unlink()


def sessions(root: Path) -> dict[str, str]:
    """Name -> digest of all files of each session below `root`."""
    found = {}
    for folder in sorted((root / "recordings").glob("*/")):
        digest = hashlib.sha256()
        for file in sorted(folder.iterdir()):
            digest.update(file.name.encode() + file.read_bytes())
        found[folder.name] = digest.hexdigest()
    return found


def judge(folder: Path, readings: Mapping[bytes, float], ended_s: float | None) -> Session:
    """Verify, recover and compare one session. readings: see `Bench`; ended_s: when the plug was pulled, on the same clock;
    None for a session after which there was another, of which nothing is said to be lost.
    """
    name = folder.name
    try:
        found = verify(folder)
        recording = read_recording(folder, salvage=True)
    except RecordingError as error:
        return Session(name, False, str(error), 0, 0, None, 0, ())
    wrong = []
    last_s: float | None = None
    for scan in recording.scans():
        imu = scan.groups.get("imu")  # none where the bus was so slow that the reading ended in the next scan
        if imu is None or imu.state not in (SensorState.OK, SensorState.RECOVERING):
            continue
        at = readings.get(struct.pack(">7h", *(int(scan.values[c]) for c in _BURST)))
        if at is None:
            wrong.append(f"scan {scan.number} was never read from the IMU like that")
        elif last_s is not None and at < last_s:
            wrong.append(f"scan {scan.number} is older than the one before")
        else:
            last_s = at
    lost = 0
    if last_s is not None and ended_s is not None:
        lost = sum(1 for at in readings.values() if last_s < at <= ended_s)
    if found.slots != found.scans + count(found.missing):
        wrong.append(f"the sums do not close: {found.slots} slots, {found.scans} scans, {found.missing} missing")
    if found.slots != found.written + found.dropped + found.lost + found.missed:
        wrong.append(f"the books do not close: {found.text}")
    if found.ok and lost > 1:  # the one under way was never a scan
        wrong.append(f"'{found.text}', but {lost} readings are lost")
    if found.scans:
        wrong += _recovered(folder, recording.numbers)
    return Session(name, found.ok, found.text, found.scans, count(found.missing), last_s, lost, tuple(wrong))


def _recovered(folder: Path, numbers: list[int]) -> list[str]:
    out = folder.parents[1] / "recovered.mcap"
    out.unlink(missing_ok=True)
    saved = recover(folder, out)
    again = read_recording(out)
    ok = saved.recovered == len(numbers) and again.numbers == numbers and verify(out).ok
    out.unlink()
    return [] if ok else [f"recovery gave {saved.recovered} of {len(numbers)} scans"]


def keep(folder: Path, out: Path) -> Path:
    """A copy of a session, to be looked at when the card is gone."""
    shutil.rmtree(out, ignore_errors=True)
    return Path(shutil.copytree(folder, out))
