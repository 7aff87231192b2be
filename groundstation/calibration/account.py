"""Provenance and notes of a calibrated flight, and one sigma of each column."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.contract.channels import CHANNEL_BY_NAME, channels_of
from daq.utilities.constants import GRAVITY
from groundstation.calibration import curves
from groundstation.calibration.align import BRIDGED, COMPLETE, SAME_STAMP, completeness
from groundstation.calibration.calibration_set import CalibrationSet
from groundstation.calibration.columns import MIXED, direct_columns
from groundstation.calibration.scan_table import Readings, ScanTable
from groundstation.calibration.schema import Instrument
from groundstation.flight.airspeed import in_flight
from groundstation.flight.flight import BACK, CHANNELS, DATED_BACK, HELD, INTERVAL
from groundstation.flight.quality.noise import noise

Array = NDArray[np.float64]


def detail_and_notes(
    table: ScanTable,
    calibration: CalibrationSet,
    columns: Mapping[str, Array],
    readings: Readings,
    aligned: bool,
    align_option: bool | None,
) -> tuple[dict[str, Any], list[str]]:
    """Entries for the provenance's detail on this calibration, and notes for a person."""
    notes = []
    present = completeness(table.number)
    if not aligned and align_option is None:
        notes.append(f"{present:.0%} of the scans are here: sensor groups are left at their own instants (not aligned)")
    if aligned and present < COMPLETE:
        notes.append(
            f"{present:.0%} of the scans are here: brought to one instant between neighbours up to {BRIDGED:.2f} s apart"
        )
    notes += _health_notes(table, columns)
    notes += _uncalibrated_notes(table, calibration)
    for instrument, count in readings.extrapolated.items():
        notes.append(f"{instrument}: {count} samples outside the calibrated range, extrapolated")
    for channel, count in readings.clipped.items():
        notes.append(f"{channel}: {count} samples at the end of its range, clipped")
    if np.isfinite(table.raw["static_pressure"]).any() and "static_pressure" not in readings.values:
        notes.append(
            "static pressure not compensated: neither recording nor logger.toml has the chip's coefficients (static.nvm)"
        )
    offsets = {g: float(np.nanmedian(o)) for g, o in table.offset.items() if np.isfinite(o).any()}
    detail = {
        "aligned": aligned,
        "scans": {"first": int(table.number[0]), "last": int(table.number[-1]), "present": len(table)},
        "calibration_set": calibration.name,
        "read_offsets_s": offsets,
        "delays_s": {n: d for n, d in readings.delay.items() if d},
        "lags_s": dict(readings.lag),
        **({CHANNELS: pulsed} if (pulsed := _pulsed_surfaces(table, calibration, readings)) else {}),
        "uncertainty": column_uncertainty(calibration, columns),
        "noise": {n: s for n, v in columns.items() if (s := noise(v)) is not None},
        "extrapolated": dict(readings.extrapolated),
        "clipped": dict(readings.clipped),
        "unusable": {g: int(np.sum(~ok)) for g, ok in table.usable.items() if not ok.all()},
    }
    return detail, notes


def _pulsed_surfaces(table: ScanTable, calibration: CalibrationSet, readings: Readings) -> dict[str, dict[str, object]]:
    """Description of each surface known by its servo's pulse, in the form in which an import describes a command: what the servo
    did between two reports is not known."""
    mixed = {n: columns for columns, names in MIXED.items() for n in names} if calibration.get("mixing") else {}
    direct: dict[str, tuple[str, ...]] = {d.reading: (d.column.name,) for d in direct_columns(calibration)}
    surfaces: dict[str, dict[str, object]] = {}
    for name, lag in readings.lag.items():
        item, stamps = calibration.get(name), np.unique(table.time + table.known_offset(readings.group[name]))
        intervals = np.diff(stamps[np.isfinite(stamps)])
        if lag >= 0.0 or item is None or not np.any(intervals > SAME_STAMP):
            continue
        interval = float(np.median(intervals[intervals > SAME_STAMP]))
        entry = {"from": f"{item.channel} and its servo", "kind": "measured", "rate_hz": 1.0 / interval}
        held = {HELD: True, INTERVAL: interval, BACK: DATED_BACK * interval, "servo_lag_s": -lag}
        surfaces |= {column: {**entry, **held} for column in mixed.get(name) or direct.get(name, ())}
    return surfaces


_FIRST_CHANNEL = {
    **{"accelerometer": "accel_x", "gyro": "gyro_x", "magnetometer": "mag_x", "pitot": "pitot_pressure"},
    **{"static": "static_pressure", "alpha_vane": "alpha_vane", "beta_vane": "beta_vane", "mixing": "elevon_left_pot"},
    **{"elevon_left": "elevon_left_pot", "elevon_right": "elevon_right_pot"},
}
"""Instrument whose file a combined column needs -> a channel that shows whether the aircraft had the instrument."""


def _uncalibrated_notes(table: ScanTable, calibration: CalibrationSet) -> list[str]:
    """A note for each instrument that was recorded and has no file in the set, so that its columns are not measured."""
    return [
        f"{channel} was recorded, but calibration set {calibration.name} has no file for instrument {instrument}:"
        f" {', '.join(CHANNEL_BY_NAME[channel].columns)} not measured"
        for instrument, channel in _FIRST_CHANNEL.items()
        if calibration.get(instrument) is None and np.isfinite(table.raw[channel]).any()
    ]


def _health_notes(table: ScanTable, columns: Mapping[str, Array]) -> list[str]:
    """Notes on sensor groups that failed at the start, at times, or throughout, unless others measured their columns."""
    first = {g: _first_value(table, g) for g in table.usable}
    troubled = {g: ok for g, ok in table.usable.items() if not ok.all()}
    never = [g for g in troubled if first[g] is None]
    starting = [g for g, ok in troubled.items() if first[g] is not None and not ok[: first[g]].all()]
    notes = []
    if starting:
        longest = table.time[max(first[g] or 0 for g in starting)] - table.time[0]
        notes.append(
            f"sensors not yet in order in the first {longest:.2f} s, not measured there: {', '.join(starting)}"
        )
    for group, ok in troubled.items():
        count = int(np.sum(~ok[first[group] :])) if group not in never else 0
        if count:
            notes.append(f"sensor group {group} was not in order in {count} of {len(table)} scans: not measured there")
    missing = {g: lost for g in never if (lost := _unmeasured(g, columns))}
    if missing:
        named = list(dict.fromkeys(name for lost in missing.values() for name in lost))
        notes.append(f"sensors not fitted, or never in order: {', '.join(missing)}; not measured: {', '.join(named)}")
    return notes


def _unmeasured(group: str, columns: Mapping[str, Array]) -> list[str]:
    """Columns of a group that no other sensor measured either: an angle may come from a potentiometer or an encoder."""
    names = dict.fromkeys(name for channel in channels_of(group) for name in channel.columns)
    return [name for name in names if name not in columns or not np.isfinite(columns[name]).any()]


def _first_value(table: ScanTable, group: str) -> int | None:
    """Row of the first usable value of a group."""
    finite = np.any([np.isfinite(table.raw[c.name]) for c in channels_of(group)], axis=0)
    return int(np.argmax(finite)) if finite.any() else None


def column_uncertainty(calibration: CalibrationSet, columns: Mapping[str, Array]) -> dict[str, float]:
    """Column -> one sigma of its calibration at this flight's median reading (of V: in flight), as its files state it.

    Columns without a stated uncertainty are missing. Noise is not in it; see `noise`.
    """
    sigmas: dict[str, float] = {}
    _set_sigma(sigmas, "p_dynamic", _curve_sigma(calibration.get("pitot")))
    for direct in direct_columns(calibration):
        _set_sigma(sigmas, direct.column.name, _curve_sigma(direct.instrument))
    _controls(calibration, sigmas)
    _air(calibration, columns, sigmas)
    _vanes(calibration, sigmas)
    _triads(calibration, columns, sigmas)
    item = calibration.get("attitude")
    if item and item.attitude and any(item.attitude.uncertainty):
        sigmas.update(zip(("phi", "theta", "psi"), item.attitude.uncertainty, strict=True))
    return {name: sigma for name, sigma in sigmas.items() if name in columns and np.isfinite(columns[name]).any()}


def _set_sigma(sigmas: dict[str, float], column: str, sigma: float | None) -> None:
    if sigma:
        sigmas[column] = sigma


def _curve_sigma(item: Instrument | None) -> float | None:
    """Root mean square of a curve's sigma over its calibrated range: a flight's readings spread over it."""
    if item is None or item.curve is None:
        return None
    return float(np.sqrt(np.mean(curves.sigma_over_range(item.curve) ** 2)))


def _controls(calibration: CalibrationSet, sigmas: dict[str, float]) -> None:
    item = calibration.get("mixing")
    if item is None or item.mixing is None:
        return
    for columns, (left_name, right_name) in MIXED.items():
        left, right = _curve_sigma(calibration.get(left_name)), _curve_sigma(calibration.get(right_name))
        if left is not None and right is not None:
            for column, (a, b) in zip(columns, (item.mixing.elevator, item.mixing.aileron), strict=True):
                _set_sigma(sigmas, column, float(np.hypot(a * left, b * right)))


def _air(calibration: CalibrationSet, columns: Mapping[str, Array], sigmas: dict[str, float]) -> None:
    item = calibration.get("static")
    if item is None or item.static is None:
        return
    pressure_sigma, temperature_sigma = item.static.uncertainty, item.static.temperature_uncertainty
    _set_sigma(sigmas, "p_static", pressure_sigma)
    _set_sigma(sigmas, "temperature", temperature_sigma)
    rho, p, t = (_median(columns[n]) for n in ("rho", "p_static", "temperature"))
    flying = in_flight(columns["V"])  # near rest the error of V that a pressure error gives grows without bound
    q, v = (_median(columns[n][flying]) for n in ("p_dynamic", "V"))
    if rho is not None and p and t:
        relative = float(np.hypot(pressure_sigma / p, temperature_sigma / t))
        _set_sigma(sigmas, "rho", rho * relative)
        _set_sigma(sigmas, "altitude", pressure_sigma / (rho * GRAVITY))
        if v and q and q > 0 and "p_dynamic" in sigmas:
            # V = sqrt(2 q / rho): half of each relative error
            _set_sigma(sigmas, "V", 0.5 * v * float(np.hypot(sigmas["p_dynamic"] / q, relative)))
            _set_sigma(sigmas, "V_cas", 0.5 * v * sigmas["p_dynamic"] / q)


_TYPICAL_FLOW_ANGLE = 0.1  # rad, at which the error of the wash factor is stated


def _vanes(calibration: CalibrationSet, sigmas: dict[str, float]) -> None:
    for column in ("alpha", "beta"):
        item = calibration.get(f"{column}_vane")
        sigma = _curve_sigma(item)
        if item is not None and item.vane is not None and sigma is not None:
            wash_sigma = _TYPICAL_FLOW_ANGLE * item.vane.wash_factor_uncertainty
            _set_sigma(sigmas, column, float(np.hypot(sigma, wash_sigma) / item.vane.wash_factor))


def _triads(calibration: CalibrationSet, columns: Mapping[str, Array], sigmas: dict[str, float]) -> None:
    names = {"accelerometer": ("ax", "ay", "az"), "gyro": ("p", "q", "r"), "magnetometer": ("mx", "my", "mz")}
    for instrument, axes in names.items():
        item = calibration.get(instrument)
        if item is None or item.triad is None:
            continue
        squares = [float(np.nanmean(columns[a] ** 2)) for a in axes if np.isfinite(columns[a]).any()]
        size = float(np.sqrt(sum(squares)))
        for axis, sigma in zip(axes, item.triad.uncertainty, strict=True):
            _set_sigma(sigmas, axis, float(np.hypot(sigma, item.triad.matrix_uncertainty * size)))


def _median(values: Array) -> float | None:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else None
