"""From raw scans to the calibrated flight.

Order of work, each step on whole columns: counts to physical values by the calibration files; where scans have
neighbours, every value brought to the scan's time; then what combines several instruments: airspeed, attitude, flow angles
and specific force at the CG, elevator and aileron. The same recording and the same files give the same bits,
however many scans are calibrated at once.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from daq.contract.channels import CHANNEL_BY_NAME, COLUMNS
from daq.contract.scan import Scan
from groundstation.calibration import conversions, curves
from groundstation.calibration.account import detail_and_notes
from groundstation.calibration.align import (
    BRIDGED,
    COMPLETE,
    by_stamp,
    completeness,
    connectedness,
    hold,
    to_scan_time,
    undo_lag,
)
from groundstation.calibration.calibration_set import CalibrationSet
from groundstation.calibration.columns import GNSS, CombinedColumns, direct_columns
from groundstation.calibration.facts import RecordedFacts
from groundstation.calibration.scan_table import Readings, ScanTable, bridged, scan_table
from groundstation.calibration.schema import CalibrationCurve, CalibrationError, Instrument, Triad
from groundstation.flight import Flight, Provenance
from groundstation.flight.arrays import hold_recent

Array = NDArray[np.float64]

# surfaces have edges: a straight line between samples, no cubic
_LINEAR = ("elevon_left", "elevon_right", "rudder", *GNSS)
_HELD = ("pwm_1", "pwm_2", "pwm_3", "pwm_4")  # a pulse width holds until the next one: never interpolated
_MAG_OVERFLOW = 8  # bit 3 of the magnetometer's second status byte
_FIX_3D = 3  # type of a GNSS fix
_OTHER_SENSOR = 2.0
"""Ratio of two scales [Pa/count] from which they belong to different kinds of pitot sensor: those of two kinds differ by more."""


class Calibrator:
    """A calibration set made ready for use on scans, live or recorded.

    facts: of the recording's sensors; they take precedence over those of the set.
    Raises CalibrationError when a fact is unusable.
    """

    def __init__(self, calibration: CalibrationSet, facts: Mapping[str, str] | None = None) -> None:
        self.calibration = calibration
        self.facts = RecordedFacts({**calibration.facts, **(facts or {})})
        nvm = self.facts.nvm("static")
        self._direct = direct_columns(calibration)
        channels = (d.channel for d in self._direct if d.uncalibrated)
        self._uncalibrated = frozenset(c.name for c in channels if c.raw_type != "bit")
        # nothing says that a channel without a calibration file is smooth
        self._linear = {*_LINEAR, *(d.reading for d in self._direct if d.uncalibrated or d.channel.package)}
        self._static_chip = conversions.Bmp390Compensation.from_nvm(nvm) if nvm else None

    def sample(self, scan: Scan) -> dict[str, float]:
        """Calibrated columns of one scan, for live use: not aligned, only columns that have a value."""
        columns, _ = self.columns(scan_table([scan]), aligned=False)
        return {name: float(v[0]) for name, v in columns.items() if v[0] == v[0]}

    def columns(self, table: ScanTable, *, aligned: bool) -> tuple[dict[str, Array], Readings]:
        """All flight columns (N,) of the table, NaN where not measured, and the readings they were made from."""
        # a sensor or a sender can report any number: its column then holds inf or NaN
        with np.errstate(all="ignore"):
            readings = self._readings(table)
            values = self._align(table, readings) if aligned else readings.values
            combined = CombinedColumns(self.calibration, table, values, aligned).make()
        unmeasured = np.full(len(table), np.nan)
        return {c.name: combined.get(c.name, unmeasured) for c in COLUMNS}, readings

    def check(self, table: ScanTable) -> None:
        """Raise CalibrationError where a recorded channel cannot be turned into its column."""
        for direct in self._direct:
            if direct.why_not and np.isfinite(table.raw[direct.channel.name]).any():
                raise CalibrationError(f"column {direct.column.name}: {direct.why_not}")

    # -------------------------------------------------------------------------------------------- counts to values

    def _readings(self, table: ScanTable) -> Readings:
        readings = Readings({}, {}, {}, {}, {}, table.clipped())
        for item in self.calibration.instruments.values():
            if item.curve is not None and item.channel is not None:
                self._read_curve(item, item.curve, item.channel, table, readings)
            if item.triad is not None:
                self._read_triad(item, item.triad, table, readings)
        self._read_static(table, readings)
        ambient = self.facts.thermal_pitot_pa
        if ambient is not None and "pitot" in readings.values and "static_pressure" in readings.values:
            readings.values["pitot"] = readings.values["pitot"] * (
                ambient / hold_recent(table.time, readings.values["static_pressure"])
            )
        self._read_gnss(table, readings)
        for name in self._uncalibrated:
            group = CHANNEL_BY_NAME[name].group
            _put_reading(
                readings,
                name,
                self.physical(table, name),
                group,
                self.facts.delay(name, group) - self.facts.offset_in_group(name),
            )
        attitude = self.calibration.get("attitude")
        for axis in "wxyz":
            name = f"quaternion_{axis}"
            delay = self.facts.delay("attitude", "attitude") + (attitude.delay if attitude else 0.0)
            _put_reading(readings, name, self.physical(table, name), "attitude", delay)
            if self.facts.lag("attitude"):
                readings.lag[name] = self.facts.lag("attitude")
        return readings

    def _read_curve(
        self, item: Instrument, curve: CalibrationCurve, channel: str, table: ScanTable, readings: Readings
    ) -> None:
        scale, offset = self.pressure_transfer(item, curve, channel)
        reading = self.curve_input(item, channel, table, scale, offset)
        value = curves.evaluate(curve, reading)
        if item.supply_sensitivity is not None:
            shift = item.supply_sensitivity
            value = value - shift.per_volt * (self.sensor_supply(table) - shift.reference)
        zero = self.facts.zero_count(item.instrument)
        if zero is not None:
            value = value - curves.evaluate(curve, zero * scale + offset)
        outside = int(np.sum(curves.extrapolated(curve, reading)))
        if outside:
            readings.extrapolated[item.instrument] = outside
        group = CHANNEL_BY_NAME[channel].group
        # a channel read later within its group shows a later instant, so its delay is smaller
        delay = item.delay + self.facts.delay(item.instrument, group) - self.facts.offset_in_group(channel)
        _put_reading(readings, item.instrument, value, group, delay)
        if item.servo_lag:
            readings.lag[item.instrument] = -item.servo_lag

    def curve_input(self, item: Instrument, channel: str, table: ScanTable, scale: float, offset: float) -> Array:
        """Input (N,) of an instrument's curve, referred to the sensor supply where ratiometric.

        scale, offset: from `pressure_transfer`.
        """
        reading = self.physical(table, channel) * scale + offset
        if item.ratiometric is None:
            return reading
        return reading * (item.ratiometric.reference / self.sensor_supply(table))

    def pressure_transfer(self, item: Instrument, curve: CalibrationCurve, channel: str) -> tuple[float, float]:
        """Scale and offset from a channel to the curve's input: 1, 0 but for a pitot's counts that the curve takes in pascal.

        Raises CalibrationError when the chip's scale is not known, or the curve belongs to another kind of sensor.
        """
        if channel != "pitot_pressure":
            return 1.0, 0.0
        transfer = self.facts.transfer(CHANNEL_BY_NAME[channel].group, "pa")
        if curve.input_unit != "Pa":
            self._refuse_other_counts(item, curve, transfer)
            return 1.0, 0.0
        if transfer is None:
            raise CalibrationError(
                f"{self.calibration.name}: {item.instrument} takes {channel} in Pa, and neither recording nor logger.toml has the"
                " chip's scale (pitot.scale_pa); write input_unit = 'count' and a curve over counts"
            )
        return transfer

    def _refuse_other_counts(
        self, item: Instrument, curve: CalibrationCurve, transfer: tuple[float, float] | None
    ) -> None:
        """Raise CalibrationError for a curve over counts of another kind of sensor."""
        middle = sum(curve.valid) / 2
        below, above = curves.evaluate(curve, np.array([middle - 0.5, middle + 0.5]))
        slope = abs(float(above - below))
        if transfer is None or 1 / _OTHER_SENSOR < slope / transfer[0] < _OTHER_SENSOR:
            return
        raise CalibrationError(
            f"{self.calibration.name}: {item.instrument} is a curve over counts of {slope:.3g} Pa, and the sensor of the"
            f" recording has {transfer[0]:.3g} Pa a count; calibrate this one, or write input_unit = 'Pa' and a curve over pascal"
        )

    def _read_triad(self, item: Instrument, triad: Triad, table: ScanTable, readings: Readings) -> None:
        x, y, z = (self.physical(table, c) for c in item.channels)
        reading = (x, y, z)
        group = CHANNEL_BY_NAME[item.channels[0]].group
        if group == "mag":
            status = table.raw["mag_status"]
            overflow = np.isfinite(status) & ((np.nan_to_num(status).astype(np.int64) & _MAG_OVERFLOW) > 0)
            reading = (np.where(overflow, np.nan, x), np.where(overflow, np.nan, y), np.where(overflow, np.nan, z))
        lowest, highest = triad.valid
        outside = sum(int(np.sum((axis < lowest) | (axis > highest))) for axis in reading)
        if outside:
            readings.extrapolated[item.instrument] = outside
        delay = item.delay + self.facts.delay(item.instrument, group)
        lag = self.facts.lag(item.instrument)
        temperature = hold_recent(table.time, self.physical(table, "imu_temperature"))
        for axis, value in zip("xyz", conversions.apply_triad(triad, reading, temperature), strict=True):
            _put_reading(readings, f"{item.instrument}_{axis}", value, group, delay)
            if lag:
                readings.lag[f"{item.instrument}_{axis}"] = lag

    def _read_static(self, table: ScanTable, readings: Readings) -> None:
        item = self.calibration.get("static")
        if item is None or item.static is None:
            return
        pascal, kelvin = self.facts.transfer("static", "pa"), self.facts.transfer("static", "k")
        pressure, temperature = table.raw["static_pressure"], table.raw["static_temperature"]
        if pascal is not None and kelvin is not None:
            pressure, temperature = pressure * pascal[0] + pascal[1], temperature * kelvin[0] + kelvin[1]
        elif self._static_chip is not None:
            pressure, temperature = self._static_chip.compensate(pressure, temperature)
        else:
            return
        delay = item.delay + self.facts.delay("static", "static")
        _put_reading(readings, "static_pressure", pressure + item.static.pressure_offset, "static", delay)
        _put_reading(readings, "static_temperature", temperature + item.static.temperature_offset, "static", delay)

    def physical(self, table: ScanTable, channel: str) -> Array:
        """A raw channel (N,) at data-sheet scale of its range, as counts where the data sheet leaves the scale open."""
        scale = self.facts.scale(channel)
        return table.raw[channel] if scale is None else table.raw[channel] * scale + CHANNEL_BY_NAME[channel].offset

    def _read_gnss(self, table: ScanTable, readings: Readings) -> None:
        """Position and velocity of fixes in three dimensions; other fixes measure nothing."""
        has_fix = table.raw["gnss_fix"] >= _FIX_3D
        for name in GNSS:
            _put_reading(readings, name, np.where(has_fix, self.physical(table, name), np.nan), "gnss", 0.0)

    def sensor_supply(self, table: ScanTable) -> Array:
        """Voltage of the sensor supply (N,) [V]. Raises CalibrationError when the set has no file for it."""
        item = self.calibration.get("sensor_supply")
        if item is None or item.curve is None or item.channel is None:
            raise CalibrationError(
                f"{self.calibration.name}: an instrument is corrected by the sensor supply, but the set has no sensor_supply.toml"
            )
        return hold_recent(table.time, curves.evaluate(item.curve, self.physical(table, item.channel)))

    # ---------------------------------------------------------------------------------------------- one time base

    def _align(self, table: ScanTable, readings: Readings) -> dict[str, Array]:
        values = dict(readings.values)
        values.update(conversions.continuous_quaternion(values))
        furthest = BRIDGED if table.bridged else math.inf
        for name, reading in values.items():
            group, smooth = readings.group[name], name not in self._linear and name not in _HELD
            sampled_at = table.time + table.known_offset(group) - readings.delay[name]
            lag = readings.lag.get(name, 0.0)
            # the lag of a servo needs the times of its pulses, also where the logger stamps them
            if self.facts.stamped(group) or lag < 0.0:
                pulse = name in _HELD or lag < 0.0
                values[name] = by_stamp(reading, sampled_at, table.time, smooth=smooth, lag=lag, pulse=pulse)
            elif name in _HELD:
                values[name] = hold(reading, table.number)
            else:
                if lag > 0.0:
                    reading = undo_lag(reading, table.time, table.number, lag)
                values[name] = to_scan_time(
                    reading, sampled_at, table.time, table.number, smooth=smooth, furthest=furthest
                )
        return values


def _put_reading(readings: Readings, name: str, values: Array, group: str, delay: float) -> None:
    readings.values[name], readings.group[name], readings.delay[name] = values, group, delay


# ------------------------------------------------------------------------------------------------------ whole flights


def calibrate(
    scans: Iterable[Scan],
    calibration: CalibrationSet,
    *,
    name: str = "flight",
    facts: Mapping[str, str] | None = None,
    align: bool | None = None,
    provenance: Provenance | None = None,
) -> Flight:
    """The flight made from raw scans.

    facts: of the recording's sensors (chip coefficients, filter delays, ranges).
    align: bring every group to the scan's time and remove the full lever-arm effect. Where the share COMPLETE of the scan numbers
    is present (a recording from on board, or one filled up after landing) nothing is interpolated across a missing one; in a
    thinned stream scans up to BRIDGED seconds apart are neighbours. None aligns unless more than a tenth of the intervals of a
    thinned stream are longer. One row per scan; a missing scan has no row, and a gap starts a new segment.
    Raises CalibrationError when nothing can be calibrated.
    """
    table = scan_table(scans)
    if len(table) < 2:
        raise CalibrationError(f"{name}: only one scan in this recording; a flight needs at least two")
    complete = completeness(table.number) >= COMPLETE
    aligned = (complete or connectedness(table.time) >= COMPLETE) if align is None else align
    calibrator = Calibrator(calibration, facts)
    calibrator.check(table)
    columns, readings = calibrator.columns(bridged(table) if aligned and not complete else table, aligned=aligned)
    detail, notes = detail_and_notes(table, calibration, columns, readings, aligned, align)
    if table.utc_offset is not None:
        detail["utc_offset_s"], detail["utc_accuracy_s"] = table.utc_offset
    origin = provenance or Provenance()
    details = MappingProxyType({**origin.detail, **detail})
    origin = replace(origin, calibration=calibration.hashes, detail=details)
    return Flight.build(name, table.time, columns, provenance=origin, notes=[*table.notes, *notes])
