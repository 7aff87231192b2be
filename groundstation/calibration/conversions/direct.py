"""Flight columns that are one channel and nothing else: by its calibration curve, or as they are at data-sheet scale.

Every column of the table that no rule of `columns` combines from several instruments is one of these, so a channel added to
the table is a column of the flight, or an error that says what is missing; never a column of NaN.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from daq.contract.channels import CHANNELS, COLUMNS, Channel, FlightColumn, sources_of
from groundstation.calibration.errors import CalibrationError
from groundstation.calibration.schema import CalibrationSet, Instrument

COMBINED = frozenset(
    "ax ay az p q r phi theta psi alpha beta V V_cas delta_e delta_a cmd_e cmd_a rho p_static p_dynamic temperature "
    "altitude latitude longitude altitude_gnss vn ve vd mx my mz".split()
)
"""Columns that `columns.Columns` makes by a rule of their own."""


_NEEDS_FILE = {"supply": "it is behind a divider whose ratio the channel table does not know"}
"""Channels in the unit of their column that are not it."""


@dataclass(frozen=True, slots=True)
class DirectColumn:
    """A column, the channel it comes from, and the calibration file that turns one into the other.

    None: counts at data-sheet scale. why_not: what is missing where neither gives the column; empty otherwise.
    """

    column: FlightColumn
    channel: Channel
    instrument: Instrument | None
    why_not: str = ""

    @property
    def as_it_is(self) -> bool:
        """Whether counts at data-sheet scale are the column."""
        return self.instrument is None and not self.why_not

    @property
    def reading(self) -> str:
        """Name of its values among the readings of all instruments."""
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
    curves = [i for i in calibration.instruments.values() if i.curve is not None and i.channel == channel.name]
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
