"""Channels that a laboratory defines in a package of its own, without changing this one.

An installed package that names itself under the entry point group `sideslip.channels` (value: the package) has a file
`channels.toml` beside its `__init__.py`, read here as data: nothing of the package is imported for it. The channels stand
after the built-in ones in the table; everything that is derived from the table follows (docs/sensors.md).
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from daq.contract.channel_rows import (
    RAW_LIMITS,
    Channel,
    ChannelGroup,
    Downlink,
    FlightColumn,
    Rate,
    RawType,
    TableRows,
)
from daq.utilities.errors import UserError
from daq.utilities.input_files import read_toml

ENTRY_POINTS = "sideslip.channels"
ROWS_FILE = "channels.toml"

_Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=40)]
_Finite = Annotated[float, Field(allow_inf_nan=False)]


class LaboratoryError(UserError):
    """A laboratory's package whose channel file or entry point is wrong."""


class _LaboratoryRow(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _Group(_LaboratoryRow):
    name: _Name
    title: str
    device: str


class _Channel(_LaboratoryRow):
    """A row [[channel]]. Without `columns` it has one flight column, of the channel's name and unit."""

    name: _Name
    group: str
    raw_type: RawType
    unit: str
    meaning: str
    scale: _Finite | None = None
    offset: _Finite = 0.0
    rate: Rate = Rate.SCAN
    downlink: Downlink = "none"
    columns: tuple[str, ...] | None = None


class _Column(_LaboratoryRow):
    name: _Name
    unit: str
    meaning: str
    entity: Annotated[str, Field(pattern=r"^(/[a-z0-9_]+)+$")]
    plausible: tuple[_Finite, _Finite]
    title: str = ""


class _File(_LaboratoryRow):
    group: tuple[_Group, ...] = ()
    channel: tuple[_Channel, ...]
    column: tuple[_Column, ...] = ()


def with_packages(packages: Iterable[EntryPoint], table: TableRows) -> TableRows:
    """The whole table: the given rows, then those of the packages in order of name.

    Raises LaboratoryError naming file and key for a row that is wrong, or that does not fit the others.
    """
    for package in sorted({p.value for p in packages}):
        file = package_folder(package) / ROWS_FILE
        rows = read_rows(file, package)
        table = TableRows(table.groups + rows.groups, table.channels + rows.channels, table.columns + rows.columns)
        check(table, str(file))
    return table


def package_folder(package: str) -> Path:
    """Where an installed package lies, without importing it. Raises LaboratoryError when it is not a package."""
    spec = find_spec(package)
    if spec is None or not spec.submodule_search_locations:
        raise LaboratoryError(
            f"entry point {ENTRY_POINTS} = {package!r} is no package (a folder with __init__.py and {ROWS_FILE});"
            " correct it or uninstall what declares it"
        )
    return Path(spec.submodule_search_locations[0])


def calibration_files() -> dict[str, bytes]:
    """File name -> content of the calibration files that laboratory packages have in a folder `calibration`."""
    packages = sorted({p.value for p in entry_points(group=ENTRY_POINTS)})
    folders = [package_folder(package) / "calibration" for package in packages]
    return {file.name: file.read_bytes() for folder in folders for file in sorted(folder.glob("*.toml"))}


def read_rows(file: Path, package: str) -> TableRows:
    """The rows of a package. Raises LaboratoryError naming file and key."""
    try:
        read = _File.model_validate(read_toml(file, "file of a laboratory's package", LaboratoryError))
    except ValidationError as error:
        first = error.errors()[0]
        raise LaboratoryError(
            f"{file}: {'.'.join(map(str, first['loc']))}: {first['msg']}; see docs/sensors.md"
        ) from error
    channels = tuple(_channel(row, package) for row in read.channel)
    columns = tuple(FlightColumn(**row.model_dump()) for row in read.column)
    column_names = {c.name for c in columns}
    implied = tuple(_column(c) for r, c in zip(read.channel, channels, strict=True) if r.columns is None)
    return TableRows(
        tuple(ChannelGroup(**row.model_dump(), package=package) for row in read.group),
        channels,
        (*columns, *(c for c in implied if c.name not in column_names)),
    )


def _channel(row: _Channel, package: str) -> Channel:
    values = row.model_dump()
    values["columns"] = (row.name,) if row.columns is None else row.columns
    return replace(Channel(**values), package=package)


def _column(channel: Channel) -> FlightColumn:
    """The flight column of a channel without `columns`; its plausible range is the range of its counts."""
    ends = sorted(count * (channel.scale or 1.0) + channel.offset for count in RAW_LIMITS[channel.raw_type])
    return FlightColumn(channel.name, channel.unit or "1", channel.meaning, f"/{channel.group}", (ends[0], ends[1]))


def check(table: TableRows, where: str) -> None:
    """Raise LaboratoryError for a table whose names collide or lead nowhere."""
    for mistake in _mistakes(table):
        raise LaboratoryError(f"{where}: {mistake}")


def _mistakes(table: TableRows) -> Iterator[str]:
    groups = [g.name for g in table.groups]
    columns = [c.name for c in table.columns]
    fields_of_scan = [c.name for c in table.channels] + [g + end for g in groups for end in ("_state", "_offset_us")]
    for kind, names in (("group", groups), ("channel or state", fields_of_scan), ("column", columns)):
        repeated = sorted({n for n in names if names.count(n) > 1})
        if repeated:
            yield f"{kind} {repeated[0]} is already in the channel table; choose another name"
    for channel in table.channels:
        if channel.group not in groups:
            yield f"channel {channel.name}: no group {channel.group!r}; add [[group]] name = {channel.group!r}"
        unknown = [c for c in channel.columns if c not in columns]
        if unknown:
            yield f"channel {channel.name}: no column {unknown[0]!r}; add [[column]] name = {unknown[0]!r}"
    for group in table.groups:
        if group.package and not any(c.group == group.name for c in table.channels):
            yield f"group {group.name} has no channel"
