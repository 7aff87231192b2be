"""Does a recording hold every scan it should? Verification, recovery, and the summary `info` prints.

The books: scan numbers run from the first to the last slot the logger used. Each number is present, or the logger
itself said that it is absent (dropped, lost, or missed), or it lies in a damaged stretch or after the last flush.
`slots = scans + sum of missing` always closes; a missing number that nobody accounts for makes the verdict "not ok".
"""

import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from daq.contract.channels import CHANNELS, COLUMNS
from daq.contract.ranges import Range, count, ranges, shown, subtract
from daq.contract.recordings.messages import Statistics, message_class
from daq.contract.recordings.reading import Recording, Segment, join, read_segments
from daq.contract.recordings.recording import Entry, RecordingError, RecordingInfo, RecordingWriter
from daq.contract.recordings.salvage import Damage, Walk

_FLIGHT_TOPIC, _FLIGHT_METADATA = "/flight", "sideslip.flight"
_LOST_TO_DAMAGE = "lost_to_damage"


@dataclass(frozen=True)
class Verification:
    """What `verify` found. Ranges are inclusive (first, last) scan numbers.

    scans: present and proven. written, dropped, lost, missed: as the logger counted them, or as they follow from the
    numbers where its last count is older than the last scan. missing: absent numbers. unexplained: the part of
    `missing` that the logger did not report as absent itself. given_up: segments that the logger left after a write
    error and continued in another file; their torn ends are no damage of the recording.
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

    def to_dict(self) -> dict[str, Any]:
        """The JSON object of `verify --json`."""
        many = len({p for p, _ in self.damages}) > 1
        return {
            "ok": self.ok,
            "scans": self.scans,
            "written": self.written,
            "dropped": self.dropped,
            "lost": self.lost,
            "missed": self.missed,
            "slots": self.slots,
            "missing": [list(r) for r in self.missing],
            "unexplained": [list(r) for r in self.unexplained],
            "damaged": [
                {"at_byte": d.at_byte, "what": d.what, "length": d.length} | ({"file": str(p)} if many else {})
                for p, d in self.damages
            ],
            "closed": self.closed,
            "given_up": [str(p) for p in self.given_up],
            "text": self.text,
        }


def verify(path: str | Path) -> Verification:
    """Check a recording, file or directory: every byte, every scan, every number.

    Raises RecordingError when there is no recording to check.
    """
    path = Path(path)
    segments = read_segments(path)
    if all(s.info is None and not s.entries and (s.foreign or s.metadata) for s in segments):
        return _verify_foreign(segments)
    return verify_recording(join(path, segments))


def verify_recording(recording: Recording) -> Verification:
    """Check a recording that has been walked through."""
    numbers = recording.numbers
    books = recording.statistics[-1] if recording.statistics else None
    whole_session = _is_whole(recording)
    first, end = _span(numbers, books, whole_session)
    missing = ranges(sorted(set(range(first, end)) - set(numbers)))
    not_told = subtract(missing, books.absent if books else ())
    unexplained = subtract(not_told, json.loads(recording.info.details.get(_LOST_TO_DAMAGE, "[]")))
    given_up, damages = recording.given_up, recording.damages
    closed = all(s.closed for s in recording.segments if s not in given_up)
    gaps_expected = recording.info.role == "received"
    ok = closed and not damages and bool(numbers) and (gaps_expected or not unexplained)
    dropped, lost, missed = _counts(books, count(missing) - count(not_told))
    written = len(numbers) + count(unexplained)
    lost += count(not_told) - count(unexplained)
    text = _sentence(recording, ok, numbers, missing, unexplained, damages, closed)
    if given_up:
        names = ", ".join(s.path.name for s in given_up)
        text += f"; {names} given up by the logger after a write error, the recording goes on in the next file"
    return Verification(
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
        text=text,
        given_up=tuple(s.path for s in given_up),
    )


def _is_whole(recording: Recording) -> bool:
    """Whether all segments from the first to the one with the last books are here."""
    present = [s.info.segment for s in recording.segments if s.info]
    return bool(present) and sorted(present) == list(range(max(present) + 1))


def _span(numbers: Sequence[int], books: Statistics | None, whole_session: bool) -> Range:
    """First slot and the slot after the last that the recording should cover."""
    first, end = (numbers[0], numbers[-1] + 1) if numbers else (0, 0)
    if books is None:
        return first, end
    if whole_session:
        first = min(first, books.first_number) if numbers else books.first_number
    if books.final or not numbers:
        end = max(end, books.next_number)
    return first, max(first, end)


def _counts(books: Statistics | None, absent: int) -> tuple[int, int, int]:
    """(dropped, lost, missed) of the `absent` slots that the logger reported as such."""
    if books is None:
        return 0, 0, 0
    if absent == books.dropped + books.lost + books.missed:
        return books.dropped, books.lost, books.missed
    # One segment of several: the session's absent slots lie partly elsewhere, and their kind is not told slot by slot.
    return absent, 0, 0


def _sentence(
    recording: Recording,
    ok: bool,
    numbers: Sequence[int],
    missing: Sequence[Range],
    unexplained: Sequence[Range],
    damages: Sequence[tuple[Path, Damage]],
    closed: bool,
) -> str:
    if not numbers:
        parts = ["no scan in it"]
    else:
        parts = [f"{len(numbers)} scans, {numbers[0]} to {numbers[-1]}"]
    if not missing:
        parts.append("none missing")
    elif recording.info.role == "received":
        parts.append(f"{count(missing)} not received")
    else:
        known = count(missing) - count(unexplained)
        if known:
            parts.append(f"{known} absent and accounted for")
        if unexplained:
            parts.append(f"{count(unexplained)} missing without account: {shown(unexplained)}")
    if damages:
        path, worst = damages[0]
        more = f" and {len(damages) - 1} more" if len(damages) > 1 else ""
        parts.append(f"damaged at byte {worst.at_byte} of {path.name} ({worst.what}){more}")
    if not closed:
        parts.append("not closed in order: at most the time since the last flush is lost")
    if not ok and (damages or not closed):
        parts.append("'sideslip recover' saves what is intact")
    return ("sound: " if ok else "not sound: ") + "; ".join(parts)


def _verify_foreign(segments: Sequence[Segment]) -> Verification:
    """A calibrated flight or another MCAP file: bytes and structure only."""
    damages = tuple((s.path, d) for s in segments for d in s.damages)
    closed = all(s.closed for s in segments)
    samples = sum(n for s in segments for n in s.foreign.values())
    ok = closed and not damages
    what = f"{samples} messages, no raw scans"
    state = "every checksum holds" if ok else f"damaged at byte {damages[0][1].at_byte} ({damages[0][1].what})"
    return Verification(ok, samples, samples, samples, 0, 0, 0, (), (), damages, closed, f"{what}; {state}")


# ------------------------------------------------------------------------------------------------------- recovery


@dataclass(frozen=True)
class Recovery:
    """What `recover` saved and where the original was damaged."""

    path: Path
    recovered: int
    verification: Verification  # of the damaged original

    def to_dict(self) -> dict[str, Any]:
        """The JSON object of `recover --json`."""
        fields = self.verification.to_dict()
        text = f"{self.recovered} scans recovered to {self.path}; original {self.verification.text}"
        return {**fields, "recovered": self.recovered, "out": str(self.path), "text": text}


def recover(path: str | Path, out: str | Path) -> Recovery:
    """Write everything in a recording that is surely right to a new, sound recording.

    Raises RecordingError when nothing can be saved, or when `out` exists or is not a .mcap name.
    """
    path, out = Path(path), Path(out)
    if out.suffix != ".mcap":
        raise RecordingError(f"{out}: name the recovered recording .mcap")
    if out.exists():
        raise RecordingError(f"{out}: exists already; name a new file")
    segments = read_segments(path)
    recording = join(path, segments)
    verification = verify_recording(recording)
    if not recording.entries:
        raise RecordingError(f"{path}: not a single message in it is intact; there is nothing to recover")
    info = _recovered_info(recording, segments, verification)
    out.parent.mkdir(parents=True, exist_ok=True)
    partial = out.with_suffix(".mcap.part")
    with partial.open("wb") as stream:
        writer = RecordingWriter(stream, info)
        for i, entry in enumerate(recording.entries, start=1):
            writer.write(entry)
            if i % 1000 == 0:
                writer.flush()
        writer.finish()
        stream.flush()
        os.fsync(stream.fileno())
    partial.replace(out)
    return Recovery(out, len(recording.numbers), verification)


def _recovered_info(recording: Recording, segments: Sequence[Segment], verification: Verification) -> RecordingInfo:
    origin = "; ".join(f"{s.path.name} sha256 {hashlib.sha256(s.path.read_bytes()).hexdigest()}" for s in segments)
    lost = json.dumps([list(r) for r in verification.unexplained])
    details = {**recording.info.details, "recovered_from": origin, _LOST_TO_DAMAGE: lost}
    return replace(recording.info, details=details)


# -------------------------------------------------------------------------------------------------- what is in a file


def info_mcap(path: str | Path) -> dict[str, Any]:
    """The JSON object of `info --json` for a raw recording or a calibrated flight in MCAP, damaged or not.

    Raises RecordingError when the file is neither.
    """
    path = Path(path)
    segments = read_segments(path)
    if any(s.info is not None or s.entries for s in segments):
        return _raw_info(path, join(path, segments))
    if any(_FLIGHT_TOPIC in s.foreign for s in segments):
        return _flight_info(path, segments[0])
    if any(m.name == _FLIGHT_METADATA for s in segments for m in s.metadata):
        raise RecordingError(f"{path}: a calibrated flight, damaged so that none of it can be read; calibrate it again")
    topics = sorted({t for s in segments for t in s.foreign})
    raise RecordingError(f"{path}: an MCAP file of another program (topics: {', '.join(topics) or 'none'})")


def _raw_info(path: Path, recording: Recording) -> dict[str, Any]:
    samples = dict.fromkeys((c.name for c in CHANNELS), 0)
    times: list[int] = []
    for scan in recording.scans():
        times.append(scan.time_monotonic_ns)
        for name in scan.values:
            samples[name] += 1
    numbers = recording.numbers
    duration = (times[-1] - times[0]) * 1e-9 if len(times) > 1 else 0.0
    info = recording.info
    return {
        "file": str(path),
        "kind": "raw",
        "source": info.source,
        "role": info.role,
        "aircraft": info.aircraft,
        "session": info.session,
        "segments": len(recording.segments),
        "duration_s": duration,
        "rate_hz": (len(times) - 1) / duration if duration else 0.0,
        "scans": len(numbers),
        "first_scan": numbers[0] if numbers else None,
        "last_scan": numbers[-1] if numbers else None,
        "channels": [{"name": c.name, "unit": c.unit, "samples": samples[c.name]} for c in CHANNELS],
        "events": [{"time": e.time_monotonic_ns * 1e-9, "origin": e.origin, "text": e.text} for e in recording.events],
        "calibration": sorted(info.calibration),
        "details": dict(info.details),
        "sound": all(s.sound for s in recording.segments),
        "software": info.software,
    }


def _flight_info(path: Path, segment: Segment) -> dict[str, Any]:
    """Summary of a calibrated flight, its columns read with the schema in the file."""
    walk = Walk(segment.path.read_bytes())
    data = [item.data for item in walk if isinstance(item, Entry) and item.topic == _FLIGHT_TOPIC]
    described = next((m.fields.get("json", "{}") for m in segment.metadata if m.name == _FLIGHT_METADATA), "{}")
    provenance = json.loads(described)
    row_class = message_class(*walk.schemas[walk.channel_schema[_FLIGHT_TOPIC]])
    rows = [row_class.FromString(d) for d in data]
    names = [f.name for f in row_class.DESCRIPTOR.fields if f.name not in ("time", "segment")]
    duration = rows[-1].time - rows[0].time if rows else 0.0
    units = {c.name: c.unit for c in COLUMNS}
    return {
        "file": str(path),
        "kind": "flight",
        "source": provenance.get("source", "imported"),
        "aircraft": provenance.get("aircraft", ""),
        "duration_s": duration,
        "rate_hz": (len(rows) - 1) / duration if duration else 0.0,
        "scans": len(rows),
        "first_scan": 0 if rows else None,
        "last_scan": len(rows) - 1 if rows else None,
        "channels": [
            {"name": n, "unit": units.get(n, ""), "samples": sum(1 for r in rows if r.HasField(n))} for n in names
        ],
        "notes": provenance.get("notes", []),
        "calibration": sorted(provenance.get("calibration", {})),
        "sound": segment.sound,
        "software": provenance.get("software", ""),
    }
