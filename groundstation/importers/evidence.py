"""Facts on the sensors from an autopilot's log: which was in use, whether the airspeed is measured, and when there was no fix."""

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from math import pi, sqrt

import numpy as np

from groundstation.flight.arrays import Mask
from groundstation.importers.instances import MAJORITY, mean_of_first, with_primaries
from groundstation.importers.series import Log, TimeSeries

FIX_3D = 3  # least ArduPilot Status, or MAVLink and PX4 fix_type, of a fix with a velocity
ARDUPILOT_SENSORS = (1, 4)
"""ArduPilot's AirspeedEstimateType: 1 a sensor, 4 a simulated one; 0 is no new value, 2 and 3 are synthetic."""
PX4_SENSORS = (1, 2, 3)
"""PX4's airspeed_source (earlier selected_airspeed_index) of a sensor; 0 is ground speed less wind, 4 synthetic, -1 none."""
PITOT_BIT = 16  # MAV_SYS_STATUS_SENSOR_DIFFERENTIAL_PRESSURE, in SYS_STATUS.onboard_control_sensors_*
_LOW_PASSED = (
    (re.compile(r"IMU(\[\d+\])?\.Gyr[XYZ]"), "INS_GYRO_FILTER"),
    (re.compile(r"IMU(\[\d+\])?\.Acc[XYZ]"), "INS_ACCEL_FILTER"),
    (re.compile(r"vehicle_angular_velocity(\[\d+\])?\.xyz\[\d\]"), "IMU_GYRO_CUTOFF"),
    (re.compile(r"vehicle_acceleration(\[\d+\])?\.xyz\[\d\]"), "IMU_ACCEL_CUTOFF"),
)
"""Series that are logged after a low pass, and the parameter with its cut-off frequency [Hz]. It is a Butterworth filter of
second order (ArduPilot and PX4: LowPassFilter2p). Attitude, GYR, ACC and sensor_combined are not filtered."""
LEAST_CUTOFF = 2.0
"""[Hz] of a cut-off frequency: below it the parameter has another meaning, or the filter also attenuates the motion."""
FAST_SHARE = 0.5  # of the highest airspeed, above which the sign of the differential pressure is certain
_PITOT_FLAGS = (
    ("U", "Use", "which the autopilot does not use"),
    ("H", "Health", "which the autopilot finds unhealthy"),
)
"""Flags of ARSP, by their short and long name, and what it means where they are mostly 0."""
_DIFFERENTIAL = ("SCALED_PRESSURE.press_diff", "HIGHRES_IMU.diff_pressure", "RAW_PRESSURE.press_diff1")


def of_ardupilot(log: Log) -> Log:
    """A dataflash log with the sensors in use under names without a number, NaN where there was no fix, swapped pitot tubes
    corrected, the delay of filters removed, and the origin of its airspeed stated."""
    primaries = with_primaries(log.series)
    series, notes = dict(primaries.series), [*primaries.notes]
    for prefix in _prefixes(series, "GPS", "Status"):
        notes += _without_fix(series, prefix, "Status", ("Spd", "GCrs", "VZ", "VN", "VE", "Lat", "Lng", "Alt"))
    notes += _correct_swapped_tubes(series)
    if "ARSP.Temp" in series and not np.any(series["ARSP.Temp"].values):
        del series["ARSP.Temp"]  # zero throughout: a sensor without a thermometer
    kind, note = _airspeed_of_ardupilot(log.parameters, series)
    contradictions = (*log.contradictions, *primaries.contradictions)
    log = replace(log, series=series, kinds={**log.kinds, "CTUN.As": kind}, contradictions=contradictions)
    return _without_filter_delay(log.with_notes(*notes, *note))


def _correct_swapped_tubes(series: dict[str, TimeSeries]) -> list[str]:
    """Reverse the sign of differential pressures that are negative in flight while the autopilot has an airspeed; returns
    notes."""
    notes = []
    for prefix in _prefixes(series, "ARSP", "DiffPress"):
        pressure, speed = series[f"{prefix}.DiffPress"], series.get(f"{prefix}.Airspeed")
        if speed is None or not np.isfinite(speed.values).any() or speed.values.size != pressure.values.size:
            continue
        fast = (speed.values > FAST_SHARE * np.nanmax(speed.values)) & np.isfinite(pressure.values)
        if fast.any() and np.nanmedian(pressure.values[fast]) < 0.0:
            series[f"{prefix}.DiffPress"] = replace(pressure, values=-pressure.values)
            notes.append(f"{prefix}: the tubes of its pitot are swapped (DiffPress is negative in flight): turned")
    return notes


def _without_filter_delay(log: Log) -> Log:
    """The log with earlier times of its low-passed series. For motion that is slow compared with the cut-off frequency f the
    filter is a delay of sqrt(2)/(2 pi f)."""
    series, notes = dict(log.series), []
    for pattern, parameter in _LOW_PASSED:
        frequency = log.parameters.get(parameter, 0.0)
        names = [n for n in series if pattern.fullmatch(n)]
        if not names or frequency < LEAST_CUTOFF:
            continue
        delay = sqrt(2.0) / (2.0 * pi * frequency)
        series |= {n: replace(series[n], time=series[n].time - delay) for n in names}
        topic, fields = names[0].split(".")[0], ", ".join(sorted({n.rpartition(".")[2] for n in names}))
        notes.append(
            f"{topic}: {fields} are low-passed at {frequency:g} Hz ({parameter}), so dated {delay * 1e3:.1f} ms back"
        )
    return replace(log, series=series).with_notes(*notes)


def _airspeed_of_ardupilot(parameters: Mapping[str, float], series: dict[str, TimeSeries]) -> tuple[str, list[str]]:
    """Origin of CTUN.As, and notes. Where only some of its samples are of a pitot, the others become NaN in `series`."""
    speed, source = series.get("CTUN.As"), series.get("CTUN.AsT")
    if speed is None:
        return "measured", []
    if source is not None:
        by_sensor = np.isin(source.values, ARDUPILOT_SENSORS)
        if not by_sensor.any():
            words = f"(AsT {_distinct(source)}): an estimate of the autopilot, not a measurement"
            return "computed", [f"CTUN.As is not of a pitot {words}"]
        if not by_sensor.all():
            series["CTUN.As"] = _masked(speed, by_sensor)
            return "measured", [f"CTUN.As: {int((~by_sensor).sum())} samples that no pitot made (AsT) left out"]
        return "measured", []
    if "ARSP.DiffPress" in series or "ARSP.Airspeed" in series:
        for short, long, words in _PITOT_FLAGS:
            share = mean_of_first(series, (f"ARSP.{short}", f"ARSP.{long}"))
            if share is not None and share < MAJORITY:
                return "computed", [f"CTUN.As is not of the pitot, {words} (ARSP.{short} 0)"]
        return "measured", []
    if any(parameters.get(name, 0.0) > 0.0 for name in ("ARSPD_TYPE", "ARSPD_ENABLE")):
        return "measured", []
    return "assumed", ["nothing in the log says that a pitot measured CTUN.As (no ARSP, no AsT)"]


def of_px4(log: Log) -> Log:
    """A ULog with NaN where there was no fix, the delay of filters removed, and the origin of its validated airspeed stated."""
    series, notes, kinds = dict(log.series), [], dict(log.kinds)
    has_pitot = any(n.startswith(("differential_pressure.", "airspeed.")) for n in series)
    for prefix in (p for topic in ("vehicle_gps_position", "sensor_gps") for p in _prefixes(series, topic, "fix_type")):
        fields = [n.removeprefix(f"{prefix}.") for n in series if n.startswith(f"{prefix}.")]
        by_fix = [f for f in fields if re.match(r"vel_|lat|lon|alt|cog_|altitude_", f)]
        notes += _without_fix(series, prefix, "fix_type", by_fix)
    for prefix in _prefixes(series, "airspeed_validated", "true_airspeed_m_s"):
        source = series.get(f"{prefix}.airspeed_source", series.get(f"{prefix}.selected_airspeed_index"))
        names = [f"{prefix}.{n}_airspeed_m_s" for n in ("true", "calibrated", "indicated")]
        names = [n for n in names if n in series]
        if source is None:
            kinds |= dict.fromkeys(names, "measured" if has_pitot else "assumed")
            continue
        by_sensor = np.isin(source.values, PX4_SENSORS)
        kinds |= dict.fromkeys(names, "measured" if by_sensor.any() else "computed")
        if not by_sensor.any():
            words = f"(airspeed_source {_distinct(source)}): ground speed less a guessed wind, or synthetic"
            notes.append(f"{prefix} is not of a pitot {words}")
        elif not by_sensor.all():
            series |= {n: _masked(series[n], by_sensor) for n in names}
            notes.append(f"{prefix}: {int((~by_sensor).sum())} samples that no pitot made (airspeed_source) left out")
    return _without_filter_delay(replace(log, series=series, kinds=kinds).with_notes(*notes))


def of_mavlink(log: Log) -> Log:
    """A telemetry log with NaN where there was no fix, and the origin of VFR_HUD.airspeed stated."""
    series, notes, kinds = dict(log.series), [], dict(log.kinds)
    for prefix in _prefixes(series, "GPS_RAW_INT", "fix_type"):
        notes += _without_fix(series, prefix, "fix_type", ("vel", "cog"))
    if "VFR_HUD.airspeed" in series:
        kinds["VFR_HUD.airspeed"], words = _airspeed_of_mavlink(series)
        notes += [words] if words else []
    return replace(log, series=series, kinds=kinds).with_notes(*notes)


def _airspeed_of_mavlink(series: Mapping[str, TimeSeries]) -> tuple[str, str]:
    """Origin of VFR_HUD.airspeed by a differential pressure that varies, else by the sensors in SYS_STATUS; and a note or ''."""
    pressures = [series[n].values for n in _DIFFERENTIAL if n in series]
    varies = any(
        float(np.nanmax(np.abs(p - np.nanmedian(p)), initial=0.0)) > 0.0 and np.nanmax(np.abs(p)) > 0.0
        for p in pressures
    )
    if pressures and not varies:
        return "computed", "VFR_HUD.airspeed is not of a pitot: the differential pressure never moves"
    states = [series.get(f"SYS_STATUS.onboard_control_sensors_{word}") for word in ("present", "enabled")]
    if any(s is not None and not (s.values.astype(np.int64) & PITOT_BIT).any() for s in states):
        return "computed", "VFR_HUD.airspeed is not of a pitot: SYS_STATUS has none"
    if varies or states[0] is not None:
        return "measured", ""
    absent = "no differential pressure, no SYS_STATUS"
    return "assumed", f"nothing in the log says that a pitot measured VFR_HUD.airspeed ({absent})"


def _distinct(series: TimeSeries) -> str:
    """The first few distinct values, as text."""
    return ", ".join(f"{v:g}" for v in np.unique(series.values)[:4])


def _prefixes(series: Mapping[str, TimeSeries], topic: str, field: str) -> list[str]:
    """The names of a topic and its further instances that have a field."""
    pattern = re.compile(re.escape(topic) + r"(\[\d+\])?\." + re.escape(field))
    return [n.rsplit(".", 1)[0] for n in series if pattern.fullmatch(n)]


def _without_fix(series: dict[str, TimeSeries], prefix: str, status: str, fields: Iterable[str]) -> list[str]:
    """Set `fields` of a receiver to NaN while it had no fix, since it then writes zeros; returns a note where there were any."""
    fixed = series[f"{prefix}.{status}"].values >= FIX_3D
    if fixed.all():
        return []
    series |= {n: _masked(series[n], fixed) for n in (f"{prefix}.{f}" for f in fields) if n in series}
    return [f"{prefix}: {int((~fixed).sum())} samples without a fix ({status} below {FIX_3D}) taken as not measured"]


def _masked(series: TimeSeries, use: Mask) -> TimeSeries:
    """The series with NaN outside `use` (n,); unchanged where it has other times."""
    if series.time.size != use.size:
        return series
    return TimeSeries(series.time, np.where(use, series.values, np.nan))


EVIDENCE: Mapping[str, Callable[[Log], Log]] = {"dataflash": of_ardupilot, "ulog": of_px4, "tlog": of_mavlink}
"""Kind of a log -> the function that applies these facts."""
