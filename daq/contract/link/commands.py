"""The commands of the uplink and their numbers (MAVLink common MAV_CMD and MAV_RESULT)."""

import re

SET_MESSAGE_INTERVAL = 511
"""Set the downlink rate: parameter 1 the id of SCAN_FAST, parameter 2 the interval [us], 0 for the configured one."""
PREFLIGHT_CALIBRATION = 241
"""Zero the pitot: parameter 6 = 2 (airspeed calibration), all others 0."""
LOGGING_START = 2510
LOGGING_STOP = 2511
EVENT_MARK = 31010
"""MAV_CMD_USER_1: mark an event; parameter 1 is its number, chosen by the ground, and makes it unique."""

SEQUENCER = 31011
"""MAV_CMD_USER_2: parameter 1 = 1 starts the armed manoeuvre whose digest begins with the 24 bits of parameter 2 (signed
frames only), 0 stops what is under way."""

KNOWN = (SET_MESSAGE_INTERVAL, PREFLIGHT_CALIBRATION, LOGGING_START, LOGGING_STOP, EVENT_MARK, SEQUENCER)

AIRSPEED_PARAMETER = 6
AIRSPEED_CALIBRATION = 2.0

ACCEPTED = 0
TEMPORARILY_REJECTED = 1
DENIED = 2
UNSUPPORTED = 3
FAILED = 4
COMMAND_LONG_ONLY = 7

RESULT_WORDS = {
    ACCEPTED: "accepted",
    TEMPORARILY_REJECTED: "temporarily rejected",
    DENIED: "denied",
    UNSUPPORTED: "unsupported",
    FAILED: "failed",
    COMMAND_LONG_ONLY: "to be sent as COMMAND_LONG",
}

_PITOT_ZERO = re.compile(r"pitot_zero count=([0-9]{1,9}(?:\.[0-9]{1,9})?) scans=([0-9]{1,9})")


def pitot_zero_text(count: float, scans: int) -> str:
    """Text of the event that records a pitot zero: mean raw count over so many scans at rest."""
    return f"pitot_zero count={count:.3f} scans={scans}"


def parse_pitot_zero(text: str) -> float | None:
    """Mean raw count of a pitot zero event; None for any other text."""
    match = _PITOT_ZERO.fullmatch(text)
    return float(match[1]) if match else None
