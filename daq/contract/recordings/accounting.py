"""Does a recording hold every scan it should?

Accounting: scan numbers run from the first to the last slot the logger used. Each number is present, or the logger
itself said that it is absent (dropped, lost, or missed), or it lies in a damaged stretch or after the last flush.
`slots = scans + sum of missing` always holds; a missing number that nobody accounts for makes the verdict "not ok".
Several sessions in one file are accounted for one by one.
"""

import json
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from daq.contract.recordings.messages import Statistics
from daq.contract.recordings.reading import Recording, by_session, join
from daq.contract.recordings.salvage import Damage
from daq.contract.recordings.segments import RecordingWalk, read_segments
from daq.utilities.ranges import Range, count, ranges, shown, subtract

LOST_TO_DAMAGE = "lost_to_damage"


COUNTS = ("scans", "written", "dropped", "lost", "missed", "slots")


@dataclass(frozen=True)
class Verification:
    """What `verify` found. Ranges are inclusive (first, last) scan numbers.

    scans: present and proven. written, dropped, lost, missed: as the logger counted them, or as they follow from the
    numbers where its last count is older than the last scan. missing: absent numbers. unexplained: the part of
    `missing` that the logger did not report as absent itself. given_up: segments that the logger left after a write
    error and continued in another file; their torn ends are no damage of the recording. sessions: of a file that holds
    several, what was found of each by name; the numbers are then sums, and the ranges those of one session after the other.
    """

    ok: bool
    scans: int
    slots: int
    written: int
    dropped: int
    lost: int
    missed: int
    missing: tuple[Range, ...]
    unexplained: tuple[Range, ...]
    damages: tuple[tuple[Path, Damage], ...]
    closed: bool
    text: str
    given_up: tuple[Path, ...] = ()
    sessions: tuple[tuple[str, "Verification"], ...] = ()

    def to_dict(self) -> dict[str, Any]:
        several_files = len({p for p, _ in self.damages}) > 1
        return {
            "ok": self.ok,
            **{n: getattr(self, n) for n in COUNTS},
            "missing": [list(r) for r in self.missing],
            "unexplained": [list(r) for r in self.unexplained],
            "damaged": [
                {"at_byte": d.at_byte, "what": d.what, "length": d.length} | ({"file": str(p)} if several_files else {})
                for p, d in self.damages
            ],
            "closed": self.closed,
            "given_up": [str(p) for p in self.given_up],
            "text": self.text,
            **({"sessions": [{"session": n, **v.to_dict()} for n, v in self.sessions]} if self.sessions else {}),
        }


def verify(path: str | Path) -> Verification:
    """Check a recording, file or directory: every byte, every scan, every number.

    Raises RecordingError when there is no recording to check.
    """
    return verify_segments(Path(path), read_segments(path))


def verify_segments(path: Path, segments: list[RecordingWalk]) -> Verification:
    """`verify` of segments that have been walked through already."""
    groups = [segments] if path.is_dir() or len(segments) == 1 else list(by_session(segments).values())
    verifications = [_verify_group(path, g) for g in groups]
    return verifications[0][1] if len(verifications) == 1 else _summed(verifications)


def _verify_group(path: Path, segments: list[RecordingWalk]) -> tuple[str, Verification]:
    if all(s.info is None and not s.entries and (s.foreign or s.metadata) for s in segments):
        return "no recording", _verify_foreign(segments)
    recording = join(path, segments)
    return recording.info.session, verify_recording(recording)


def _summed(verifications: Sequence[tuple[str, Verification]]) -> Verification:
    """The sessions of one file: sums, and each for itself."""
    parts = [v for _, v in verifications]
    texts = "; ".join(f"session {name}: {v.text}" for name, v in verifications)
    ranges_and_files = ("missing", "unexplained", "damages", "given_up")
    fields: dict[str, Any] = {n: tuple(r for v in parts for r in getattr(v, n)) for n in ranges_and_files}
    return Verification(
        ok=all(v.ok for v in parts),
        **{n: sum(getattr(v, n) for v in parts) for n in COUNTS},
        **fields,
        closed=all(v.closed for v in parts),
        text=f"{len(verifications)} sessions in one file; {texts}",
        sessions=tuple(verifications),
    )


def verify_recording(recording: Recording) -> Verification:
    """Check a recording that has been walked through."""
    numbers = recording.numbers
    statistics = recording.last_statistics
    first, end = _span(numbers, statistics, {s.info.segment for s in recording.segments if s.info})
    missing = subtract([(first, end - 1)], ranges(numbers))
    unreported = subtract(missing, statistics.absent if statistics else ())
    unexplained = subtract(unreported, _lost_before(recording.info.details.get(LOST_TO_DAMAGE, "[]")))
    given_up, damages = recording.given_up, recording.damages
    role = recording.info.role
    # a session's directory may end with a file closed in order after which the logger had begun, or meant, another
    goes_on = recording.path.is_dir() and role == "onboard" and statistics is not None and not statistics.final
    closed = all(s.closed or any(s is g for g in given_up) for s in recording.segments) and not goes_on
    gaps_expected = role == "received"
    ok = closed and not damages and bool(numbers) and (gaps_expected or not unexplained)
    dropped, lost, missed = _counts(statistics, count(missing) - count(unreported))
    written = len(numbers) + count(unexplained)
    lost += count(unreported) - count(unexplained)
    verification = Verification(
        ok,
        len(numbers),
        end - first,
        written=written,
        dropped=dropped,
        lost=lost,
        missed=missed,
        missing=missing,
        unexplained=unexplained,
        damages=damages,
        closed=closed,
        text="",
        given_up=tuple(s.path for s in given_up),
    )
    return replace(verification, text=_sentence(recording, verification))


def _lost_before(text: str) -> list[Range]:
    """Numbers that an earlier recovery could not save, as its recording states them; none where it states nothing usable."""
    try:
        ranges_text = json.loads(text)
        return [(int(first), int(last)) for first, last in ranges_text]
    except (ValueError, TypeError, OverflowError, RecursionError):
        return []


def _span(numbers: Sequence[int], statistics: Statistics | None, segments: Collection[int]) -> Range:
    """First slot and the slot after the last that the recording should cover. segments: numbers of those that are here."""
    first, end = (numbers[0], numbers[-1] + 1) if numbers else (0, 0)
    if statistics is None:
        return first, end
    if (
        segments and min(segments) == 0 and max(segments) == len(segments) - 1
    ):  # all up to the one with the last statistics
        first = min(first, statistics.first_number) if numbers else statistics.first_number
    if statistics.final or not numbers:
        end = max(end, statistics.next_number)
    return first, max(first, end)


def _counts(statistics: Statistics | None, absent: int) -> tuple[int, int, int]:
    """(dropped, lost, missed) of the `absent` slots that the logger reported as such."""
    if statistics is None:
        return 0, 0, 0
    if absent == statistics.dropped + statistics.lost + statistics.missed:
        return statistics.dropped, statistics.lost, statistics.missed
    # One segment of several: the session's absent slots lie partly elsewhere, and their kind is not told slot by slot.
    return absent, 0, 0


def _sentence(recording: Recording, v: Verification) -> str:
    numbers = recording.numbers
    parts = [f"{len(numbers)} scans, {numbers[0]} to {numbers[-1]}" if numbers else "no scan in it"]
    if not v.missing:
        parts.append("none missing")
    elif recording.info.role == "received":
        parts.append(f"{count(v.missing)} not received")
    else:
        accounted = count(v.missing) - count(v.unexplained)
        if accounted:
            parts.append(f"{accounted} absent and accounted for")
        if v.unexplained:
            parts.append(f"{count(v.unexplained)} missing without account: {shown(v.unexplained)}")
    if v.damages:
        path, first_damage = v.damages[0]
        rest = f" and {len(v.damages) - 1} more" if len(v.damages) > 1 else ""
        parts.append(f"damaged at byte {first_damage.at_byte} of {path.name} ({first_damage.what}){rest}")
    if not v.closed:
        parts.append(
            "not closed in order: at most the time since the last flush is lost, after a power cut since the last sync"
        )
    if not v.ok and (v.damages or not v.closed):
        parts.append("'sideslip recover' saves what is intact")
    if v.given_up:
        names = ", ".join(p.name for p in v.given_up)
        parts.append(f"{names} given up by the logger after a write error, the recording goes on in the next file")
    return ("sound: " if v.ok else "not sound: ") + "; ".join(parts)


def _verify_foreign(segments: Sequence[RecordingWalk]) -> Verification:
    """A calibrated flight or another MCAP file: bytes and structure only."""
    damages = tuple((s.path, d) for s in segments for d in s.damages)
    closed = all(s.closed for s in segments)
    samples = sum(n for s in segments for n in s.foreign.values())
    ok = closed and not damages
    content = f"{samples} messages, no raw scans"
    state = "every checksum holds" if ok else f"damaged at byte {damages[0][1].at_byte} ({damages[0][1].what})"
    return Verification(ok, samples, samples, samples, 0, 0, 0, (), (), damages, closed, f"{content}; {state}")
