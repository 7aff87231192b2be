"""What is in a log of another program, as `sideslip info` says it."""

from pathlib import Path
from typing import Any

import numpy as np

from groundstation.flight.marks import together
from groundstation.importers.endings import BAGS, LOGS
from groundstation.importers.formats.bags import is_bag
from groundstation.importers.formats.dataflash import HEAD, is_text
from groundstation.importers.run import read_logs
from groundstation.importers.series import Log, native_rate

_ENOUGH = 64  # bytes of a file that tell a dataflash log


def is_foreign_log(path: Path) -> bool:
    """Whether a file is an autopilot's log by its ending; a .bin or .log, which others write too, by its first bytes."""
    suffix = path.suffix.lower()
    if suffix in BAGS:
        return is_bag(path)
    if suffix not in LOGS or not path.is_file():
        return False
    if LOGS[suffix] != "ardupilot":
        return True
    with path.open("rb") as file:
        head = file.read(_ENOUGH)
    return head.startswith(HEAD) or is_text(head)


def log_info(path: Path) -> dict[str, Any]:
    """As `info --json`. Raises ImportDataError for a log that cannot be read."""
    logs = [log for log, _ in read_logs(path)]
    spans = [_span(log) for log in logs]
    fastest = max(native_rate(s) for log in logs for s in log.series.values())
    counted: dict[str, int] = {}
    for log in logs:
        for name, series in log.series.items():
            counted[name] = counted.get(name, 0) + int(np.isfinite(series.values).sum())
    return {
        "file": str(path),
        "kind": logs[0].kind,
        "source": "imported",
        "aircraft": "",
        "duration_s": sum(b - a for a, b in spans),
        "rate_hz": fastest,
        "scans": max(s.time.size for log in logs for s in log.series.values()),
        "first_scan": None,
        "last_scan": None,
        "channels": [{"name": n, "unit": logs[0].units.get(n, ""), "samples": c} for n, c in counted.items()],
        "software": logs[0].detail.get("firmware", ""),
        "boots": [{"from": a, "to": b} for a, b in spans],
        **together(log.marks for log in logs).to_json(),
        "parameters": {n: v for log in logs for n, v in log.parameters.items()},
        "notes": [note for log in logs for note in log.notes],
    }


def _span(log: Log) -> tuple[float, float]:
    times = [s.time[np.isfinite(s.time)] for s in log.series.values()]
    return min(float(t.min()) for t in times if t.size), max(float(t.max()) for t in times if t.size)
