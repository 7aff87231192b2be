"""The flight columns that several instruments make together, from their values at common instants.

Air data, rates, specific force at the CG, attitude, flow angles at the CG, elevator and aileron.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.contract.channels import CHANNEL_BY_NAME, CHANNELS, COLUMNS, Channel, FlightColumn, sources_of
from daq.utilities.constants import ROUND_EARTH_RADIUS, SEA_LEVEL_PRESSURE
from groundstation.calibration import conversions
from groundstation.calibration.align import derivative
from groundstation.calibration.calibration_set import CalibrationSet
from groundstation.calibration.scan_table import ScanTable
from groundstation.calibration.schema import CalibrationError, Instrument, MountingAngles, Vector
from groundstation.flight.arrays import hold_recent
from groundstation.flight.atmosphere import density

Array = NDArray[np.float64]

GNSS = tuple("latitude_e7 longitude_e7 height_msl_mm velocity_north_mm velocity_east_mm velocity_down_mm".split())
MIXED = {("delta_e", "delta_a"): ("elevon_left", "elevon_right"), ("cmd_e", "cmd_a"): ("pwm_1", "pwm_2")}
"""Elevator and aileron -> the readings that they are mixed from."""


class CombinedColumns:
    """Makes the columns that combine several instruments. aligned: whether the values are at common instants."""

    def __init__(
        self, calibration: CalibrationSet, table: ScanTable, values: Mapping[str, Array], aligned: bool
    ) -> None:
        self.calibration = calibration
        self.table = table
        self.values = values
        self.aligned = aligned
        self.columns: dict[str, Array] = {}

    def make(self) -> dict[str, Array]:
        """Column -> (N,) values, NaN where not measured."""
        self._air()
        self._rates_and_field()
        self._acceleration()
        self._attitude()
        self._flow()  # needs V
        self._controls()
        self._gnss()  # needs attitude and rates
        self._direct()
        return self.columns

    def _value(self, name: str) -> Array:
        return self.values[name] if name in self.values else np.full(len(self.table), np.nan)

    def _axes(self, instrument: str) -> conversions.Axes:
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
        static, temperature = (hold_recent(self.table.time, v) for v in (static, temperature))
        self.columns["rho"] = density(static, temperature)
        self.columns["V"] = conversions.true_airspeed(impact, static, temperature)
        self.columns["V_cas"] = conversions.calibrated_airspeed(impact)
        reference = site.sea_level_pressure if site else SEA_LEVEL_PRESSURE
        self.columns["altitude"] = conversions.pressure_altitude(self.columns["p_static"], reference)

    def _rates_and_field(self) -> None:
        self.columns.update(zip("pqr", self._axes("gyro"), strict=True))
        self.columns.update(zip(("mx", "my", "mz"), self._axes("magnetometer"), strict=True))

    def _acceleration(self) -> None:
        axes = self._axes("accelerometer")
        item = self.calibration.get("accelerometer")
        if item is not None and item.mount is not None and any(item.mount.position):
            rates = self._axes("gyro")
            slopes = None
            if self.aligned:
                p, q, r = (derivative(rate, self.table.time, self.table.number) for rate in rates)
                slopes = (p, q, r)
            axes = conversions.at_cg(axes, rates, slopes, item.mount.position)
        self.columns.update(zip(("ax", "ay", "az"), axes, strict=True))

    def _attitude(self) -> None:
        item = self.calibration.get("attitude")
        attitude = item.attitude if item and item.attitude else MountingAngles()
        w, x, y, z = (self._value(f"quaternion_{axis}") for axis in "wxyz")
        self.columns.update(zip(("phi", "theta", "psi"), conversions.euler_angles(w, x, y, z, attitude), strict=True))

    def _flow(self) -> None:
        alpha_item, beta_item = self.calibration.get("alpha_vane"), self.calibration.get("beta_vane")
        alpha, beta = self._value("alpha_vane"), self._value("beta_vane")
        if alpha_item and alpha_item.vane and beta_item and beta_item.vane:
            alpha = conversions.undo_wash(alpha, alpha_item.vane)
            beta = conversions.undo_wash(beta, beta_item.vane)
            rates = self._axes("gyro")
            alpha, beta = conversions.flow_angles(
                alpha, beta, self.columns["V"], rates, alpha_item.vane, beta_item.vane
            )
        self.columns["alpha"], self.columns["beta"] = alpha, beta

    def _controls(self) -> None:
        item = self.calibration.get("mixing")
        if item is not None and item.mixing is not None:
            for (elevator, aileron), (left_name, right_name) in MIXED.items():
                left, right = self._value(left_name), self._value(right_name)
                for column, weights in ((elevator, item.mixing.elevator), (aileron, item.mixing.aileron)):
                    self.columns[column] = weights[0] * left + weights[1] * right

    def _direct(self) -> None:
        """Columns of one channel each. A bit is never interpolated: there is nothing between 0 and 1."""
        for direct in direct_columns(self.calibration):
            bit = direct.channel.raw_type == "bit"
            self.columns[direct.column.name] = (
                self.table.raw[direct.channel.name] if bit else self._value(direct.reading)
            )

    def _gnss(self) -> None:
        for name in GNSS:
            for column in CHANNEL_BY_NAME[name].columns:
                self.columns[column] = self._value(name)
        item = self.calibration.get("gnss_antenna")
        if item is not None and item.mount is not None and any(item.mount.position):
            self._antenna_to_cg(item.mount.position)

    def _antenna_to_cg(self, position: Vector) -> None:
        """Refer position and velocity of the antenna, at `position` [m] from the CG, to the CG, where attitude is measured."""
        c = self.columns
        attitude, rates = (c["phi"], c["theta"], c["psi"]), (c["p"], c["q"], c["r"])
        offset, velocity = conversions.point_in_earth_axes(position, attitude, rates)
        north, east, down = (np.nan_to_num(v) for v in offset)
        c["latitude"] = c["latitude"] - np.degrees(north / ROUND_EARTH_RADIUS)
        c["longitude"] = c["longitude"] - np.degrees(east / (ROUND_EARTH_RADIUS * np.cos(np.radians(c["latitude"]))))
        c["altitude_gnss"] = c["altitude_gnss"] + down
        for column, relative in zip(("vn", "ve", "vd"), velocity, strict=True):
            c[column] = c[column] - np.nan_to_num(relative)


COMBINED = frozenset(
    "ax ay az p q r phi theta psi alpha beta V V_cas delta_e delta_a cmd_e cmd_a rho p_static p_dynamic temperature "
    "altitude latitude longitude altitude_gnss vn ve vd mx my mz".split()
)
"""Columns that `CombinedColumns` makes by rules of their own; each of the others comes from one channel."""

_NEEDS_FILE = {"supply": "it is behind a divider whose ratio the channel table does not know"}
"""Channels in the unit of their column that need a calibration file all the same, and why."""


@dataclass(frozen=True, slots=True)
class DirectColumn:
    """A column, the channel it comes from, and the calibration file that turns one into the other.

    instrument: None where counts at data-sheet scale are the column. why_not: what is missing where neither gives the column;
    empty otherwise.
    """

    column: FlightColumn
    channel: Channel
    instrument: Instrument | None
    why_not: str = ""

    @property
    def uncalibrated(self) -> bool:
        """Whether counts at data-sheet scale are the column."""
        return self.instrument is None and not self.why_not

    @property
    def reading(self) -> str:
        """Name of the column's values in `Readings`."""
        return self.channel.name if self.instrument is None else self.instrument.instrument


def direct_columns(
    calibration: CalibrationSet, columns: Iterable[FlightColumn] = COLUMNS, channels: Sequence[Channel] = CHANNELS
) -> tuple[DirectColumn, ...]:
    """The direct columns in table order. Raises CalibrationError for a column that no single channel leads to."""
    return tuple(_direct(c, calibration, channels) for c in columns if c.name not in COMBINED)


def _direct(column: FlightColumn, calibration: CalibrationSet, channels: Sequence[Channel]) -> DirectColumn:
    sources = sources_of(column.name, channels)
    if len(sources) != 1 or len(sources[0].columns) != 1:
        names = ", ".join(c.name for c in sources) or "none"
        raise CalibrationError(
            f"column {column.name} of the channel table: its channels are {names}; a column that no rule combines is made"
            " of exactly one channel, and that channel of no other column; correct `columns` in the table"
        )
    channel = sources[0]
    all_curves = [i for i in calibration.instruments.values() if i.curve is not None]
    curves = [i for i in all_curves if i.column == column.name]
    curves = curves or [i for i in all_curves if i.column is None and i.channel == channel.name]
    if not curves:
        return DirectColumn(column, channel, None, _why_not(column, channel))
    curve = curves[0].curve
    if curve is not None and curve.output_unit != column.unit:
        raise CalibrationError(
            f"{calibration.name}: {curves[0].instrument} gives {curve.output_unit!r} and column {column.name} is in"
            f" {column.unit!r}; correct output_unit or the unit of the column"
        )
    return DirectColumn(column, channel, curves[0])


def _why_not(column: FlightColumn, channel: Channel) -> str:
    """Why counts at data-sheet scale are not the column; empty where they are."""
    way_out = f"add a file of kind curve with channel = {channel.name!r} and output_unit = {column.unit!r} to the calibration set"
    if channel.name in _NEEDS_FILE:
        return f"{channel.name}: {_NEEDS_FILE[channel.name]}; {way_out}"
    if channel.raw_type != "bit" and channel.scale is None:
        return f"the channel table has no scale for {channel.name}; {way_out}"
    if (channel.unit or "1") != column.unit:
        return f"{channel.name} is in {channel.unit!r} and column {column.name} in {column.unit!r}; {way_out}"
    return ""
