"""Flight columns from the series of a log: combined, in SI, on one time base, with whence each comes."""

import re
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.contract.channels import COLUMN_BY_NAME
from daq.contract.constants import SEA_LEVEL_DENSITY
from daq.contract.plain_words import LONGEST_NAME, listed
from groundstation.flight.contradictions.air import independent_density
from groundstation.flight.expression import parse
from groundstation.flight.flight import HELD, INTERVAL
from groundstation.flight.notes import Note, NoteKind, unknown_columns
from groundstation.importers.errors import ImportDataError
from groundstation.importers.formats.tables import RECORD
from groundstation.importers.mapping import ColumnSource, Kind, Map
from groundstation.importers.origins import COMPUTED, NOT_FLOWN, is_command, kind_of, kind_of_all
from groundstation.importers.series import DATED_BACK, Log, TimeSeries, lagged, native_rate, resample
from groundstation.importers.units import conversion, find_unit, known_units

Array = NDArray[np.float64]

_WRAPPED = ("phi", "psi")


@dataclass(frozen=True, slots=True)
class Made:
    """A flight column as made: source: the one chosen, with its unit; kind: whence its numbers are; rate: its own [Hz], None for
    that of the table; name: under which it stands in the flight; held: of a command, the interval of its records [s]; lag: of the
    servo that follows it [s]."""

    source: ColumnSource
    kind: Kind
    rate: float | None
    name: str
    held: float | None = None
    lag: float = 0.0

    def to_json(self, rate: float) -> dict[str, object]:
        """As in `channels` of `import --json`. rate: of the time base [Hz]."""
        about = {
            "from": self.source.formula,
            "kind": self.kind,
            "rate_hz": self.rate if self.rate is not None else rate,
        }
        if self.held is not None:
            back = DATED_BACK * self.held if self.rate is not None else 0.0
            about |= {HELD: True, INTERVAL: self.held, "dated_back_s": back, "servo_lag_s": self.lag}
        return about | ({"column": self.name} if self.name != "" else {})


@dataclass(frozen=True)
class ImportedColumns:
    """values: by name in the flight (N,); made: flight column -> how; notes."""

    values: dict[str, Array]
    made: dict[str, Made]
    notes: tuple[Note | str, ...]


def flight_columns(log: Log, chosen: Map, time: Array, resampled: bool) -> ImportedColumns:
    """All that a mapping makes of a log on a time base (N,), and of a table the columns that no mapping names.

    What a program of the aircraft computed of attitude and a guessed wind is no airspeed and no flow angle: it stands under a
    name of its own. Raises ImportDataError for a unit that nobody states.
    """
    values: dict[str, Array] = {}
    made: dict[str, Made] = {}
    absent: list[str] = []
    notes: list[Note | str] = []
    for name, sources in chosen.columns.items():
        source = chosen_source(log, sources)
        if source is None:
            absent.append(f"{name} ({' + '.join(t.column for t in sources[0].parts)})")
            continue
        source = source.model_copy(update={"unit": _unit(log, source, name)})
        kind = flight_kind(log, source)
        under = f"{name}_computed" if kind == COMPUTED and name in NOT_FLOWN else name
        rate = min(native_rate(log.series[t.column]) for t in source.parts) if resampled else None
        made[name] = Made(source, kind, rate, under, *_held(log, source))
        values[under] = _value(log, source, name, time)
        if under != name:
            text = f"{name} by {source.formula} is computed, not measured: kept as {under}, and not used as {name}"
            notes.append(Note(NoteKind.NOT_MEASURED, text))
    _made_true(values, made, notes)
    if absent:
        notes.append(f"not in the file, so not measured: {listed(absent, 60)}")
    if log.common:
        notes += _others(log, chosen, time, values, made)
    return ImportedColumns(values, made, tuple(notes))


def chosen_source(log: Log, sources: Iterable[ColumnSource]) -> ColumnSource | None:
    """The first source of which the log has all; one that was measured before one that was computed."""
    there = [s for s in sources if all(t.column in log.series for t in s.parts)]
    return next((s for s in there if flight_kind(log, s) != COMPUTED), there[0] if there else None)


def flight_kind(log: Log, source: ColumnSource) -> Kind:
    """Whence a source is: of an expression that of its first column, which the others correct; of several, the worst."""
    if source.kind is not None:
        return source.kind
    parts = [t.column for t in source.parts]
    return kind_of(log, parts[0]) if source.expression is not None else kind_of_all(log, parts)


def _held(log: Log, source: ColumnSource) -> tuple[float | None, float]:
    """Interval [s] at which a command was recorded and the lag of its servo; None for what a sensor saw."""
    parts = [log.series[t.column] for t in source.parts if is_command(log, t.column)]
    if not (source.hold or len(parts) == len(source.parts)):
        return None, 0.0
    slowest = min(native_rate(log.series[t.column]) for t in source.parts)
    return (1.0 / slowest if slowest > 0.0 else 0.0), max((p.lag for p in parts), default=0.0)


def _made_true(values: dict[str, Array], made: dict[str, Made], notes: list[Note | str]) -> None:
    """Equivalent airspeed made true by the density of the flight, in place; and that density as a column where there is none."""
    about = made.get("V")
    if about is None or not about.source.equivalent or about.name not in values:
        return
    known = {n: v for n, v in values.items() if np.isfinite(v).any()}
    found = (known["rho"], "rho") if "rho" in known else independent_density(known)
    if found is None:
        notes.append(
            f"V by {about.source.formula} is equivalent airspeed, and nothing tells the density: taken for true airspeed"
        )
        return
    density, by = found
    if "rho" not in known:
        values["rho"] = density
        source = ColumnSource(column=by.split(" and ")[0], unit="kg/m3")
        made["rho"] = Made(source.model_copy(update={"column": by}), COMPUTED, about.rate, "rho")
    with np.errstate(invalid="ignore", divide="ignore"):
        values[about.name] = values[about.name] * np.sqrt(SEA_LEVEL_DENSITY / density)
    notes.append(
        f"V by {about.source.formula} is equivalent airspeed: made true by the density of {by} "
        f"({float(np.nanmedian(density)):.3g} kg/m3)"
    )


def _others(log: Log, chosen: Map, time: Array, values: dict[str, Array], made: dict[str, Made]) -> list[Note | str]:
    """The columns of a table that no mapping names, under plain names, and notes on them."""
    taken = {t.column for m in made.values() for t in m.source.parts} | {chosen.segment or RECORD, RECORD}
    left = {n: _plain_name(n, set(values)) for n in log.series if n not in taken}
    values.update(
        {
            to: log.series[n].values if time is log.series[n].time else resample(log.series[n], time)
            for n, to in left.items()
        }
    )
    notes: list[Note | str] = [unknown_columns({to: n for n, to in left.items()})] if left else []
    if log.text_columns:
        notes.append(f"columns that are not numbers, left out: {listed(log.text_columns)}")
    return notes


def _plain_name(name: str, taken: set[str]) -> str:
    """A column name of letters, digits and underscores, as the flight format needs it; not one that is taken."""
    ascii_name = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
    plain = re.sub(r"\W+", "_", ascii_name[:LONGEST_NAME]).strip("_") or "column"
    plain = f"_{plain}" if plain[0].isdigit() else plain
    if plain in ("time", "segment") or (plain != name and plain in COLUMN_BY_NAME):
        plain += "_other"
    first, number = plain, 1
    while plain in taken:
        plain, number = f"{first}_{number}", number + 1
    taken.add(plain)
    return plain


def _unit(log: Log, source: ColumnSource, name: str) -> str:
    """The unit of a source: as the mapping states it, else as the file does. Raises ImportDataError where one is needed and
    neither does."""
    if source.unit is not None:
        return source.unit
    stated = {log.units.get(t.column, "") for t in source.parts}
    if len(stated) == 1 and find_unit(unit := stated.pop()) is not None and unit:
        return unit
    si = COLUMN_BY_NAME[name].unit if name in COLUMN_BY_NAME else "1"
    if si == "1":
        return si
    named = listed(t.column for t in source.parts)
    raise ImportDataError(
        f"column {name}: the mapping does not say in which unit {named} is; add it, for example "
        f'{name} = {{ column = "{named}", unit = "{si}" }}, or one of: {known_units(si)}'
    )


def _value(log: Log, source: ColumnSource, name: str, time: Array) -> Array:
    si = COLUMN_BY_NAME[name].unit if name in COLUMN_BY_NAME else None
    scale, offset = conversion(source.unit or "1", name, si) if si is not None else (1.0, 0.0)

    def on_base(column: str) -> Array:
        series = log.series[column]
        if time is series.time:
            return lagged(series.time, series.values, series.lag) if series.lag else series.values
        return resample(_unwrapped(series, name, scale), time, hold=source.hold or is_command(log, column))

    if source.expression is not None:
        expression = parse(source.expression)
        total = expression.of({n: on_base(n) for n in expression.columns})
    else:
        total = np.zeros(time.size)
        for term in source.parts:
            total = total + term.factor * on_base(term.column)
    value = (source.sign * source.factor * total + source.offset) * scale + offset
    if name in _WRAPPED and not log.common:
        value = (value + np.pi) % (2 * np.pi) - np.pi
    return np.asarray(value)


def _unwrapped(series: TimeSeries, name: str, scale: float) -> TimeSeries:
    """A heading made continuous before it is interpolated: between 359 and 1 deg lies 0, not 180."""
    if name not in _WRAPPED:
        return series
    values = series.values.copy()
    good = np.isfinite(values)
    values[good] = np.unwrap(values[good] * scale) / scale
    return TimeSeries(series.time, values)


def spoken(source: ColumnSource) -> str:
    """How a column was made, for the provenance."""
    if source.expression is not None:
        terms = source.expression
    else:
        terms = " + ".join(t.column if t.factor == 1 else f"{t.factor:g} {t.column}" for t in source.parts)
    sign = "-" if source.sign < 0 else ""
    factor = "" if source.factor == 1 else f"{source.factor:g} "
    shift = f" + {source.offset:g}" if source.offset else ""
    return f"{sign}{factor}({terms}){shift} [{source.unit}]"
