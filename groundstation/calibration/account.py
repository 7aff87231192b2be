"""What a calibrated flight says of its making: provenance, and notes for a person."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.contract.channels import CHANNEL_BY_NAME, channels_of
from groundstation.calibration.align import BRIDGED, COMPLETE, completeness
from groundstation.calibration.readings import Readings
from groundstation.calibration.scan_table import ScanTable
from groundstation.calibration.schema import CalibrationSet
from groundstation.calibration.uncertainty import column_uncertainty
from groundstation.flight.quality.noise import noise

Array = NDArray[np.float64]


def account(
    table: ScanTable,
    calibration: CalibrationSet,
    columns: Mapping[str, Array],
    readings: Readings,
    aligned: bool,
    asked: bool | None,
) -> tuple[dict[str, Any], list[str]]:
    """What the provenance carries about this calibration, and what a person should know of it."""
    notes = []
    part = completeness(table.number)
    if not aligned and asked is None:
        notes.append(f"{part:.0%} of the scans are here: sensor groups are left at their own instants (not aligned)")
    if aligned and part < COMPLETE:
        notes.append(
            f"{part:.0%} of the scans are here: brought to one instant between neighbours up to {BRIDGED:.2f} s apart"
        )
    notes += _health_notes(table)
    notes += _uncalibrated(table, calibration)
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
        "uncertainty": column_uncertainty(calibration, columns),
        "noise": {n: s for n, v in columns.items() if (s := noise(v)) is not None},
        "extrapolated": dict(readings.extrapolated),
        "clipped": dict(readings.clipped),
        "unusable": {g: int(np.sum(~ok)) for g, ok in table.usable.items() if not ok.all()},
    }
    return detail, notes


_FIRST_CHANNEL = {
    **{"accelerometer": "accel_x", "gyro": "gyro_x", "magnetometer": "mag_x", "pitot": "pitot_pressure"},
    **{"static": "static_pressure", "alpha_vane": "alpha_vane", "beta_vane": "beta_vane", "mixing": "elevon_left_pot"},
    **{"elevon_left": "elevon_left_pot", "elevon_right": "elevon_right_pot"},
}
"""Instrument whose file a combined column needs -> a channel that shows whether it was fitted."""


def _uncalibrated(table: ScanTable, calibration: CalibrationSet) -> list[str]:
    """Instruments that were recorded and for which the set has no file, so that their columns are not measured."""
    return [
        f"{channel} was recorded, but calibration set {calibration.name} has no file for instrument {instrument}:"
        f" {', '.join(CHANNEL_BY_NAME[channel].columns)} not measured"
        for instrument, channel in _FIRST_CHANNEL.items()
        if calibration.get(instrument) is None and np.isfinite(table.raw[channel]).any()
    ]


def _health_notes(table: ScanTable) -> list[str]:
    """Sensor groups that were not in order: while starting, at times, or throughout."""
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
        later = int(np.sum(~ok[first[group] :])) if group not in never else 0
        if later:
            notes.append(f"sensor group {group} was not in order in {later} of {len(table)} scans: not measured there")
    if never:
        notes.append(f"sensors never in order, their columns not measured: {', '.join(never)}")
    return notes


def _first_value(table: ScanTable, group: str) -> int | None:
    """Row of the first usable value of a group."""
    finite = np.any([np.isfinite(table.raw[c.name]) for c in channels_of(group)], axis=0)
    return int(np.argmax(finite)) if finite.any() else None
