"""Who made the numbers of a series: a sensor, a program of the aircraft that computes them of others, or nobody that measured.

An autopilot logs its own estimates beside its sensors, under names that do not say so. What is computed may be good (attitude
is all the attitude there is), but it is never a measurement.
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
"""Format -> patterns of series and what they are; the first that fits counts. All others of a log are sensors' own."""
_COMPILED = {kind: tuple((re.compile(p), k) for p, k in rows) for kind, rows in _BY_NAME.items()}

_SAYS_SO = re.compile(
    r"(?i)(^|[._ /])(ekf\d?|estimat\w*|filtered|fused|synthetic|setpoint|predicted|reconstructed)([._ /]|$)"
)
"""Names in tables that say themselves that a program made them."""

_COMMANDS = re.compile(
    r"(.*:)?(RCOU\d?|RCO2|RCO3|RCIN|AETR|SERVO_OUTPUT_RAW|RC_CHANNELS\w*|ACTUATOR\w*|actuator_(outputs|servos|controls|motors)\w*"
    r"|input_rc|manual_control_setpoint|vehicle_(torque|thrust)_setpoint)(\[\d+\])?\..*"
)
"""Series of what was asked of servos and motors, by a person or a program."""


def is_command(log: Log, series: str) -> bool:
    """Whether a series is a command, which holds until the next one and has no noise."""
    return log.series[series].command or _COMMANDS.fullmatch(series) is not None


_WORST: tuple[Kind, ...] = (MEASURED, COMPUTED, ASSUMED)

NOT_FLOWN = ("V", "V_cas", "alpha", "beta")
"""Columns that tell the air from the ground only where a sensor in the air measured them: computed ones are made of attitude and
velocity with a wind that was guessed, and add nothing but that guess."""


def kind_of(log: Log, series: str) -> Kind:
    """What a series of a log is."""
    log_kind = log.kinds.get(series)
    if log_kind is not None:
        return next(k for k in _WORST if k == log_kind)
    if series.startswith(PREFIX):
        return COMPUTED  # what was commanded, whatever the surface does
    if log.kind in _COMPILED:
        return next((kind for pattern, kind in _COMPILED[log.kind] if pattern.fullmatch(series)), MEASURED)
    return COMPUTED if _SAYS_SO.search(series) else MEASURED


def kind_of_all(log: Log, series: Iterable[str]) -> Kind:
    """What becomes of several: as sure as the worst of them."""
    return max((kind_of(log, name) for name in series), key=_WORST.index, default=ASSUMED)
