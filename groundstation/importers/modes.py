"""Marks of an autopilot's log (modes, events, messages) in all formats, with the names of its flight modes.

Sources: ArduPilot `mode.h` of Plane, Copter and Rover; PX4 `vehicle_status.msg` (nav_state) and `px4_custom_mode.h`; ArduPilot
`AP_Logger/LogStructure.h` for MODE, MSG, ARM, EV and ERR; MAVLink common.xml for HEARTBEAT and STATUSTEXT.
"""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from daq.utilities.plain_words import one_line
from groundstation.flight.marks import LONGEST_TEXT, FlightMode, Mark, Marks, mode_changes
from groundstation.importers.series import TimeSeries

PLANE: Mapping[int, str] = {
    0: "MANUAL", 1: "CIRCLE", 2: "STABILIZE", 3: "TRAINING", 4: "ACRO", 5: "FBWA", 6: "FBWB",
    7: "CRUISE", 8: "AUTOTUNE", 10: "AUTO",
    11: "RTL", 12: "LOITER", 13: "TAKEOFF", 14: "AVOID_ADSB", 15: "GUIDED", 16: "INITIALISING", 17: "QSTABILIZE", 18: "QHOVER",
    19: "QLOITER", 20: "QLAND", 21: "QRTL", 22: "QAUTOTUNE", 23: "QACRO", 24: "THERMAL", 25: "LOITERALTQLAND", 26: "AUTOLAND",
}  # fmt: skip
COPTER: Mapping[int, str] = {
    0: "STABILIZE", 1: "ACRO", 2: "ALT_HOLD", 3: "AUTO", 4: "GUIDED", 5: "LOITER", 6: "RTL",
    7: "CIRCLE", 9: "LAND", 11: "DRIFT",
    13: "SPORT", 14: "FLIP", 15: "AUTOTUNE", 16: "POSHOLD", 17: "BRAKE", 18: "THROW", 19: "AVOID_ADSB", 20: "GUIDED_NOGPS",
    21: "SMART_RTL", 22: "FLOWHOLD", 23: "FOLLOW", 24: "ZIGZAG", 25: "SYSTEMID", 26: "AUTOROTATE", 27: "AUTO_RTL", 28: "TURTLE",
}  # fmt: skip
ROVER: Mapping[int, str] = {
    0: "MANUAL", 1: "ACRO", 3: "STEERING", 4: "HOLD", 5: "LOITER", 6: "FOLLOW", 7: "SIMPLE", 8: "DOCK", 9: "CIRCLE", 10: "AUTO",
    11: "RTL", 12: "SMART_RTL", 15: "GUIDED", 16: "INITIALISING",
}  # fmt: skip
PX4_NAVIGATION: Mapping[int, str] = {
    0: "MANUAL", 1: "ALTCTL", 2: "POSCTL", 3: "AUTO_MISSION", 4: "AUTO_LOITER", 5: "AUTO_RTL", 8: "ALTITUDE_CRUISE", 10: "ACRO",
    12: "DESCEND", 13: "TERMINATION", 14: "OFFBOARD", 15: "STABILIZED", 17: "AUTO_TAKEOFF",
    18: "AUTO_LAND", 19: "AUTO_FOLLOW_TARGET",
    20: "AUTO_PRECLAND", 21: "ORBIT", 22: "AUTO_VTOL_TAKEOFF",
}  # fmt: skip
_PX4_MAIN: Mapping[int, str] = {
    1: "MANUAL", 2: "ALTCTL", 3: "POSCTL", 4: "AUTO", 5: "ACRO", 6: "OFFBOARD", 7: "STABILIZED", 8: "RATTITUDE",
}  # fmt: skip
_PX4_AUTO: Mapping[int, str] = {
    1: "AUTO_READY", 2: "AUTO_TAKEOFF", 3: "AUTO_LOITER", 4: "AUTO_MISSION", 5: "AUTO_RTL",
    6: "AUTO_LAND", 8: "AUTO_FOLLOW_TARGET",
    9: "AUTO_PRECLAND",
}  # fmt: skip
_VEHICLES = {"ArduCopter": COPTER, "ArduRover": ROVER, "APMrover": ROVER, "Rover": ROVER}
"""Firmware in a log's first message -> names of its modes; those of PLANE for any other."""
_EVENTS: Mapping[int, str] = {
    10: "armed", 11: "disarmed", 15: "auto armed", 17: "land complete maybe", 18: "land complete",
    25: "home set", 28: "not landed",
}  # fmt: skip
_ERRORS: Mapping[int, str] = {
    2: "radio", 5: "failsafe of the radio", 6: "failsafe of the battery",
    8: "failsafe of the ground station", 9: "failsafe of the fence",
    11: "GPS", 12: "crash check", 16: "EKF check", 17: "failsafe of the EKF", 18: "barometer", 24: "EKF changed",
}  # fmt: skip
_QUADROTOR, _HELICOPTER, _ROVER_TYPE, _OTHER_COPTERS = 2, 4, 10, (13, 14, 15, 29, 35)
_PX4 = 12  # MAV_AUTOPILOT_PX4
_PX4_MAIN_AUTO = 4  # main mode that has the modes of _PX4_AUTO
_EVENTS_OF_ARMING = (10, 11)  # events that repeat an ARM message
ARMED = 128  # bit of HEARTBEAT.base_mode

Row = Mapping[str, object]


def mark_text(value: object) -> str:
    """Text of a field as one line, without padding."""
    raw = value.split(b"\0", 1)[0].decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
    return one_line(raw.strip(), LONGEST_TEXT)


def dataflash_marks(rows: Mapping[str, Sequence[tuple[float, Row]]], end: float) -> Marks:
    """Marks of an ArduPilot log. rows: message -> (time [s], fields) in order; end: time of its last sample [s]."""
    messages = tuple(Mark(t, mark_text(row.get("Message", ""))) for t, row in rows.get("MSG", ()) if row.get("Message"))
    names = next((m for name, m in _VEHICLES.items() for message in messages if message.text.startswith(name)), PLANE)
    modes = [(t, _mode(row, names)) for t, row in rows.get("MODE", ())]
    events = [
        *(Mark(t, "armed" if _number(row.get("ArmState")) else "disarmed") for t, row in rows.get("ARM", ())),
        *(
            Mark(t, _name(_EVENTS, row.get("Id"), "event"))
            for t, row in rows.get("EV", ())
            if not _repeats_arm(rows, row)
        ),
        *(
            Mark(t, f"error: {_name(_ERRORS, row.get('Subsys'), 'subsystem')}, code {mark_text(row.get('ECode', ''))}")
            for t, row in rows.get("ERR", ())
        ),
    ]
    changed_modes = mode_changes([t for t, _ in modes], [n for _, n in modes], end)
    return Marks(changed_modes, tuple(sorted(events, key=lambda m: m.time)), messages)


def _repeats_arm(rows: Mapping[str, Sequence[tuple[float, Row]]], row: Row) -> bool:
    """Whether an event repeats an ARM message of the log."""
    return "ARM" in rows and _number(row.get("Id")) in _EVENTS_OF_ARMING


def _mode(row: Row, names: Mapping[int, str]) -> str:
    """The mode of a MODE message, which has a number in a binary log, and in some text logs a name."""
    value = row.get("ModeNum", row.get("Mode"))
    number = _number(value)
    return mark_text(row.get("Mode", "")) or "unknown" if number is None else names.get(number, f"mode {number}")


def _number(value: object) -> int | None:
    """A field as an integer; None where it is no number."""
    try:
        return round(float(value))  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return None


def _name(names: Mapping[int, str], value: object, kind: str) -> str:
    """The name of a number; `kind` and the value for an unknown one."""
    number = _number(value)
    return names.get(-1 if number is None else number, f"{kind} {mark_text(value)}")


def heartbeat_mode(vehicle: int, autopilot: int, custom: int) -> str:
    """The name of the mode that a HEARTBEAT states."""
    if autopilot == _PX4:
        main, sub = custom >> 16 & 0xFF, custom >> 24 & 0xFF
        return _PX4_AUTO.get(sub, "AUTO") if main == _PX4_MAIN_AUTO else _PX4_MAIN.get(main, f"mode {main}")
    copter = vehicle in (_QUADROTOR, _HELICOPTER, *_OTHER_COPTERS)
    names = COPTER if copter else ROVER if vehicle == _ROVER_TYPE else PLANE
    return names.get(custom, f"mode {custom}")


def armings(time: Iterable[float], armed: Iterable[bool]) -> tuple[Mark, ...]:
    """An event "armed" or "disarmed" for the first state and each change. time: [s]; armed: at these times."""
    states = mode_changes(time, ("armed" if a else "disarmed" for a in armed), 0.0)
    return tuple(Mark(m.start, m.name) for m in states)


PX4_ARMED = 2  # vehicle_status.arming_state ARMING_STATE_ARMED


def px4_marks(series: Mapping[str, TimeSeries], messages: Iterable[Mark] = ()) -> Marks:
    """Modes and arming from PX4's vehicle_status, with the logged messages."""
    mode, arming = series.get("vehicle_status.nav_state"), series.get("vehicle_status.arming_state")
    modes: tuple[FlightMode, ...] = ()
    if mode is not None:
        names = [PX4_NAVIGATION.get(int(n), f"mode {n:g}") if np.isfinite(n) else "unknown" for n in mode.values]
        modes = mode_changes(mode.time.tolist(), names, max(float(s.time[-1]) for s in series.values()))
    events = armings(arming.time.tolist(), (arming.values == PX4_ARMED).tolist()) if arming is not None else ()
    return Marks(modes, events, tuple(messages))
