"""Answers that general ground stations wait for: no missions here, one parameter to read, commands in one form only.

Without them such a station goes on asking, and tells its user that the aircraft does not respond.
"""

from collections.abc import Callable, Mapping
from typing import Any

from daq.contract.link import commands as c
from daq.telemetry.send_queue import Item, item

PARAMETER = "DOWNLINK_RATE"
_REAL32 = 9
REQUESTS = ("PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET", "MISSION_REQUEST_LIST", "COMMAND_INT")


def answer(name: str, fields: Mapping[str, Any], sender: tuple[int, int], rate_hz: Callable[[], float]) -> Item | None:
    """The answer to one of REQUESTS from `sender` (system, component); None where none is due."""
    system, component = sender
    target = {"target_system": system, "target_component": component}
    match name:
        case "MISSION_REQUEST_LIST":
            return item("MISSION_COUNT", **target, count=0, mission_type=fields["mission_type"])
        case "COMMAND_INT":
            command = int(fields["command"])
            result = c.COMMAND_LONG_ONLY if command in c.KNOWN else c.UNSUPPORTED
            return item("COMMAND_ACK", **target, command=command, result=result)
        case "PARAM_REQUEST_READ" if fields["param_index"] > 0:
            return None
        case "PARAM_REQUEST_READ" if fields["param_index"] < 0 and fields["param_id"] != PARAMETER:
            return None
    # A parameter that is only to be read answers an attempt to set it with what it is.
    return item(
        "PARAM_VALUE", param_id=PARAMETER, param_value=rate_hz(), param_type=_REAL32, param_count=1, param_index=0
    )
