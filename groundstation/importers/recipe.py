"""Servo outputs that a log holds, for a person who writes a mapping for the surfaces."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from groundstation.importers.functions import name_of
from groundstation.importers.run import read_logs
from groundstation.importers.servos import parameter_of

OUTPUT = re.compile(
    r"RCOU\.C\d+|actuator_outputs(\[\d+\])?\.output\[\d+\]|actuator_servos\.control\[\d+\]|SERVOOUTPUT_RAW\.servo\d+_raw"
)
"""ArduPilot's RCOU, PX4's actuator_outputs and actuator_servos, MAVLink's SERVOOUTPUT_RAW."""


@dataclass(frozen=True, slots=True)
class ServoOutput:
    """A servo output that moves: least, largest and median output, in the log's own unit (us, or -1 to 1).

    stated: what the autopilot's parameters say of it (MIN, TRIM, MAX, REVERSED, FUNCTION), as far as the log has them.
    """

    name: str
    low: float
    high: float
    usual: float
    stated: Mapping[str, float] = field(default_factory=dict)

    def line(self) -> str:
        """For a person."""
        moved = f"{self.name}: {self.low:g} to {self.high:g}, most often {self.usual:g}"
        said = ", ".join(_told(ending, value) for ending, value in self.stated.items())
        return f"{moved}; its parameters say {said}" if said else moved


def _told(ending: str, value: float) -> str:
    return f"{ending} {value:g} ({name_of(value)})" if ending == "FUNCTION" else f"{ending} {value:g}"


ENDINGS = ("FUNCTION", "MIN", "TRIM", "MAX", "REVERSED")  # ArduPilot's parameters of a servo output, SERVOn_


def servo_outputs(path: Path) -> list[ServoOutput]:
    """The servo outputs of a log that move. Raises ImportDataError where it cannot be read."""
    found = []
    for log, _ in read_logs(path):
        for name, series in log.series.items():
            known = series.values[np.isfinite(series.values)]
            if OUTPUT.fullmatch(name) and known.size and np.ptp(known) > 0.0:
                low, high, usual = float(known.min()), float(known.max()), float(np.median(known))
                found.append(ServoOutput(name, low, high, usual, _stated(name, log.parameters)))
    return found


def _stated(output: str, parameters: Mapping[str, float]) -> dict[str, float]:
    named = [(ending, parameter_of(output, ending)) for ending in ENDINGS]
    return {ending: parameters[name] for ending, name in named if name is not None and name in parameters}
