"""What a power cut has left of a session, held against what was really scanned."""

from dataclasses import dataclass
from pathlib import Path

from daq.contract.recordings.accounting import verify
from daq.contract.recordings.reading import read_recording
from daq.contract.recordings.recording import RecordingError
from daq.contract.recordings.recovery import recover
from daq.utilities.ranges import count


@dataclass(frozen=True, slots=True)
class Left:
    """What was found. lost: scans taken that are not there. wrong: what would mislead somebody, in words; empty if nothing."""

    taken: int
    lost: int
    wrong: tuple[str, ...]


def judge(directory: Path, truth: dict[int, bytes], taken: int, out: Path) -> Left:
    """Verify and recover the session in a directory and compare with the truth, scan by scan, byte by byte.

    taken: scans made until the cut. out: a name for the recovered recording. A session of which nothing is left is no
    fault of its own: all its scans are lost, and it says so.
    """
    try:
        found = verify(directory)
        recording = read_recording(directory, salvage=True)
    except RecordingError:
        return Left(taken, taken, ())
    wrong = []
    scans = {e.sequence: e.data for e in recording.entries if e.topic == "/scan"}
    if any(truth.get(n) != data for n, data in scans.items()):
        wrong.append("a scan in it was never taken like that")
    lost = len(set(range(taken)) - set(scans))
    if found.ok and lost:
        wrong.append(f"'{found.text}', but {lost} scans are lost")
    if found.slots != found.scans + count(found.missing) or found.scans != len(scans):
        wrong.append(f"the sums do not close: {found.slots} slots, {found.scans} scans, {found.missing} missing")
    if found.slots != found.written + found.dropped + found.lost + found.missed:
        wrong.append(f"the books do not close: {found}")
    if scans:
        saved = recover(directory, out)
        again = read_recording(out)
        if saved.recovered != len(scans) or again.numbers != sorted(scans) or not verify(out).ok:
            wrong.append(f"recovery gave {saved.recovered} of {len(scans)} scans")
    return Left(taken, lost, tuple(wrong))
