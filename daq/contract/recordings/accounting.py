"""Verification of a recording: whether it holds every scan that it should.

Scan numbers run from the first to the last slot that the logger used. Each is present, or counted as absent by the logger
(dropped, lost or missed), or in a damaged stretch or after the last flush. `slots = scans + sum of missing` always holds; a
missing number without an explanation makes the recording not ok. Several sessions in one file are verified one by one.
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

LOST_TO_DAMAGE = "lost_to_damage"  # detail of a recovered recording: ranges of scan numbers that were not saved
COUNTS = ("scans", "written", "dropped", "lost", "missed", "slots")


@dataclass(frozen=True)
class Verification:
    """The result of `verify`. Ranges are inclusive (first, last) scan numbers.

    scans: intact ones. slots: from the first to the last number. written, dropped, lost, missed: as the logger counted them, or
    as they follow from the numbers where its last count is older than the last scan. missing: absent numbers. unexplained: those
    of `missing` that the logger did not count as absent. closed: every file was closed in order. given_up: files that the logger
    left after a write error to continue in another; their incomplete ends are no damage of the recording. sessions: name and
    result of each session in a file with several; counts are then sums, and ranges those of one session after the other.
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
    """Verify a recording, file or directory. Raises RecordingError when there is none."""
    return verify_segments(Path(path), read_segments(path))


def verify_segments(path: Path, segments: list[RecordingWalk]) -> Verification:
    """`verify` for segments that have been read already."""
    groups = [segments] if path.is_dir() or len(segments) == 1 else list(by_session(segments).values())
    verifications = [_verify_group(path, g) for g in groups]
    return verifications[0][1] if len(verifications) == 1 else _summed(verifications)


def _verify_group(path: Path, segments: list[RecordingWalk]) -> tuple[str, Verification]:
    if all(s.info is None and not s.entries and (s.foreign or s.metadata) for s in segments):
        return "no recording", _verify_foreign(segments)
    recording = join(path, segments)
    return recording.info.session, verify_recording(recording)


def _summed(verifications: Sequence[tuple[str, Verification]]) -> Verification:
    """The result for a file with several sessions: the sums, and each session."""
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
    """`verify` for one session that has been read already."""
    numbers = recording.numbers
    statistics = recording.last_statistics
    first, end = _span(numbers, statistics, {s.info.segment for s in recording.segments if s.info})
    missing = subtract([(first, end - 1)], ranges(numbers))
    unreported = subtract(missing, statistics.absent if statistics else ())
    unexplained = subtract(unreported, _lost_before(recording.info.details.get(LOST_TO_DAMAGE, "[]")))
    given_up, damages = recording.given_up, recording.damages
    role = recording.info.role
    # the last file of a session's directory may be closed in order though the logger had begun another, which is missing
    file_missing = recording.path.is_dir() and role == "onboard" and statistics is not None and not statistics.final
    closed = all(s.closed or any(s is g for g in given_up) for s in recording.segments) and not file_missing
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
    """Numbers that an earlier recovery could not save, from the detail LOST_TO_DAMAGE; none where that is unreadable."""
    try:
        ranges_text = json.loads(text)
        return [(int(first), int(last)) for first, last in ranges_text]
    except (ValueError, TypeError, OverflowError, RecursionError):
        return []


def _span(numbers: Sequence[int], statistics: Statistics | None, segments: Collection[int]) -> Range:
    """First slot, and the one after the last, that the recording should cover. segments: numbers of its files."""
    first, end = (numbers[0], numbers[-1] + 1) if numbers else (0, 0)
    if statistics is None:
        return first, end
    if (
        segments and min(segments) == 0 and max(segments) == len(segments) - 1
    ):  # no file is missing up to the one with the last statistics
        first = min(first, statistics.first_number) if numbers else statistics.first_number
    if statistics.final or not numbers:
        end = max(end, statistics.next_number)
    return first, max(first, end)


def _counts(statistics: Statistics | None, absent: int) -> tuple[int, int, int]:
    """How many of the `absent` slots that the logger reported were dropped, lost and missed."""
    if statistics is None:
        return 0, 0, 0
    if absent == statistics.dropped + statistics.lost + statistics.missed:
        return statistics.dropped, statistics.lost, statistics.missed
    # one file of several: other absent slots of the session are elsewhere, and the statistics do not give the kind of each slot
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
        further = f" and {len(v.damages) - 1} more" if len(v.damages) > 1 else ""
        parts.append(f"damaged at byte {first_damage.at_byte} of {path.name} ({first_damage.what}){further}")
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
    """Verify bytes and structure of an MCAP file that is no raw recording, such as a calibrated flight."""
    damages = tuple((s.path, d) for s in segments for d in s.damages)
    closed = all(s.closed for s in segments)
    samples = sum(n for s in segments for n in s.foreign.values())
    ok = closed and not damages
    content = f"{samples} messages, no raw scans"
    state = "every checksum holds" if ok else f"damaged at byte {damages[0][1].at_byte} ({damages[0][1].what})"
    return Verification(ok, samples, samples, samples, 0, 0, 0, (), (), damages, closed, f"{content}; {state}")
