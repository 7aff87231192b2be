"""From raw scans to the calibrated flight.

Order of work, each step on whole columns: counts to physical values by the calibration files; where the recording is
complete, every value brought to the scan's time; then what combines several instruments: airspeed, attitude, flow angles
and specific force at the CG, elevator and aileron. The same recording and the same files give the same bits,
however many scans are calibrated at once.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.contract.channels import CHANNEL_BY_NAME, COLUMNS, RAW_LIMITS
from daq.contract.scan import Scan
from groundstation.calibration import air_data, curves, flow, inertial
from groundstation.calibration.align import COMPLETE, completeness, derivative, to_scan_time
from groundstation.calibration.errors import CalibrationError
from groundstation.calibration.facts import Facts
from groundstation.calibration.scan_table import ScanTable, scan_table
from groundstation.calibration.schema import Attitude, CalibrationSet, Curve, Instrument, Triad
from groundstation.calibration.uncertainty import column_uncertainty, noise
from groundstation.flight import Flight, Provenance

Array = NDArray[np.float64]

_LINEAR = ("elevon_left", "elevon_right", "rudder")  # surfaces have edges: a straight line between samples, no cubic
_HELD = ("pwm_1", "pwm_2", "pwm_3", "pwm_4")  # a pulse width holds until the next one: never interpolated
_MAG_OVERFLOW = 8  # bit 3 of the magnetometer's second status byte
_FIX_3D = 3

LONGEST_HOLD = 1.0
"""How long [s] a supply voltage or chip temperature counts after it was read, where it is not read in each scan."""


@dataclass(frozen=True)
class Readings:
    """Physical value of each instrument axis, with what is known of its instant.

    values: name -> (N,). group: name -> sensor group. delay: name -> filter delay [s].
    extrapolated, clipped: instrument or channel -> number of samples.
    """

    values: dict[str, Array]
    group: dict[str, str]
    delay: dict[str, float]
    extrapolated: dict[str, int]
    clipped: dict[str, int]


class Calibrator:
    """A calibration set made ready for use on scans, live or recorded.

    facts: what the recording says of its sensors; takes precedence over the set's own.
    Raises CalibrationError when a fact is unusable.
    """

    def __init__(self, calibration: CalibrationSet, facts: Mapping[str, str] | None = None) -> None:
        self.calibration = calibration
        self.facts = Facts({**calibration.facts, **(facts or {})})
        nvm = self.facts.nvm("static")
        self._static_chip = air_data.Bmp390.from_nvm(nvm) if nvm else None

    def sample(self, scan: Scan) -> dict[str, float]:
        """Calibrated columns of one scan, for live use: not aligned, only columns that have a value."""
        columns, _ = self.columns(scan_table([scan]), aligned=False)
        return {name: float(v[0]) for name, v in columns.items() if v[0] == v[0]}

    def columns(self, table: ScanTable, *, aligned: bool) -> tuple[dict[str, Array], Readings]:
        """All flight columns (N,) of the table, NaN where not measured, and the readings they were made from."""
        readings = self._readings(table)
        values = self._align(table, readings) if aligned else readings.values
        made = _Columns(self.calibration, table, values, aligned).make()
        nothing = np.full(len(table), np.nan)
        return {c.name: made.get(c.name, nothing) for c in COLUMNS}, readings

    # -------------------------------------------------------------------------------------------- counts to values

    def _readings(self, table: ScanTable) -> Readings:
        out = Readings({}, {}, {}, {}, _clipped(table))
        for item in self.calibration.instruments.values():
            if item.curve is not None and item.channel is not None:
                self._read_curve(item, item.curve, item.channel, table, out)
            if item.triad is not None:
                self._read_triad(item, item.triad, table, out)
        self._read_static(table, out)
        attitude = self.calibration.get("attitude")
        for axis in "wxyz":
            name = f"quaternion_{axis}"
            delay = self.facts.delay("attitude", "attitude") + (attitude.delay if attitude else 0.0)
            _add(out, name, self.physical(table, name), "attitude", delay)
        return out

    def _read_curve(self, item: Instrument, curve: Curve, channel: str, table: ScanTable, out: Readings) -> None:
        reading = self.physical(table, channel)
        if item.ratiometric is not None:
            reading = reading * (item.ratiometric.reference / self.sensor_supply(table))
        value = curves.evaluate(curve, reading)
        if item.supply_sensitivity is not None:
            shift = item.supply_sensitivity
            value = value - shift.per_volt * (self.sensor_supply(table) - shift.reference)
        outside = int(np.sum(curves.extrapolated(curve, reading)))
        if outside:
            out.extrapolated[item.instrument] = outside
        group = CHANNEL_BY_NAME[channel].group
        # a channel read later within its group shows a later instant: less delay
        delay = item.delay + self.facts.delay(item.instrument, group) - self.facts.after(channel)
        _add(out, item.instrument, value, group, delay)

    def _read_triad(self, item: Instrument, triad: Triad, table: ScanTable, out: Readings) -> None:
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
            out.extrapolated[item.instrument] = outside
        delay = item.delay + self.facts.delay(item.instrument, group)
        warmth = held(table.time, self.physical(table, "imu_temperature"))
        for axis, value in zip("xyz", inertial.apply_triad(triad, reading, warmth), strict=True):
            _add(out, f"{item.instrument}_{axis}", value, group, delay)

    def _read_static(self, table: ScanTable, out: Readings) -> None:
        item = self.calibration.get("static")
        if item is None or item.static is None or self._static_chip is None:
            return
        pressure, temperature = self._static_chip.compensate(
            table.raw["static_pressure"], table.raw["static_temperature"]
        )
        delay = item.delay + self.facts.delay("static", "static")
        _add(out, "static_pressure", pressure + item.static.pressure_offset, "static", delay)
        _add(out, "static_temperature", temperature + item.static.temperature_offset, "static", delay)

    def physical(self, table: ScanTable, channel: str) -> Array:
        """A raw channel (N,) at data-sheet scale of its range, as counts where the data sheet leaves the scale open."""
        scale = self.facts.scale(channel)
        return table.raw[channel] if scale is None else table.raw[channel] * scale + CHANNEL_BY_NAME[channel].offset

    def sensor_supply(self, table: ScanTable) -> Array:
        """Voltage of the sensor supply (N,) [V]. Raises CalibrationError when the set does not say how to read it."""
        item = self.calibration.get("sensor_supply")
        if item is None or item.curve is None or item.channel is None:
            raise CalibrationError(
                f"{self.calibration.name}: an instrument is corrected by the sensor supply, but the set has no sensor_supply.toml"
            )
        return held(table.time, curves.evaluate(item.curve, self.physical(table, item.channel)))

    # ---------------------------------------------------------------------------------------------- one time base

    def _align(self, table: ScanTable, readings: Readings) -> dict[str, Array]:
        values = dict(readings.values)
        values.update(_continuous_quaternion(values))
        for name, reading in values.items():
            if name not in _HELD:
                at = table.time + known_offset(table, readings.group[name]) - readings.delay[name]
                values[name] = to_scan_time(reading, at, table.time, table.number, smooth=name not in _LINEAR)
        return values


def held(time: Array, values: Array, longest: float = LONGEST_HOLD) -> Array:
    """A slowly changing auxiliary quantity, held from its last reading for at most `longest` seconds."""
    if not np.isnan(values).any():
        return values
    rows = np.arange(values.size)
    last = np.maximum.accumulate(np.where(np.isfinite(values), rows, -1))
    recent = (last >= 0) & (time - time[last] <= longest)
    return np.where(recent, values[last], np.nan)


def known_offset(table: ScanTable, group: str) -> Array:
    """Read offset of a group in each scan [s]; where a scan does not carry it, the group's median, else 0."""
    offset = table.offset[group]
    missing = np.isnan(offset)
    if not missing.any():
        return offset
    return np.where(missing, 0.0 if missing.all() else float(np.median(offset[~missing])), offset)


def _add(out: Readings, name: str, values: Array, group: str, delay: float) -> None:
    out.values[name], out.group[name], out.delay[name] = values, group, delay


def _clipped(table: ScanTable) -> dict[str, int]:
    """Samples at the ends of the raw range of the signed channels: the truth lay beyond."""
    found = {}
    for name, values in table.raw.items():
        if CHANNEL_BY_NAME[name].raw_type == "i16" and CHANNEL_BY_NAME[name].group != "attitude":
            low, high = RAW_LIMITS["i16"]
            count = int(np.sum((values <= low) | (values >= high)))
            if count:
                found[name] = count
    return found


def _continuous_quaternion(values: Mapping[str, Array]) -> dict[str, Array]:
    """q and -q are the same attitude: signs chosen so that no component jumps from one sample to the next."""
    names = [f"quaternion_{axis}" for axis in "wxyz"]
    q = np.stack([values[n] for n in names])
    dot = np.sum(q[:, 1:] * q[:, :-1], axis=0)
    sign = np.concatenate([[1.0], np.cumprod(np.where(dot < 0, -1.0, 1.0))])
    return {n: q[i] * sign for i, n in enumerate(names)}


class _Columns:
    """The columns that combine several instruments, from their values at common instants."""

    def __init__(
        self, calibration: CalibrationSet, table: ScanTable, values: Mapping[str, Array], aligned: bool
    ) -> None:
        self.calibration = calibration
        self.table = table
        self.values = values
        self.aligned = aligned
        self.columns: dict[str, Array] = {}

    def make(self) -> dict[str, Array]:
        steps: tuple[Callable[[], None], ...] = (
            self._air, self._rates, self._acceleration, self._attitude, self._flow, self._controls, self._others, self._gnss,
        )  # fmt: skip
        for step in steps:
            step()
        return self.columns

    def _value(self, name: str) -> Array:
        return self.values[name] if name in self.values else np.full(len(self.table), np.nan)

    def _axes(self, instrument: str) -> inertial.Axes:
        return self._value(f"{instrument}_x"), self._value(f"{instrument}_y"), self._value(f"{instrument}_z")

    def _air(self) -> None:
        impact, static, temperature = (self._value(n) for n in ("pitot", "static_pressure", "static_temperature"))
        item = self.calibration.get("static")
        site = item.static if item and item.static else None
        if site is not None and site.position_error:
            # the true impact pressure: the measured one is short by k q when its low side is the same port
            true_impact = impact / (1 - site.position_error) if site.feeds_pitot else impact
            static = static - site.position_error * true_impact
            impact = true_impact
        self.columns["p_dynamic"], self.columns["p_static"], self.columns["temperature"] = impact, static, temperature
        self.columns["rho"] = air_data.density(static, temperature)
        self.columns["V"] = air_data.true_airspeed(impact, static, temperature)
        self.columns["V_cas"] = air_data.calibrated_airspeed(impact)
        reference = site.sea_level_pressure if site else air_data.SEA_LEVEL_PRESSURE
        self.columns["altitude"] = air_data.pressure_altitude(static, reference)

    def _rates(self) -> None:
        self.columns.update(zip("pqr", self._axes("gyro"), strict=True))

    def _acceleration(self) -> None:
        axes = self._axes("accelerometer")
        item = self.calibration.get("accelerometer")
        if item is not None and item.mount is not None and any(item.mount.position):
            rates = self._axes("gyro")
            slopes = None
            if self.aligned:
                p, q, r = (derivative(rate, self.table.time, self.table.number) for rate in rates)
                slopes = (p, q, r)
            axes = inertial.at_cg(axes, rates, slopes, item.mount.position)
        self.columns.update(zip(("ax", "ay", "az"), axes, strict=True))

    def _attitude(self) -> None:
        item = self.calibration.get("attitude")
        attitude = item.attitude if item and item.attitude else Attitude()
        w, x, y, z = (self._value(f"quaternion_{axis}") for axis in "wxyz")
        self.columns.update(zip(("phi", "theta", "psi"), inertial.euler_angles(w, x, y, z, attitude), strict=True))

    def _flow(self) -> None:
        alpha_item, beta_item = self.calibration.get("alpha_vane"), self.calibration.get("beta_vane")
        alpha, beta = self._value("alpha_vane"), self._value("beta_vane")
        if alpha_item and alpha_item.vane and beta_item and beta_item.vane:
            alpha = flow.undo_wash(alpha, alpha_item.vane)
            beta = flow.undo_wash(beta, beta_item.vane)
            rates = self._axes("gyro")
            alpha, beta = flow.flow_angles(alpha, beta, self.columns["V"], rates, alpha_item.vane, beta_item.vane)
        self.columns["alpha"], self.columns["beta"] = alpha, beta

    def _controls(self) -> None:
        item = self.calibration.get("mixing")
        pairs = (("delta_e", "delta_a", "elevon_left", "elevon_right"), ("cmd_e", "cmd_a", "pwm_1", "pwm_2"))
        if item is not None and item.mixing is not None:
            for elevator, aileron, left_name, right_name in pairs:
                left, right = self._value(left_name), self._value(right_name)
                for column, weights in ((elevator, item.mixing.elevator), (aileron, item.mixing.aileron)):
                    self.columns[column] = weights[0] * left + weights[1] * right
        self.columns["delta_r"], self.columns["cmd_r"] = self._value("rudder"), self._value("pwm_3")
        self.columns["throttle"] = self._value("pwm_4")

    def _others(self) -> None:
        self.columns["thrust"] = self._value("thrust")
        self.columns.update(zip(("mx", "my", "mz"), self._axes("magnetometer"), strict=True))
        self.columns["supply_voltage"] = self._value("supply")
        for i in range(1, 6):
            self.columns[f"analog_{i}"] = self._value(f"analog_{i}")
            self.columns[f"digital_{i}"] = self.table.raw[f"digital_{i}"]

    def _gnss(self) -> None:
        """Position and velocity of fixes in three dimensions; between fixes nothing is measured."""
        good = self.table.raw["gnss_fix"] >= _FIX_3D
        names = (
            "latitude_e7",
            "longitude_e7",
            "height_msl_mm",
            "velocity_north_mm",
            "velocity_east_mm",
            "velocity_down_mm",
        )
        for name in names:
            for column in CHANNEL_BY_NAME[name].columns:
                self.columns[column] = np.where(
                    good, self.table.raw[name] * (CHANNEL_BY_NAME[name].scale or 1.0), np.nan
                )


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

    facts: what the recording says of its sensors (chip coefficients, filter delays, ranges).
    align: bring every group to the scan's time and remove the full lever-arm effect; None does so when at least 90 % of the
    scan numbers are present (a recording from on board, or one filled up after landing), and not for a decimated stream,
    whose neighbours are missing. One row per scan; a missing scan has no row, and a gap starts a new segment.
    Raises CalibrationError when nothing can be calibrated.
    """
    table = scan_table(scans)
    if len(table) < 2:
        raise CalibrationError(f"{name}: only one scan in this recording; a flight needs at least two")
    aligned = completeness(table.number) >= COMPLETE if align is None else align
    columns, readings = Calibrator(calibration, facts).columns(table, aligned=aligned)
    detail, notes = _account(table, calibration, columns, readings, aligned, align)
    origin = provenance or Provenance()
    origin = Provenance(
        source=origin.source,
        path=origin.path,
        sha256=origin.sha256,
        aircraft=origin.aircraft,
        software=origin.software,
        calibration=calibration.hashes,
        detail=MappingProxyType({**origin.detail, **detail}),
    )
    return Flight.build(name, table.time, columns, provenance=origin, notes=[*table.notes, *notes])


def _account(
    table: ScanTable,
    calibration: CalibrationSet,
    columns: Mapping[str, Array],
    readings: Readings,
    aligned: bool,
    asked: bool | None,
) -> tuple[dict[str, Any], list[str]]:
    """What the provenance carries about this calibration, and what a person should know of it."""
    notes = []
    if not aligned and asked is None:
        part = completeness(table.number)
        notes.append(f"{part:.0%} of the scans are here: sensor groups are left at their own instants (not aligned)")
    notes += _health_notes(table)
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
        "uncertainty": column_uncertainty(calibration, columns),
        "noise": {n: s for n, v in columns.items() if (s := noise(v)) is not None},
        "extrapolated": dict(readings.extrapolated),
        "clipped": dict(readings.clipped),
        "unusable": {g: int(np.sum(~ok)) for g, ok in table.usable.items() if not ok.all()},
    }
    return detail, notes


def _health_notes(table: ScanTable) -> list[str]:
    """Sensor groups that were not in order: while starting, at times, or throughout."""
    never = [g for g, ok in table.usable.items() if not ok.any()]
    starting = {g: int(np.argmax(ok)) for g, ok in table.usable.items() if ok.any() and not ok[0]}
    notes = []
    if starting:
        longest = table.time[max(starting.values())] - table.time[0]
        notes.append(
            f"sensors not yet in order in the first {longest:.2f} s, not measured there: {', '.join(starting)}"
        )
    for group, ok in table.usable.items():
        later = int(np.sum(~ok[starting.get(group, 0) :]))
        if later and group not in never:
            notes.append(f"sensor group {group} was not in order in {later} of {len(table)} scans: not measured there")
    if never:
        notes.append(f"sensors never in order, their columns not measured: {', '.join(never)}")
    return notes
