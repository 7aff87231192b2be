"""The receiver's counters as `ground --json` gives them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from groundstation.receiver import events as ev
from groundstation.receiver.link_accounting import SequenceTracker


def counters(
    books: Sequence[ev.Accounting],
    totals: Sequence[int],
    trackers: Sequence[SequenceTracker],
    rejected: int,
    written: Sequence[Path],
) -> dict[str, Any]:
    """Counters of all aircraft; scan ranges are those of the session with most scans, `sessions` has them all.

    totals: bytes received, frames, damaged frames, bytes discarded, of all decoders.
    """
    main = max(books, key=lambda a: a.received, default=None)
    return {
        "frames_received": totals[1],
        "frames_damaged": totals[2],
        "frames_lost": sum(t.lost for t in trackers),
        "duplicates": sum(t.duplicates for t in trackers),
        "scans_received": sum(a.received for a in books),
        "scans_lost": [] if main is None else [list(r) for r in main.lost],
        "scans_missing": [] if main is None else [list(r) for r in main.missing],
        "bytes_received": totals[0],
        "bytes_discarded": totals[3],
        "unsigned_rejected": rejected,
        "backfilled": sum(a.backfilled for a in books),
        "flight": str(written[0]) if written else None,
        "sessions": [_session(a) for a in books],
    }


def _session(a: ev.Accounting) -> dict[str, Any]:
    return {
        "system": a.session.system,
        "boot": a.session.boot,
        "turn": a.session.turn,
        "first_scan": a.first,
        "last_scan": a.last,
        "scans_sent": a.sent,
        "scans_received": a.received,
        "scans_lost": [list(r) for r in a.lost],
        "scans_missing": [list(r) for r in a.missing],
        "scans_never_sent": a.never_sent,
        "scans_absent": [list(r) for r in a.absent],
        "scans_unknown": [list(r) for r in a.unknown],
        "backfilled": a.backfilled,
    }
