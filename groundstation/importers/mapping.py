"""The mapping file: the flight columns and the foreign columns they are taken from, with unit and sign.

format = 1
[time]
column = "t_ms"
unit = "ms"
[columns]
ax = { column = "AccX", unit = "g" }
beta = { column = "SSA", unit = "deg", sign = -1 }
delta_a = { terms = [{ column = "ElevonL", factor = -0.5 }, { column = "ElevonR", factor = 0.5 }], unit = "deg" }
V = [{ column = "TAS", unit = "knots" }, { column = "IAS", unit = "knots", equivalent = true }]   # the first that exists
p_dynamic = { expression = "0.5 * 1.225 * IAS ** 2", unit = "Pa" }
"""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from daq.contract.channels import COLUMN_BY_NAME
from daq.utilities.input_files import read_toml
from groundstation.flight.expression import ExpressionError, parse
from groundstation.importers.errors import ImportDataError
from groundstation.importers.servos import ServoMap
from groundstation.importers.units import conversion

MAPS = Path(__file__).parent / "maps"
MOST_LINES_ABOVE = 1_000_000
"""Lines above the first row of numbers: 16 MiB of text have fewer that are not almost empty."""


class _MapTable(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


Kind = Literal["measured", "computed", "assumed"]
"""Origin of values: a sensor; a program that calculates them from others; or an assumption (a person, a board's temperature)."""


class ColumnTerm(_MapTable):
    """One summand of a flight column."""

    column: str
    factor: float = 1.0


class ColumnSource(_MapTable):
    """Source of a flight column: value = sign * factor * (sum of terms, or expression) [unit] + offset [unit], converted to SI.

    unit: None where the file states it. hold: whether values hold between samples (a command), instead of linear interpolation.
    equivalent: whether it is an airspeed at sea-level density, to be converted to true airspeed. kind: origin of its numbers,
    where the log does not show it.
    """

    column: str | None = None
    terms: tuple[ColumnTerm, ...] = ()
    expression: str | None = None
    unit: str | None = None
    sign: Literal[1, -1] = 1
    factor: float = 1.0
    offset: float = 0.0
    hold: bool = False
    equivalent: bool = False
    kind: Kind | None = None

    @model_validator(mode="after")
    def _one_origin(self) -> "ColumnSource":
        if (self.column is not None) + bool(self.terms) + (self.expression is not None) != 1:
            raise ValueError("give either column or terms or expression")
        if self.expression is not None:
            try:
                parse(self.expression)
            except ExpressionError as error:
                raise ValueError(str(error)) from error
        return self

    @property
    def parts(self) -> tuple[ColumnTerm, ...]:
        """The summands, or the columns of the expression."""
        if self.expression is not None:
            return tuple(ColumnTerm(column=name) for name in parse(self.expression).columns)
        return self.terms or (ColumnTerm(column=self.column or ""),)

    @property
    def formula(self) -> str:
        """The calculation of the column as text."""
        if self.expression is not None:
            text = self.expression if "`" in self.expression else self.expression.replace(" ", "")
        else:
            text = "+".join(t.column if t.factor == 1 else f"{t.factor:g}*{t.column}" for t in self.parts)
            text = text.replace("+-", "-")
        text = f"{self.factor:g}*({text})" if self.factor != 1 else text
        return f"-({text})" if self.sign < 0 else text


class Time(_MapTable):
    """The time column. unit 'iso' reads dates such as 2026-11-21T03:15:00.25, times of day and IRIG time; offset [s] is added.

    date: the column with the day, where `column` holds the time of day. rate_hz: instead of a column, rows at an even rate.
    restarts: the file holds several records in a row, and time starts again in each: each becomes a segment.
    """

    column: str | None = None
    unit: str = "s"
    date: str | None = None
    offset: float = 0.0
    rate_hz: Annotated[float, Field(gt=0, le=10_000)] | None = None
    restarts: bool = False

    @model_validator(mode="after")
    def _one_origin(self) -> "Time":
        if (self.column is None) == (self.rate_hz is None):
            raise ValueError("give either column, or rate_hz where the file has no time")
        return self


class FileFormat(_MapTable):
    """How a text table is written, where that cannot be guessed. names: of the columns, for a file without a header line.

    variable: of a MATLAB file, the one that holds the records.
    """

    variable: str | None = None
    names: tuple[str, ...] = ()
    delimiter: Annotated[str, Field(pattern=r"^[^\"\r\n]$")] | None = None
    decimal: Literal[".", ","] | None = None
    header_line: Annotated[int, Field(ge=1, le=MOST_LINES_ABOVE)] | None = None
    skip_after_header: Annotated[int, Field(ge=0, le=MOST_LINES_ABOVE)] = 0


def _as_list(value: object) -> object:
    return value if isinstance(value, (list, tuple)) else [value]


Sources = Annotated[tuple[ColumnSource, ...], BeforeValidator(_as_list), Field(min_length=1)]


class Map(_MapTable):
    """A whole mapping file."""

    format: Literal[1]
    title: str = ""
    aircraft: str = ""
    file: FileFormat = FileFormat()
    time: Time | None = None
    segment: str | None = None
    segment_rows: tuple[Annotated[int, Field(gt=0)], ...] = ()
    rate_hz: Annotated[float, Field(gt=0, le=1000)] | None = None
    servos: dict[str, ServoMap] = {}
    columns: dict[str, Sources] = {}

    @model_validator(mode="after")
    def _units_fit(self) -> "Map":
        for name, sources in self.columns.items():
            column = COLUMN_BY_NAME.get(name)
            for source in sources:
                if column is not None and source.unit is not None:
                    try:
                        conversion(source.unit, name, column.unit)
                    except ImportDataError as error:
                        raise ValueError(str(error)) from error
        return self

    @property
    def source_columns(self) -> set[str]:
        """The columns of the file that any source of this mapping uses."""
        return {t.column for sources in self.columns.values() for s in sources for t in s.parts}

    def over(self, base: "Map") -> "Map":
        """This mapping on top of another: columns named here replace those of the base."""
        names = ("title", "aircraft", "time", "segment", "segment_rows", "rate_hz")
        update = {name: getattr(self, name) or getattr(base, name) for name in names}
        merged = {name: {**getattr(base, name), **getattr(self, name)} for name in ("servos", "columns")}
        return base.model_copy(update={**update, **merged, "file": self.file})


def load_map(path: str | Path) -> Map:
    """Read a mapping file, or an example by its name (`ardupilot-elevon`). Raises ImportDataError naming file and key."""
    path = Path(path)
    if not path.exists() and str(path) in example_maps():
        path = MAPS / f"{path}.toml"
    table = read_toml(path, "file", ImportDataError)
    try:
        return Map.model_validate(table)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(k) for k in first["loc"] if not isinstance(k, int))
        message = first["msg"].removeprefix("Value error, ")
        raise ImportDataError(f"{path}: {key + ': ' if key else ''}{message}") from error


def built_in_map(name: str) -> Map:
    """A mapping that comes with the software: 'px4', 'ardupilot' or 'mavlink'."""
    return load_map(MAPS / f"{name}.toml")


EXAMPLE = "example: "  # beginning of an example mapping's title


def example_maps() -> tuple[str, ...]:
    """Names of the example mappings for surfaces."""
    return tuple(sorted(p.stem for p in MAPS.glob("*-*.toml")))
