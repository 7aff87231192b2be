"""Answers that standard ground stations expect: no missions, no files, one or two read-only parameters.

Without them such a station repeats its requests and reports that the aircraft does not respond. A refusal is the protocol's own.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from daq.contract.link import commands as c
from daq.telemetry.send_queue import Item, item
from daq.transport.mavlink_codec import message_types

RATE_PARAMETER = "DOWNLINK_RATE"
BATTERY_PARAMETER = "BATT_MONITOR"
"""MAVProxy shows a battery where this parameter is set."""
_VOLTAGE_ONLY = 3.0  # ArduPilot: analog voltage without current
_REAL32 = 9  # MAV_PARAM_TYPE_REAL32
_DOES_NOT_EXIST, _READ_ONLY = 1, 5  # MAV_PARAM_ERROR

_MISSION_DONE, _MISSION_UNSUPPORTED, _NO_SUCH_ITEM = 0, 3, 13  # MAV_MISSION_RESULT

# MAVLink FTP: offset of the data in a payload, opcodes, error codes
_FTP_DATA_AT = 12
_ACK, _NAK = 128, 129
_CLOSE_SESSION, _CLOSE_ALL, _LIST, _OPEN, _CHECKSUM = 1, 2, 3, 4, 14
_END, _UNKNOWN_COMMAND, _NOT_FOUND = 6, 7, 10
_FTP_REFUSALS = {_LIST: _END, _OPEN: _NOT_FOUND, _CHECKSUM: _NOT_FOUND}

Fields = Mapping[str, Any]
Parameters = Mapping[str, float]
Reply = Callable[[Fields, Mapping[str, int], Parameters], Sequence[Item]]
"""Answers to a request from its fields, the fields that address the sender, and the parameters."""


def parameters(rate_hz: float, has_voltage: bool) -> Parameters:
    """All parameters and their values, in order of index; they can be read only. rate_hz: of the downlink. has_voltage: whether
    a supply voltage is sent."""
    return {RATE_PARAMETER: rate_hz, **({BATTERY_PARAMETER: _VOLTAGE_ONLY} if has_voltage else {})}


def answers(name: str, fields: Fields, sender: tuple[int, int], values: Parameters) -> Sequence[Item]:
    """The answers to one of REQUESTS from `sender` (system, component). values: of the parameters."""
    target = {"target_system": sender[0], "target_component": sender[1]}
    return REQUESTS[name](fields, target, values)


def _all_parameters(fields: Fields, target: Mapping[str, int], values: Parameters) -> Sequence[Item]:
    return [_parameter(values, name) for name in values]


def _one_parameter(fields: Fields, target: Mapping[str, int], values: Parameters) -> Sequence[Item]:
    index = fields["param_index"]
    name = fields["param_id"] if index < 0 else next((n for i, n in enumerate(values) if i == index), "")
    if name in values:
        return [_parameter(values, name)]
    return [_parameter_error(fields["param_id"], index, _DOES_NOT_EXIST, target)]


def _set_parameter(fields: Fields, target: Mapping[str, int], values: Parameters) -> Sequence[Item]:
    name = fields["param_id"]
    if name not in values:
        return [_parameter_error(name, -1, _DOES_NOT_EXIST, target)]
    # stations that do not know PARAM_ERROR see by the unchanged value that it was not set
    return [_parameter(values, name), _parameter_error(name, -1, _READ_ONLY, target)]


def _parameter(values: Mapping[str, float], name: str) -> Item:
    return item(
        "PARAM_VALUE",
        param_id=name,
        param_value=values[name],
        param_type=_REAL32,
        param_count=len(values),
        param_index=list(values).index(name),
    )


def _parameter_error(name: str, index: int, error: int, target: Mapping[str, int]) -> Item:
    return item("PARAM_ERROR", **target, param_id=name, param_index=max(-1, index), error=error)


def _no_mission(fields: Fields, target: Mapping[str, int], values: Parameters) -> Sequence[Item]:
    return [item("MISSION_COUNT", **target, count=0, mission_type=fields["mission_type"])]


def _mission_answer(result: int) -> Reply:
    return lambda fields, target, _: [item("MISSION_ACK", **target, type=result, mission_type=fields["mission_type"])]


def _no_file(fields: Fields, target: Mapping[str, int], values: Parameters) -> Sequence[Item]:
    """FTP without files: a listing ends at once, nothing can be opened, and closing always succeeds."""
    payload = bytes(fields["payload"])
    sequence = int.from_bytes(payload[:2], "little")
    session, opcode = payload[2], payload[3]
    if opcode in (_ACK, _NAK):
        return []
    is_close = opcode in (_CLOSE_SESSION, _CLOSE_ALL)
    data = b"" if is_close else bytes([_FTP_REFUSALS.get(opcode, _UNKNOWN_COMMAND)])
    head = (sequence + 1) % 2**16
    reply = head.to_bytes(2, "little") + bytes([session, _ACK if is_close else _NAK, len(data), opcode])
    return [item("FILE_TRANSFER_PROTOCOL", **target, payload=reply.ljust(_FTP_DATA_AT, b"\0") + data)]


def _no_command_int(fields: Fields, target: Mapping[str, int], values: Parameters) -> Sequence[Item]:
    command = int(fields["command"])
    result = c.COMMAND_LONG_ONLY if command in (*c.KNOWN, *MESSAGE_COMMANDS) else c.UNSUPPORTED
    return [item("COMMAND_ACK", **target, command=command, result=result)]


REQUESTS: Mapping[str, Reply] = {
    "PARAM_REQUEST_LIST": _all_parameters,
    "PARAM_REQUEST_READ": _one_parameter,
    "PARAM_SET": _set_parameter,
    "MISSION_REQUEST_LIST": _no_mission,
    "MISSION_REQUEST": _mission_answer(_NO_SUCH_ITEM),
    "MISSION_REQUEST_INT": _mission_answer(_NO_SUCH_ITEM),
    "MISSION_COUNT": _mission_answer(_MISSION_UNSUPPORTED),
    "MISSION_WRITE_PARTIAL_LIST": _mission_answer(_MISSION_UNSUPPORTED),
    "MISSION_CLEAR_ALL": _mission_answer(_MISSION_DONE),
    "FILE_TRANSFER_PROTOCOL": _no_file,
    "COMMAND_INT": _no_command_int,
}

# Commands that request a message, and its name (None: the id is in parameter 1).
_GET_HOME_POSITION, _REQUEST_MESSAGE = 410, 512
MESSAGE_COMMANDS: Mapping[int, str | None] = {_GET_HOME_POSITION: "HOME_POSITION", _REQUEST_MESSAGE: None}


def requested_message(command: int, parameter: float) -> str | None:
    """The name of the message that one of MESSAGE_COMMANDS requests; None for one that the dialect lacks."""
    fixed_name = MESSAGE_COMMANDS[command]
    if fixed_name is not None:
        return fixed_name
    message_type = message_types().get(int(parameter)) if parameter.is_integer() else None
    return None if message_type is None else message_type.name
