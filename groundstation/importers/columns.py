"""Flight columns from the series of a log: combined, in SI, on one time base, each with its origin."""

import re
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import count

import numpy as np

from daq.contract.channels import COLUMN_BY_NAME
from daq.utilities.constants import SEA_LEVEL_DENSITY
from daq.utilities.plain_words import LONGEST_NAME, listed
from groundstation.flight.arrays import Array, unwrapped
from groundstation.flight.contradictions.air import air_density
from groundstation.flight.expression import parse
from groundstation.flight.findings import Finding, FindingKind, unknown_columns
from groundstation.flight.flight import BACK, DATED_BACK, HELD, INTERVAL
from groundstation.importers.errors import ImportDataError
from groundstation.importers.formats.tables import RECORD
from groundstation.importers.mapping import ColumnSource, Kind, Map
from groundstation.importers.origins import AIR_RELATIVE, COMPUTED, is_command, kind_of, kind_of_all
from groundstation.importers.series import Log, TimeSeries, lagged, native_rate, resample
from groundstation.importers.units import conversion, find_unit, known_units

_WRAPPED = ("phi", "psi")


@dataclass(frozen=True, slots=True)
class ColumnOrigin:
    """How a flight column was made. source: the one chosen, with its unit; kind: measured, computed or assumed; rate: of its
    series [Hz], None for that of the table; name: of the column in the flight; held: interval of a command's records [s], None
    for a measurement; lag: of the servo that follows the command [s]."""

    source: ColumnSource
    kind: Kind
    rate: float | None
    name: str
    held: float | None = None
    lag: float = 0.0

    def to_json(self, rate: float) -> dict[str, object]:
        """An entry of `channels` in `import --json`. rate: of the time base [Hz]."""
        native = self.rate if self.rate is not None else rate
        entry = {"from": self.source.formula, "kind": self.kind, "rate_hz": native}
        if self.held is not None:
            dated_back = DATED_BACK * self.held if self.rate is not None else 0.0
            entry |= {HELD: True, INTERVAL: self.held, BACK: dated_back, "servo_lag_s": self.lag}
        return entry | {"column": self.name}


@dataclass(frozen=True)
class ImportedColumns:
    """values: by name in the flight (N,); origins: flight column -> how it was made; notes: for the flight."""

    values: dict[str, Array]
    origins: dict[str, ColumnOrigin]
    notes: tuple[Finding | str, ...]


def flight_columns(log: Log, mapping: Map, time: Array, resampled: bool) -> ImportedColumns:
    """The mapped columns of a log on a time base (N,), and of a table also those that the mapping does not name.

    An airspeed or flow angle that the autopilot computed from attitude and a guessed wind is no measurement: it gets a name with
    `_computed`. Raises ImportDataError where neither mapping nor file states a unit.
    """
    values: dict[str, Array] = {}
    origins: dict[str, ColumnOrigin] = {}
    absent: list[str] = []
    notes: list[Finding | str] = []
    for name, sources in mapping.columns.items():
        source = chosen_source(log, sources)
        if source is None:
            absent.append(f"{name} ({' + '.join(t.column for t in sources[0].parts)})")
            continue
        source = source.model_copy(update={"unit": _unit(log, source, name)})
        kind = flight_kind(log, source)
        label = f"{name}_computed" if kind == COMPUTED and name in AIR_RELATIVE else name
        rate = min(native_rate(log.series[t.column]) for t in source.parts) if resampled else None
        origins[name] = ColumnOrigin(source, kind, rate, label, *_command_timing(log, source))
        values[label] = _value(log, source, name, time)
        if label != name:
            text = f"{name} by {source.formula} is computed, not measured: kept as {label}, and not used as {name}"
            notes.append(Finding(FindingKind.NOT_MEASURED, text))
    _convert_to_true_airspeed(values, origins, notes)
    if absent:
        notes.append(f"not in the file, so not measured: {listed(absent, 60)}")
    if log.common:
        notes += _unmapped(log, mapping, time, values, origins)
    return ImportedColumns(values, origins, tuple(notes))


def chosen_source(log: Log, sources: Iterable[ColumnSource]) -> ColumnSource | None:
    """The first source whose columns the log has, measured ones before computed ones; None without one."""
    complete = [s for s in sources if all(t.column in log.series for t in s.parts)]
    return next((s for s in complete if flight_kind(log, s) != COMPUTED), complete[0] if complete else None)


def flight_kind(log: Log, source: ColumnSource) -> Kind:
    """Whether a source is measured, computed or assumed: an expression as its first column, which the others correct; a sum as
    the least certain of its columns."""
    if source.kind is not None:
        return source.kind
    parts = [t.column for t in source.parts]
    return kind_of(log, parts[0]) if source.expression is not None else kind_of_all(log, parts)


def _command_timing(log: Log, source: ColumnSource) -> tuple[float | None, float]:
    """Interval [s] at which a command was recorded, None for a measurement; and the lag of its servo [s]."""
    parts = [log.series[t.column] for t in source.parts if is_command(log, t.column)]
    if not (source.hold or len(parts) == len(source.parts)):
        return None, 0.0
    slowest = min(native_rate(log.series[t.column]) for t in source.parts)
    return (1.0 / slowest if slowest > 0.0 else 0.0), max((p.lag for p in parts), default=0.0)


def _convert_to_true_airspeed(
    values: dict[str, Array], origins: dict[str, ColumnOrigin], notes: list[Finding | str]
) -> None:
    """Convert equivalent to true airspeed by the flight's density, in place; add that density as a column where there is none."""
    airspeed = origins.get("V")
    if airspeed is None or not airspeed.source.equivalent or airspeed.name not in values:
        return
    words = f"V by {airspeed.source.formula} is equivalent airspeed"
    measured = {n: v for n, v in values.items() if np.isfinite(v).any()}
    air = air_density(measured)
    if air is None:
        notes.append(f"{words}, and the density is not known: taken as true airspeed")
        return
    density, columns = air.values, air.source
    if "rho" not in measured:
        values["rho"] = density
        source = ColumnSource(column=columns, unit="kg/m3")
        origins["rho"] = ColumnOrigin(source, COMPUTED, airspeed.rate, "rho")
    with np.errstate(invalid="ignore", divide="ignore"):
        values[airspeed.name] = values[airspeed.name] * np.sqrt(SEA_LEVEL_DENSITY / density)
    notes.append(f"{words}: made true by the density of {columns} ({float(np.nanmedian(density)):.3g} kg/m3)")


def _unmapped(
    log: Log, mapping: Map, time: Array, values: dict[str, Array], origins: dict[str, ColumnOrigin]
) -> list[Finding | str]:
    """The columns of a table that no mapping names, under plain names, and notes on them."""
    mapped = {t.column for m in origins.values() for t in m.source.parts} | {mapping.segment or RECORD, RECORD}
    labels = {_plain_name(n, set(values)): n for n in log.series if n not in mapped}
    series = {name: log.series[label] for name, label in labels.items()}
    values |= {n: s.values if time is s.time else resample(s, time) for n, s in series.items()}
    notes: list[Finding | str] = [unknown_columns(labels)] if labels else []
    if log.text_columns:
        notes.append(f"columns that are not numbers, left out: {listed(log.text_columns)}")
    return notes


def _plain_name(name: str, existing: set[str]) -> str:
    """A column name of letters, digits and underscores, as the flight format needs it, that does not exist yet."""
    ascii_name = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
    label = re.sub(r"\W+", "_", ascii_name[:LONGEST_NAME]).strip("_") or "column"
    label = f"_{label}" if label[0].isdigit() else label
    if label in ("time", "segment") or (label != name and label in COLUMN_BY_NAME):
        label += "_other"
    numbered = (label if n == 0 else f"{label}_{n}" for n in count())
    return next(name for name in numbered if name not in existing)


def _unit(log: Log, source: ColumnSource, name: str) -> str:
    """The unit of a source by the mapping, else by the file. Raises ImportDataError where a unit is needed and neither states
    one."""
    if source.unit is not None:
        return source.unit
    units = {log.units.get(t.column, "") for t in source.parts}
    if len(units) == 1 and find_unit(unit := units.pop()) is not None and unit:
        return unit
    si = COLUMN_BY_NAME[name].unit if name in COLUMN_BY_NAME else "1"
    if si == "1":
        return si
    columns = listed(t.column for t in source.parts)
    raise ImportDataError(
        f"column {name}: the mapping does not say in which unit {columns} is; add it, for example "
        f'{name} = {{ column = "{columns}", unit = "{si}" }}, or one of: {known_units(si)}'
    )


def _value(log: Log, source: ColumnSource, name: str, time: Array) -> Array:
    """(N,) flight column `name` in SI on the time base; phi and psi of a log within +-pi."""
    si = COLUMN_BY_NAME[name].unit if name in COLUMN_BY_NAME else None
    scale, offset = conversion(source.unit or "1", name, si) if si is not None else (1.0, 0.0)

    def on_base(column: str) -> Array:
        series = log.series[column]
        if time is series.time:
            return lagged(series.time, series.values, series.lag) if series.lag else series.values
        return resample(_unwrapped(series, name, scale), time, hold=source.hold or is_command(log, column))

    if source.expression is not None:
        expression = parse(source.expression)
        total = expression.values({n: on_base(n) for n in expression.columns})
    else:
        total = sum((term.factor * on_base(term.column) for term in source.parts), np.zeros(time.size))
    value = (source.sign * source.factor * total + source.offset) * scale + offset
    if name in _WRAPPED and not log.common:
        value = (value + np.pi) % (2 * np.pi) - np.pi
    return np.asarray(value)


def _unwrapped(series: TimeSeries, name: str, scale: float) -> TimeSeries:
    """The series, continuous where it is phi or psi, for interpolation: between 359 and 1 deg lies 0, not 180."""
    if name not in _WRAPPED:
        return series
    return TimeSeries(series.time, unwrapped(series.values * scale) / scale)


def source_text(source: ColumnSource) -> str:
    """The calculation of a column with its unit, for the provenance."""
    if source.expression is not None:
        terms = source.expression
    else:
        terms = " + ".join(t.column if t.factor == 1 else f"{t.factor:g} {t.column}" for t in source.parts)
    sign = "-" if source.sign < 0 else ""
    factor = "" if source.factor == 1 else f"{source.factor:g} "
    shift = f" + {source.offset:g}" if source.offset else ""
    return f"{sign}{factor}({terms}){shift} [{source.unit}]"
