"""Quality of the links between two reports, and the counters of `ground --json`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from groundstation.receiver import events as ev
from groundstation.receiver.decode import AircraftDecoder
from groundstation.receiver.link_accounting import SequenceTracker
from groundstation.receiver.timeline import NS

_UNKNOWN_SIGNAL = 255  # in RADIO_STATUS


class RateMeter:
    """Loss and rates of one decoder between reports. radio: fields of the radio's own latest report."""

    def __init__(self, decoder: AircraftDecoder) -> None:
        self._decoder = decoder
        self._last_counts = (0, 0)  # received and lost frames at the last report
        self._last_ns: int | None = None
        self.radio: Mapping[str, Any] = {}

    def report(self, now_ns: int) -> ev.LinkStatistics | None:
        """Link statistics since the last report; None before the aircraft has sent a scan."""
        accounting = self._decoder.accounting
        if accounting is None:
            return None
        tracker = self._decoder.tracker
        received = tracker.received - self._last_counts[0]
        lost_frames = max(0, tracker.lost - self._last_counts[1])  # late frames may lower the count
        self._last_counts = (tracker.received, tracker.lost)
        span = (now_ns - self._last_ns) / NS if self._last_ns is not None else 0.0
        self._last_ns = now_ns
        scans, self._decoder.scans_since_report = self._decoder.scans_since_report, 0
        relation = self._decoder.sync.best
        return ev.LinkStatistics(
            accounting.session,
            now_ns,
            loss=lost_frames / max(1, received + lost_frames),
            frames_received=tracker.received,
            frames_lost=tracker.lost,
            scan_rate_hz=scans / span if span > 0 else 0.0,
            latency_s=self._decoder.latency_s,
            round_trip_s=None if relation is None else relation.round_trip_ns / NS,
            clock_offset_s=None if relation is None else relation.offset_ns / NS,
            **self._radio_values(),
        )

    def _radio_values(self) -> dict[str, Any]:
        if not self.radio:
            return {}
        f = self.radio
        return {
            "rssi_dbm": _sik_dbm(f["rssi"]),
            "remote_rssi_dbm": _sik_dbm(f["remrssi"]),
            "noise_dbm": _sik_dbm(f["noise"]),
            "remote_noise_dbm": _sik_dbm(f["remnoise"]),
            "txbuf_percent": min(100, f["txbuf"]),
        }


def _sik_dbm(value: int) -> float | None:
    """Signal [dBm] from the value of a SiK radio (SiK firmware documentation: value / 1.9 - 127); None for an unknown one."""
    return None if value == _UNKNOWN_SIGNAL else value / 1.9 - 127.0


def counters(
    accounting: Sequence[ev.Accounting],
    totals: Sequence[int],
    trackers: Sequence[SequenceTracker],
    rejected: int,
    recordings: Sequence[Path],
) -> dict[str, Any]:
    """Counters of all aircraft; scan ranges are of the session with most scans, `sessions` has those of each.

    totals: bytes received, frames, damaged frames, bytes discarded, of all decoders.
    """
    main = max(accounting, key=lambda a: a.received, default=None)
    return {
        "frames_received": totals[1],
        "frames_damaged": totals[2],
        "frames_lost": sum(t.lost for t in trackers),
        "duplicates": sum(t.duplicates for t in trackers),
        "scans_received": sum(a.received for a in accounting),
        "scans_lost": [] if main is None else [list(r) for r in main.lost],
        "scans_missing": [] if main is None else [list(r) for r in main.missing],
        "bytes_received": totals[0],
        "bytes_discarded": totals[3],
        "unsigned_rejected": rejected,
        "backfilled": sum(a.backfilled for a in accounting),
        "flight": str(recordings[0]) if recordings else None,
        "sessions": [_session_counters(a) for a in accounting],
    }


def _session_counters(a: ev.Accounting) -> dict[str, Any]:
    """One entry of `sessions`."""
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
