"""Save what is intact in a damaged recording to new, sound ones."""

import hashlib
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from daq.contract.recordings.accounting import LOST_TO_DAMAGE, Verification, verify_recording, verify_segments
from daq.contract.recordings.reading import Recording, by_session, join
from daq.contract.recordings.recording import RecordingError, RecordingInfo, RecordingWriter, utc_of
from daq.contract.recordings.segments import RecordingWalk, read_segments
from daq.utilities.durable import make_directories, replacing
from daq.utilities.plain_words import visible


@dataclass(frozen=True)
class Recovery:
    """What `recover` saved and where the original was damaged. sessions: name, file and scans of each session saved."""

    path: Path
    recovered: int
    verification: Verification  # of the damaged original
    sessions: tuple[tuple[str, Path, int], ...] = ()

    def to_dict(self) -> dict[str, Any]:
        fields = self.verification.to_dict()
        target = (
            self.path if len(self.sessions) < 2 else ", ".join(f"{p} (session {s}, {n})" for s, p, n in self.sessions)
        )
        text = f"{self.recovered} scans recovered to {target}; original {self.verification.text}"
        result: dict[str, Any] = {**fields, "recovered": self.recovered, "out": str(self.path), "text": text}
        if len(self.sessions) > 1:
            result["outs"] = [{"session": s, "out": str(p), "recovered": n} for s, p, n in self.sessions]
        return result


def recover(path: str | Path, out: str | Path) -> Recovery:
    """Write everything in a recording that is surely right to a new, sound recording.

    Of a file that holds several sessions the first is written to `out`, the others beside it as OUT_2.mcap and so on.
    Raises RecordingError when nothing can be saved, or when `out` exists or is not a .mcap name.
    """
    path, out = Path(path), Path(out)
    if out.suffix != ".mcap":
        raise RecordingError(f"{out}: name the recovered recording .mcap")
    if out.exists():
        raise RecordingError(f"{out}: exists already; name a new file")
    segments = read_segments(path)
    recordings = _with_messages(path, segments)
    outs = [out, *(out.with_stem(f"{out.stem}_{i}") for i in range(2, len(recordings) + 1))]
    for further_path in outs[1:]:
        if further_path.exists():
            raise RecordingError(
                f"{further_path}: exists already, and {path} holds {len(recordings)} sessions; name another OUT"
            )
    for recording, target in zip(recordings, outs, strict=True):
        _write_recovered(recording, target)
    saved = tuple((r.info.session, o, len(r.numbers)) for r, o in zip(recordings, outs, strict=True))
    return Recovery(out, sum(n for *_, n in saved), verify_segments(path, segments), saved)


def _with_messages(path: Path, segments: list[RecordingWalk]) -> list[Recording]:
    """The recordings in a file or directory that hold a message."""
    groups = [segments] if path.is_dir() or len(segments) == 1 else list(by_session(segments).values())
    raw = [g for g in groups if any(s.entries for s in g)]
    if not raw:
        join(path, segments)  # says so where it is no raw recording at all
        raise RecordingError(f"{path}: not a single message in it is intact; there is nothing to recover")
    return [join(path, g) for g in raw]


def _write_recovered(recording: Recording, out: Path) -> None:
    info = _recovered_info(recording, verify_recording(recording))
    make_directories(out.parent)
    with replacing(out) as partial, partial.open("wb") as stream:
        writer = RecordingWriter(stream, info, log_time=utc_of(recording.entries))
        for i, entry in enumerate(recording.entries, start=1):
            writer.write(entry)
            if i % 1000 == 0:
                writer.flush()
        writer.finish()


def _recovered_info(recording: Recording, verification: Verification) -> RecordingInfo:
    origin = "; ".join(
        f"{visible(p.name)} sha256 {hashlib.sha256(p.read_bytes()).hexdigest()}" for p in recording.files
    )
    lost_ranges = json.dumps([list(r) for r in verification.unexplained])
    details = {**recording.info.details, "recovered_from": origin, LOST_TO_DAMAGE: lost_ranges}
    return replace(recording.info, details=details)
