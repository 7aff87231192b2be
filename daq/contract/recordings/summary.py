"""What is in a recording or a calibrated flight: the summary that `info` prints."""

from pathlib import Path
from typing import Any

from daq.contract.channels import CHANNELS, COLUMNS
from daq.contract.recordings.reading import Recording, by_session, join
from daq.contract.recordings.recording import RecordingError
from daq.contract.recordings.segments import FLIGHT_METADATA, FLIGHT_TOPIC, RecordingWalk, read_segments

_SHOWN = 5  # topics named in a sentence; a file may have thousands


def info_mcap(path: str | Path) -> dict[str, Any]:
    """The JSON object of `info --json` for a raw recording or a calibrated flight in MCAP, damaged or not.

    Of a file with several sessions the counts are sums and `sessions` holds the object of each.
    Raises RecordingError when the file is neither.
    """
    path = Path(path)
    segments = read_segments(path)
    raw = [s for s in segments if s.info is not None or s.entries]
    if raw:
        groups = [segments] if path.is_dir() or len(segments) == 1 else list(by_session(raw).values())
        return _summed([_raw_info(path, join(path, g)) for g in groups])
    flights = [s for s in segments if FLIGHT_TOPIC in s.auxiliary]
    if flights:
        return _summed([_flight_info(path, s) for s in flights])
    if any(m.name == FLIGHT_METADATA for s in segments for m in s.metadata):
        raise RecordingError(f"{path}: a calibrated flight, damaged so that none of it can be read; calibrate it again")
    topics = sorted({t for s in segments for t in s.foreign})
    topic_names = ", ".join(t[:40] for t in topics[:_SHOWN]) + (", ..." if len(topics) > _SHOWN else "")
    raise RecordingError(f"{path}: an MCAP file of another program (topics: {topic_names or 'none'})")


def _summed(summaries: list[dict[str, Any]]) -> dict[str, Any]:
    """One summary of all sessions in a file, with each of them in it."""
    if len(summaries) == 1:
        return summaries[0]
    first = summaries[0]
    names = [f.get("session", "") for f in summaries]
    numbered = [f for f in summaries if f["first_scan"] is not None]
    duration = sum(f["duration_s"] for f in summaries)
    steps = sum(f["rate_hz"] * f["duration_s"] for f in summaries)
    samples: dict[str, dict[str, Any]] = {}
    for channel in (c for f in summaries for c in f["channels"]):
        totals = samples.setdefault(channel["name"], {**channel, "samples": 0})
        totals["samples"] += channel["samples"]
    return {
        **first,
        "session": ", ".join(names),
        "segments": sum(f.get("segments", 1) for f in summaries),
        "duration_s": duration,
        "rate_hz": steps / duration if duration else 0.0,
        "scans": sum(f["scans"] for f in summaries),
        "first_scan": min((f["first_scan"] for f in numbered), default=None),
        "last_scan": max((f["last_scan"] for f in numbered), default=None),
        "channels": list(samples.values()),
        "events": [e for f in summaries for e in f.get("events", [])],
        "sound": all(f["sound"] for f in summaries),
        "sessions": summaries,
    }


def _raw_info(path: Path, recording: Recording) -> dict[str, Any]:
    samples = dict.fromkeys((c.name for c in CHANNELS), 0)
    first_ns = last_ns = None
    scans = 0
    for scan in recording.scans():
        first_ns, last_ns = scan.time_monotonic_ns if first_ns is None else first_ns, scan.time_monotonic_ns
        scans += 1
        for name in scan.values:
            samples[name] += 1
    numbers = recording.numbers
    duration = (last_ns - first_ns) * 1e-9 if first_ns is not None and last_ns is not None else 0.0
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
        "rate_hz": (scans - 1) / duration if duration else 0.0,
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


def _flight_info(path: Path, segment: RecordingWalk) -> dict[str, Any]:
    """Summary of a calibrated flight, its columns read with the schema in the file."""
    from daq.contract.recordings.flight_rows import as_mapping, as_texts, described, flight_rows

    flight = flight_rows(segment)
    provenance, _, _ = described(segment)
    units = {c.name: c.unit for c in COLUMNS}
    rows, duration = len(flight.values), flight.duration_s
    return {
        "file": str(path),
        "kind": "flight",
        "source": str(provenance.get("source", "imported")),
        "aircraft": str(provenance.get("aircraft", "")),
        "duration_s": duration,
        "rate_hz": (rows - 1) / duration if duration else 0.0,
        "scans": rows,
        "first_scan": 0 if rows else None,
        "last_scan": rows - 1 if rows else None,
        "channels": [
            {"name": n, "unit": units.get(n, ""), "samples": k}
            for n, k in flight.samples.items()
            if n not in ("time", "segment")
        ],
        "notes": as_texts(provenance.get("notes")),
        "calibration": sorted(as_mapping(provenance.get("calibration"))),
        "sound": segment.sound,
        "software": str(provenance.get("software", "")),
    }
