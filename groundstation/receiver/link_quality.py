"""Quality of the link to one aircraft between two reports: loss, rate, latency, clock relation, signal."""

from collections import deque
from collections.abc import Mapping
from typing import Any

from groundstation.receiver import events as ev
from groundstation.receiver.decode import AircraftDecoder
from groundstation.receiver.timeline import NS


class RateMeter:
    """Shares and rates between reports of one decoder."""

    def __init__(self, decoder: AircraftDecoder) -> None:
        self._decoder = decoder
        self._last = (0, 0)
        self._last_ns: int | None = None
        self._radio: deque[Mapping[str, int]] = deque(maxlen=1)

    def radio(self, fields: Mapping[str, Any]) -> None:
        """Remember the radio's own report."""
        self._radio.append(dict(fields))

    def report(self, now_ns: int) -> ev.LinkStatistics | None:
        """Link statistics since the last report; None before the aircraft has sent a scan."""
        books = self._decoder.books
        if books is None:
            return None
        tracker = self._decoder.tracker
        received, lost = tracker.received - self._last[0], tracker.lost - self._last[1]
        self._last = (tracker.received, tracker.lost)
        span = (now_ns - self._last_ns) / NS if self._last_ns is not None else 0.0
        self._last_ns = now_ns
        scans, self._decoder.scans_since_report = self._decoder.scans_since_report, 0
        relation = self._decoder.sync.best
        return ev.LinkStatistics(
            books.session,
            now_ns,
            loss=max(0, lost) / max(1, received + max(0, lost)),
            frames_received=tracker.received,
            frames_lost=tracker.lost,
            scan_rate_hz=scans / span if span > 0 else 0.0,
            latency_s=self._decoder.latency_s,
            round_trip_s=None if relation is None else relation.round_trip_ns / NS,
            clock_offset_s=None if relation is None else relation.offset_ns / NS,
            **self._radio_values(),
        )

    def _radio_values(self) -> dict[str, Any]:
        if not self._radio:
            return {}
        f = self._radio[0]
        return {
            "rssi_dbm": _sik_dbm(f["rssi"]),
            "remote_rssi_dbm": _sik_dbm(f["remrssi"]),
            "noise_dbm": _sik_dbm(f["noise"]),
            "remote_noise_dbm": _sik_dbm(f["remnoise"]),
            "txbuf_percent": min(100, f["txbuf"]),
        }


def _sik_dbm(value: int) -> float | None:
    """SiK signal value to dBm (SiK firmware documentation: value / 1.9 - 127)."""
    return None if value == 255 else value / 1.9 - 127.0
