"""Origin of a series: measured by a sensor, computed on board from other quantities, or assumed.

An autopilot logs its estimates beside its sensors, under names that do not show the difference. A computed quantity may be
accurate (attitude is always computed), but it is not a measurement.
"""

import re
from collections.abc import Iterable, Mapping

from groundstation.importers.mapping import Kind
from groundstation.importers.series import Log
from groundstation.importers.servos import PREFIX

MEASURED: Kind = "measured"
COMPUTED: Kind = "computed"
ASSUMED: Kind = "assumed"

_BY_NAME: Mapping[str, tuple[tuple[str, Kind], ...]] = {
    "dataflash": (
        (
            r"(ATT|AHR2|AHRS|AOA|CTUN|AETR|POS|ORGN|TECS|NTUN|VIBE|RCOU|NK[FQT]?\w*|XK\w*|EKF\w*|ANG|RATE|PID\w)(\[\d+\])?\..*",
            COMPUTED,
        ),
        (r"BARO(\[\d+\])?\.(Alt|CRt|SMS|Offset)|GPS(\[\d+\])?\.V[NE]", MEASURED),
        (r"(BARO|BAR2|BAR3)(\[\d+\])?\.(Temp|GndTemp)", ASSUMED),
    ),
    "tlog": (
        (
            r"(.*:)?(ATTITUDE\w*|AHRS\w*|GLOBAL_POSITION_INT\w*|LOCAL_POSITION\w*|VFR_HUD|AOA_SSA|WIND\w*|HIL_\w+|SIM\w*STATE"
            r"|ESTIMATOR_STATUS|NAV_CONTROLLER_OUTPUT|SERVO_OUTPUT_RAW|RC_CHANNELS_SCALED|ACTUATOR\w*|ALTITUDE)(\[\d+\])?\..*",
            COMPUTED,
        ),
        (r"(.*:)?(SCALED_PRESSURE\d?|HIGHRES_IMU)(\[\d+\])?\.temperature", ASSUMED),
    ),
    "ulog": (
        (
            r"(vehicle_attitude|vehicle_local_position|vehicle_global_position|vehicle_angular_velocity|vehicle_odometry|estimator_\w+"
            r"|wind\w*|airspeed_wind|ekf2_\w+|actuator_\w+|airspeed_validated|vehicle_thrust_setpoint\w*)(\[\d+\])?\..*",
            COMPUTED,
        ),
        (r"vehicle_air_data(\[\d+\])?\.(rho|eas2tas)", COMPUTED),
        (
            r"vehicle_air_data(\[\d+\])?\.(baro_temp_celcius|ambient_temperature)|sensor_baro(\[\d+\])?\.temperature",
            ASSUMED,
        ),
    ),
}
"""Format -> patterns of series and their origin: the first match counts. Series without a match are measured."""
_COMPILED = {kind: tuple((re.compile(p), k) for p, k in rows) for kind, rows in _BY_NAME.items()}

_COMPUTED_NAME = re.compile(
    r"(?i)(^|[._ /])(ekf\d?|estimat\w*|filtered|fused|synthetic|setpoint|predicted|reconstructed)([._ /]|$)"
)
"""Names in tables by which a column is computed."""

_COMMANDS = re.compile(
    r"(.*:)?(RCOU\d?|RCO2|RCO3|RCIN|AETR|SERVO_OUTPUT_RAW|RC_CHANNELS\w*|ACTUATOR\w*|actuator_(outputs|servos|controls|motors)\w*"
    r"|input_rc|manual_control_setpoint|vehicle_(torque|thrust)_setpoint)(\[\d+\])?\..*"
)
"""Series of commands to servos and motors, by a pilot or a program."""


def is_command(log: Log, series: str) -> bool:
    """Whether a series is a command, which holds between samples and has no noise."""
    return log.series[series].command or _COMMANDS.fullmatch(series) is not None


_BY_QUALITY: tuple[Kind, ...] = (MEASURED, COMPUTED, ASSUMED)  # the best first

AIR_RELATIVE = ("V", "V_cas", "alpha", "beta")
"""Columns of motion relative to the air. Computed ones follow from attitude, ground velocity and an estimated wind, and add no
information."""


def kind_of(log: Log, series: str) -> Kind:
    """Origin of a series of a log."""
    log_kind = log.kinds.get(series)
    if log_kind is not None:
        return next(k for k in _BY_QUALITY if k == log_kind)
    if series.startswith(PREFIX):
        return COMPUTED  # a surface computed from its command
    if log.kind in _COMPILED:
        return next((kind for pattern, kind in _COMPILED[log.kind] if pattern.fullmatch(series)), MEASURED)
    return COMPUTED if _COMPUTED_NAME.search(series) else MEASURED


def kind_of_all(log: Log, series: Iterable[str]) -> Kind:
    """Origin of a column that is calculated from several series: the least certain of theirs."""
    return max((kind_of(log, name) for name in series), key=_BY_QUALITY.index, default=ASSUMED)
