"""What an autopilot's log says of its own sensors: which was in use, whether it measured at all, and when it did not."""

import re
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from groundstation.importers.instances import with_primaries
from groundstation.importers.series import Array, Log, TimeSeries

FIX_3D = 3
"""Type of a GNSS fix, of ArduPilot's Status as of MAVLink's and PX4's fix_type, from which it has a velocity."""
BY_SENSOR = (1, 4)
"""ArduPilot's AirspeedEstimateType: a sensor, or its simulator's; 0 none that is new, 2 and 3 synthetic."""
PX4_SENSORS = (1, 2, 3)
"""PX4's airspeed_source (and selected_airspeed_index before it): a sensor; 0 ground speed less wind, 4 synthetic, -1 none."""
Mask = NDArray[np.bool_]


def of_ardupilot(log: Log) -> Log:
    """A dataflash log with the sensors in use under the plain names, without fixes that are none, and with whence airspeed is."""
    chosen = with_primaries(log.series)
    series, notes = dict(chosen.series), [*log.notes, *chosen.notes]
    for prefix in _prefixes(series, "GPS", "Status"):
        fields = ("Spd", "GCrs", "VZ", "VN", "VE", "Lat", "Lng", "Alt")
        notes += _without_fix(series, prefix, "Status", fields)
    if "ARSP.Temp" in series and not np.any(series["ARSP.Temp"].values):
        del series["ARSP.Temp"]  # nothing but zeros: a sensor without a thermometer
    kinds = dict(log.kinds)
    kinds["CTUN.As"], said = _airspeed_of_ardupilot(replace(log, series=series), series)
    seen = (*log.contradictions, *chosen.contradictions)
    return replace(log, series=series, notes=(*notes, *said), kinds=kinds, contradictions=seen)


def _airspeed_of_ardupilot(log: Log, series: dict[str, TimeSeries]) -> tuple[str, list[str]]:
    """What CTUN.As is; samples of it that no sensor made are taken out where others are of one."""
    speed = series.get("CTUN.As")
    if speed is None:
        return "measured", []
    source = series.get("CTUN.AsT")
    if source is not None:
        by_sensor = np.isin(source.values, BY_SENSOR)
        if not by_sensor.any():
            told = ", ".join(f"{v:g}" for v in np.unique(source.values)[:4])
            return "computed", [
                f"CTUN.As is not of a pitot (AsT {told}): an estimate of the autopilot, not a measurement"
            ]
        if not by_sensor.all():
            series["CTUN.As"] = _only(speed, by_sensor)
            return "measured", [f"CTUN.As: {int((~by_sensor).sum())} samples that no pitot made (AsT) left out"]
        return "measured", []
    used, health = (_mean(series, *(f"ARSP.{n}" for n in names)) for names in (("U", "Use"), ("H", "Health")))
    if "ARSP.DiffPress" in series or "ARSP.Airspeed" in series:
        if used is not None and used < 0.5:
            return "computed", ["CTUN.As is not of the pitot, which the autopilot does not use (ARSP.U 0)"]
        if health is not None and health < 0.5:
            return "computed", ["CTUN.As is not of the pitot, which the autopilot finds unhealthy (ARSP.H 0)"]
        return "measured", []
    if any(log.parameters.get(name, 0.0) > 0.0 for name in ("ARSPD_TYPE", "ARSPD_ENABLE")):
        return "measured", []
    return "assumed", ["nothing in the log says that a pitot measured CTUN.As (no ARSP, no AsT)"]


def of_px4(log: Log) -> Log:
    """A ULog without fixes that are none, and with whence the validated airspeed is."""
    series, notes, kinds = dict(log.series), list(log.notes), dict(log.kinds)
    for topic in ("vehicle_gps_position", "sensor_gps"):
        for prefix in _prefixes(series, topic, "fix_type"):
            fields = [n.removeprefix(f"{prefix}.") for n in series if n.startswith(f"{prefix}.")]
            moved = [f for f in fields if re.match(r"vel_|lat|lon|alt|cog_|altitude_", f)]
            notes += _without_fix(series, prefix, "fix_type", moved)
    for prefix in _prefixes(series, "airspeed_validated", "true_airspeed_m_s"):
        source = series.get(f"{prefix}.airspeed_source", series.get(f"{prefix}.selected_airspeed_index"))
        names = [f"{prefix}.{n}_airspeed_m_s" for n in ("true", "calibrated", "indicated")]
        present = [n for n in names if n in series]
        if source is None:
            kinds |= dict.fromkeys(present, "measured" if _has_pitot(series) else "assumed")
            continue
        by_sensor = np.isin(source.values, PX4_SENSORS)
        if not by_sensor.any():
            kinds |= dict.fromkeys(present, "computed")
            told = ", ".join(f"{v:g}" for v in np.unique(source.values)[:4])
            notes.append(
                f"{prefix} is not of a pitot (airspeed_source {told}): ground speed less a guessed wind, or synthetic"
            )
            continue
        kinds |= dict.fromkeys(present, "measured")
        if not by_sensor.all():
            series |= {n: _only(series[n], by_sensor) for n in present}
            notes.append(f"{prefix}: {int((~by_sensor).sum())} samples that no pitot made (airspeed_source) left out")
    return replace(log, series=series, notes=tuple(notes), kinds=kinds)


def _has_pitot(series: Mapping[str, TimeSeries]) -> bool:
    return any(n.startswith(("differential_pressure.", "airspeed.")) for n in series)


_DIFFERENTIAL = ("SCALED_PRESSURE.press_diff", "HIGHRES_IMU.diff_pressure", "RAW_PRESSURE.press_diff1")
PITOT_BIT = 16
"""MAV_SYS_STATUS_SENSOR_DIFFERENTIAL_PRESSURE, in SYS_STATUS.onboard_control_sensors_*."""


def of_mavlink(log: Log) -> Log:
    """A telemetry log with whence VFR_HUD.airspeed is: a pitot's pressure that moves, or what the autopilot says it has."""
    series, notes, kinds = dict(log.series), list(log.notes), dict(log.kinds)
    for prefix in _prefixes(series, "GPS_RAW_INT", "fix_type"):
        notes += _without_fix(series, prefix, "fix_type", ("vel", "cog"))
    if "VFR_HUD.airspeed" in series:
        kind, said = _airspeed_of_mavlink(series)
        kinds["VFR_HUD.airspeed"] = kind
        notes += said
    return replace(log, series=series, notes=tuple(notes), kinds=kinds)


def _airspeed_of_mavlink(series: Mapping[str, TimeSeries]) -> tuple[str, list[str]]:
    health = series.get("SYS_STATUS.onboard_control_sensors_present")
    enabled = series.get("SYS_STATUS.onboard_control_sensors_enabled")
    pressures = [series[n].values for n in _DIFFERENTIAL if n in series]
    moving = any(
        float(np.nanmax(np.abs(p - np.nanmedian(p)), initial=0.0)) > 0.0 and np.nanmax(np.abs(p)) > 0.0
        for p in pressures
    )
    if pressures and not moving:
        return "computed", ["VFR_HUD.airspeed is not of a pitot: the differential pressure never moves"]
    for words in (health, enabled):
        if words is not None and not (words.values.astype(np.int64) & PITOT_BIT).any():
            return "computed", ["VFR_HUD.airspeed is not of a pitot: SYS_STATUS has none"]
    if moving or health is not None:
        return "measured", []
    return "assumed", [
        "nothing in the log says that a pitot measured VFR_HUD.airspeed (no differential pressure, no SYS_STATUS)"
    ]


def _prefixes(series: Mapping[str, TimeSeries], topic: str, field: str) -> list[str]:
    """A topic and its further instances that have a field."""
    pattern = re.compile(re.escape(topic) + r"(\[\d+\])?\." + re.escape(field))
    return [n.rsplit(".", 1)[0] for n in series if pattern.fullmatch(n)]


def _without_fix(
    series: dict[str, TimeSeries], prefix: str, status: str, fields: tuple[str, ...] | list[str]
) -> list[str]:
    """Takes out what a receiver wrote while it had no fix: zeros are no velocities. Gives a note where there was any."""
    fix = series[f"{prefix}.{status}"]
    good = fix.values >= FIX_3D
    if good.all():
        return []
    for name in (f"{prefix}.{f}" for f in fields):
        if name in series and series[name].time.size == good.size:
            series[name] = _blank(series[name], good)
    return [f"{prefix}: {int((~good).sum())} samples without a fix ({status} below {FIX_3D}) taken as not measured"]


def _only(series: TimeSeries, use: Mask) -> TimeSeries:
    return _blank(series, use) if series.time.size == use.size else series


def _blank(series: TimeSeries, use: Mask) -> TimeSeries:
    values: Array = np.where(use, series.values, np.nan)
    return TimeSeries(series.time, values)


def _mean(series: Mapping[str, TimeSeries], *names: str) -> float | None:
    found = next((series[n].values for n in names if n in series), None)
    return float(np.nanmean(found)) if found is not None and found.size else None


EVIDENCE: Mapping[str, Callable[[Log], Log]] = {"dataflash": of_ardupilot, "ulog": of_px4, "tlog": of_mavlink}
"""Kind of a log -> what is made of its own word."""
