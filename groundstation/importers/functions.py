"""ArduPilot's SERVOn_FUNCTION by name, and mappings that derive a surface from an output with another function.

Source: ArduPilot, SRV_Channel.h, `SRV_Channel::Function`.
"""

import re
from collections.abc import Iterator, Mapping

from groundstation.flight.contradictions import Contradiction
from groundstation.importers.mapping import Map
from groundstation.importers.series import Log
from groundstation.importers.servos import PREFIX, parameter_of

NAMES: Mapping[int, str] = {
    0: "disabled", 1: "RC passed through", 2: "flap", 3: "flap auto", 4: "aileron", 6: "mount pan", 7: "mount tilt",
    8: "mount roll", 9: "mount open", 10: "camera trigger", 16: "differential spoiler left 1",
    17: "differential spoiler right 1", 19: "elevator", 21: "rudder",
    24: "flaperon left", 25: "flaperon right", 26: "ground steering", 27: "parachute", 28: "gripper",
    29: "landing gear", 41: "motor tilt", 67: "tricopter tail", 70: "throttle", 73: "throttle left", 74: "throttle right",
    75: "motor tilt left", 76: "motor tilt right", 77: "elevon left", 78: "elevon right", 79: "V-tail left", 80: "V-tail right",
    86: "differential spoiler left 2", 87: "differential spoiler right 2", 110: "airbrake",
    **{32 + n: f"motor {n}" for n in range(1, 9)}, **{73 + n: f"motor {n}" for n in range(9, 13)},
    **{50 + n: f"RC {n} passed through" for n in range(1, 17)},
}  # fmt: skip

_FUNCTIONS_BY_SURFACE: Mapping[str, tuple[int, ...]] = {
    "delta_a": (4, 16, 17, 24, 25, 77, 78, 86, 87),
    "delta_e": (16, 17, 19, 77, 78, 79, 80, 86, 87),
    "delta_r": (16, 17, 21, 26, 79, 80, 86, 87),
}
"""Surface -> functions of the outputs that move it."""

OUTPUT = re.compile(
    r"RCOU\.C\d+|actuator_outputs(\[\d+\])?\.output\[\d+\]|actuator_servos\.control\[\d+\]"
    r"|SERVO_OUTPUT_RAW(\[\d+\])?\.servo\d+_raw|\S*/rc/out\.channels\[\d+\]"
)
"""ArduPilot's RCOU, PX4's actuator_outputs and actuator_servos, MAVLink's SERVO_OUTPUT_RAW, and its form in mavros."""
ENDINGS = ("FUNCTION", "MIN", "TRIM", "MAX", "REVERSED")  # ArduPilot's parameters of a servo output, SERVOn_
_PASSED_THROUGH = frozenset({1, *range(51, 67)})  # functions that pass on a stick: they do not name the surface


def function_name(function: float) -> str:
    """`elevon left` for 77; the number where it has no name here."""
    return NAMES.get(round(function), f"function {function:g}")


def function_contradictions(log: Log, mapping: Map) -> Iterator[Contradiction]:
    """Surfaces of a mapping that are derived from outputs which, by the log's parameters, move something else."""
    for column, sources in mapping.columns.items():
        if not column.startswith(("delta_", "cmd_")) or not sources:
            continue
        surface = f"delta_{column[-1]}"
        for term in sources[0].parts:
            name = term.column.removeprefix(PREFIX)
            output = mapping.servos[name].column if name in mapping.servos else term.column
            parameter = parameter_of(output, "FUNCTION")
            function = log.parameters.get(parameter) if parameter else None
            if (
                function is None
                or round(function) in _PASSED_THROUGH
                or round(function) in _FUNCTIONS_BY_SURFACE.get(surface, ())
            ):
                continue
            part = function_name(function)
            text = (
                f"the mapping makes {column} of {output}, which moves the {part} by {parameter} {function:g} of the log"
            )
            moves = f"derivatives by {column}: they would be those of the {part}"
            yield Contradiction((column, parameter or output), text, moves=moves, stops=True)
