"""Contents of another program's log: for `sideslip info`, and its servo outputs for a person who writes a mapping."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.flight.marks import joined_marks
from groundstation.importers.endings import BAGS, LOGS
from groundstation.importers.formats.bags import is_bag
from groundstation.importers.formats.dataflash import HEAD, is_text
from groundstation.importers.functions import ENDINGS, OUTPUT, function_name
from groundstation.importers.run import read_logs
from groundstation.importers.series import Log, native_rate
from groundstation.importers.servos import parameter_of

_HEAD_BYTES = 64  # of a file, by which a dataflash log is recognised


def is_foreign_log(path: Path) -> bool:
    """Whether a path is a bag (file or folder) or an autopilot's log: by its ending; .bin and .log, which other programs write
    too, by their first bytes."""
    suffix = path.suffix.lower()
    if suffix in BAGS or path.is_dir():
        return is_bag(path)
    if suffix not in LOGS or not path.is_file():
        return False
    if LOGS[suffix] != "ardupilot":
        return True
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    return head.startswith(HEAD) or is_text(head)


def log_info(path: Path) -> dict[str, Any]:
    """The answer of `info --json`. Raises ImportDataError for a log that cannot be read."""
    logs = [log for log, _ in read_logs(path)]
    spans = [_span(log) for log in logs]
    fastest = max(native_rate(s) for log in logs for s in log.series.values())
    samples: dict[str, int] = {}
    for log in logs:
        for name, series in log.series.items():
            samples[name] = samples.get(name, 0) + int(np.isfinite(series.values).sum())
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
        "channels": [{"name": n, "unit": logs[0].units.get(n, ""), "samples": c} for n, c in samples.items()],
        "software": logs[0].detail.get("firmware", ""),
        "boots": [{"from": a, "to": b} for a, b in spans],
        **joined_marks(log.marks for log in logs).to_json(),
        "parameters": {n: v for log in logs for n, v in log.parameters.items()},
        "notes": [note for log in logs for note in log.notes],
    }


def _span(log: Log) -> tuple[float, float]:
    """Earliest and latest time of the log's samples [s]."""
    times = [s.time[np.isfinite(s.time)] for s in log.series.values()]
    return min(float(t.min()) for t in times if t.size), max(float(t.max()) for t in times if t.size)


@dataclass(frozen=True, slots=True)
class ServoOutput:
    """A servo output that moves: least, largest and median output, in the log's own unit (us, or -1 to 1).

    parameters: those of the autopilot for this output (MIN, TRIM, MAX, REVERSED, FUNCTION), as far as the log has them.
    """

    name: str
    low: float
    high: float
    median: float
    parameters: Mapping[str, float] = field(default_factory=dict)

    def line(self) -> str:
        """The output and its parameters as one line of text."""
        text = f"{self.name}: {self.low:g} to {self.high:g}, most often {self.median:g}"
        words = [
            f"{n} {v:g}" + (f" ({function_name(v)})" if n == "FUNCTION" else "") for n, v in self.parameters.items()
        ]
        return f"{text}; its parameters say {', '.join(words)}" if words else text


def servo_outputs(path: Path) -> list[ServoOutput]:
    """The servo outputs of a log that move. Raises ImportDataError where it cannot be read."""
    outputs = []
    for log, _ in read_logs(path):
        for name, series in log.series.items():
            values = series.values[np.isfinite(series.values)]
            if OUTPUT.fullmatch(name) and values.size and np.ptp(values) > 0.0:
                labels = {ending: parameter_of(name, ending) or "" for ending in ENDINGS}
                parameters = {e: log.parameters[label] for e, label in labels.items() if label in log.parameters}
                low, high, median = float(values.min()), float(values.max()), float(np.median(values))
                outputs.append(ServoOutput(name, low, high, median, parameters))
    return outputs
