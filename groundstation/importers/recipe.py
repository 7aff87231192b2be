"""Servo outputs that a log holds, for a person who writes a mapping for the surfaces."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from groundstation.importers.run import read_logs

_OUTPUT = re.compile(
    r"RCOU\.C\d+|actuator_outputs(\[\d+\])?\.output\[\d+\]|actuator_servos\.control\[\d+\]|SERVO_OUTPUT_RAW\.servo\d+_raw"
)
"""ArduPilot's RCOU, PX4's actuator_outputs and actuator_servos, MAVLink's SERVO_OUTPUT_RAW."""


@dataclass(frozen=True, slots=True)
class ServoOutput:
    """A servo output that moves: least, largest and median output, in the log's own unit (us, or -1 to 1)."""

    name: str
    low: float
    high: float
    usual: float


def servo_outputs(path: Path) -> list[ServoOutput]:
    """The servo outputs of a log that move. Raises ImportDataError where it cannot be read."""
    found = []
    for log, _ in read_logs(path):
        for name, series in log.series.items():
            known = series.values[np.isfinite(series.values)]
            if _OUTPUT.fullmatch(name) and known.size and np.ptp(known) > 0.0:
                found.append(ServoOutput(name, float(known.min()), float(known.max()), float(np.median(known))))
    return found
