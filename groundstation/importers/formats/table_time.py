"""The time of a table's rows from a column of numbers, dates, times of day, IRIG time or day numbers; clocks that step back.

IRIG 200-04: day of the year, hours, minutes and seconds as DDD:HH:MM:SS.mmm.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

import numpy as np

from daq.utilities.plain_words import listed, one_line, plain_name
from groundstation.flight.arrays import Array, Mask
from groundstation.flight.files.csv_columns import is_number
from groundstation.flight.quality.plausibility import DAY_NUMBERS
from groundstation.importers.errors import ImportDataError
from groundstation.importers.mapping import Time
from groundstation.importers.series import RECORD_GAP
from groundstation.importers.units import find_unit

DAY, HOUR = 86400.0, 3600.0
SHORTEST_RUN = 8  # rows between two steps back of a clock that was set; shorter runs are rows out of order
EXCEL_DAYS, MATLAB_DAYS = DAY_NUMBERS
LONGEST_FLIGHT_DAYS = 2.0  # of values that are recognised as day numbers
LARGEST_SECONDS = 1e6
"""[s] of a first stamp: larger ones (us since 1970, days since 1899) are counted from the first, to keep their digits."""
FEWEST_ROWS = 10  # of coarse stamps that are put on even times
MOST_STEPS, STEP_DECIMALS = 4, 6
"""Different steps of coarse stamps, at most, and the decimals [s] to which steps are compared."""
SENTINELS = (-9999.0, -999.0, -99999.0, -9999.99, -999.99, -32768.0, 9999.0, 99999.0, 1e20, -1e20)
"""Numbers that programs write for a missing value."""
OUTLIER_FACTOR = 5.0  # times the largest other value of a column, from which such a number counts as missing
FEWEST_VALUES = 3  # other values of a column, for that comparison
COARSE_TOLERANCE = 1.1  # resolutions of a coarse stamp, by which it may differ from its even time

YEAR_DAYS = 365
_CLOCK = re.compile(r"(?:(\d{1,3}):)?(\d{1,2}):(\d{2}):(\d{2}(?:[.,:]\d*)?)(?:\s*([AaPp])\.?[Mm]\.?)?")
"""Time of day, after the day of the year in IRIG time, or before AM or PM."""
_MINUTES = re.compile(r"(\d{1,2}):(\d{2}[.,]\d+)")
"""Minutes and seconds, as Excel shows a time of day and writes it to CSV."""
_CALENDAR = re.compile(r"(\d{1,4}[./-]\d{1,2}[./-]\d{1,4})[ T,]+(\d.*)")
"""A date in any order of its numbers, and a time of day. The order does not matter: a new date is a new day."""

_SECONDS = re.compile(r"(?i)(?P<head>(?:.*[._/ ])?(?:tv_?)?)(?:sec|secs|seconds)")
_NANOSECONDS = re.compile(r"(?i)n(?:ano)?_?(?:sec|secs|seconds)")
_ONE_STAMP = (re.compile(r"(?i)(?:.*[._/])?header[._/]stamp"), re.compile(r"%time"))


@dataclass(frozen=True)
class Stamps:
    """seconds: (N,) times of the rows [s], NaN where missing; record: (N,) number of each row's record, None for one record;
    origin: time of the file's clock at 0 [s]."""

    seconds: Array
    record: Array | None = None
    notes: tuple[str, ...] = ()
    origin: float = 0.0


def stamps_of(
    path: Path,
    numeric: Mapping[str, Array],
    words: Mapping[str, Sequence[str]],
    dates: Mapping[str, Array],
    time: Time,
) -> Stamps:
    """The time of each row. numeric: columns of numbers (N,); words: cells of text columns; dates: columns of dates (N,) [s].

    Raises ImportDataError naming column and cell for a time that cannot be read.
    """
    name = time.column
    if name is None:
        rows = len(next(iter(numeric.values()), np.zeros(0)))
        stamps = Stamps(np.arange(rows) / float(time.rate_hz or 1.0))
    elif name in dates:
        stamps = _with_seconds_filled(name, Stamps(dates[name]))
    elif name in words:
        stamps = _with_seconds_filled(
            name, _stamps_of_words(path, name, words[name], words.get(time.date or "", ()), time)
        )
    elif name in numeric:
        stamps = _stamps_of_numbers(path, name, numeric[name], time)
    else:
        columns = listed([*numeric, *words, *dates], 12)
        raise ImportDataError(f"{path}: no column {name!r} for the time; found {columns}")
    stamps = replace(stamps, seconds=stamps.seconds + time.offset)
    if not time.restarts:
        return _records_where_set_back(stamps)
    restarts = np.diff(stamps.seconds) <= 0
    if not restarts.any():
        raise ImportDataError(f"{path}: restarts = true, but time never begins anew")
    return _records_in_sequence(stamps, restarts)


# ----------------------------------------------------------------------------------------------------------- ROS headers


@dataclass(frozen=True)
class SenderStamp:
    """seconds: (N,) since `first` [s since 1970]; columns: of the table from which it is computed."""

    seconds: Array
    first: float
    columns: tuple[str, ...]


def stamp_columns(names: Sequence[str]) -> tuple[str, ...]:
    """The columns of a ROS header's stamp as exporters of bags write them: seconds and nanoseconds (bagpy, ros2 tools), or one
    with nanoseconds (`rostopic echo -p`: field.header.stamp, or %time of the receiver); empty without a stamp."""
    for name in names:
        match = _SECONDS.fullmatch(name.strip())
        if match:
            partner = next((n for n in names if _NANOSECONDS.fullmatch(n.strip().removeprefix(match["head"]))), None)
            if partner is not None and partner.strip().startswith(match["head"]):
                return name, partner
    return next(((n,) for pattern in _ONE_STAMP for n in names if pattern.fullmatch(n.strip())), ())


def sender_stamp(numeric: Mapping[str, Array]) -> SenderStamp | None:
    """The stamp of a ROS header among columns of numbers (N,); None where there is none."""
    columns = stamp_columns(tuple(numeric))
    if not columns or not all(np.isfinite(numeric[n]).any() for n in columns):
        return None
    first = float(np.nanmin(numeric[columns[0]]))
    if len(columns) == 1:
        return SenderStamp((numeric[columns[0]] - first) * 1e-9, first * 1e-9, columns)
    return SenderStamp(numeric[columns[0]] - first + 1e-9 * numeric[columns[1]], first, columns)


# ------------------------------------------------------------------------------------------------------------- numbers


def _stamps_of_numbers(path: Path, name: str, values: Array, time: Time) -> Stamps:
    """Stamps from numbers (N,) in the unit of `time`."""
    if time.unit == "iso":
        raise ImportDataError(f"{path}: time column {name!r} is a number, not a date; state its unit instead of iso")
    unit = find_unit(time.unit)
    if unit is None or unit.si != "s":
        raise ImportDataError(f"{path}: time unit {time.unit!r} is not known; s, ms, us, ns, min, h, days or iso")
    if not np.isfinite(values).any():
        raise ImportDataError(f"{path}: time column {name!r} holds no number")
    epoch = _epoch_words(values)
    if epoch and unit.scale in (60.0, 3600.0):
        raise ImportDataError(
            f"{path}: time column {name!r} runs from {np.nanmin(values):.6f} to {np.nanmax(values):.6f}, which are days {epoch}, "
            f'not {time.unit}; say so in a mapping file: [time] unit = "days"'
        )
    first = np.nanmin(values) if unit.scale != 1 and np.nanmin(values) * unit.scale > LARGEST_SECONDS else 0.0
    seconds = np.asarray((values - first) * unit.scale)
    origin = float(first * unit.scale)
    if unit.scale == DAY:
        regular = _regular_times(seconds)
        note = f"time column {name}: days {epoch}" if epoch else f"time column {name}: days"
        if regular is None:
            return Stamps(seconds, notes=(note,), origin=origin)
        return Stamps(regular, notes=(note, "its stamps are coarse, and were put on even times"), origin=origin)
    return _with_seconds_filled(name, Stamps(seconds, origin=origin))


def _epoch_words(values: Array) -> str:
    """The epoch in words of values that are probably day numbers: fractional, of the present age, within LONGEST_FLIGHT_DAYS;
    empty for others."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    if high - low > LONGEST_FLIGHT_DAYS or not np.any(values % 1.0):
        return ""
    for (first, last), words in ((EXCEL_DAYS, "since 1899-12-30 (Excel)"), (MATLAB_DAYS, "since the year 0 (MATLAB)")):
        if first < low and high < last:
            return words
    return ""


def _regular_times(seconds: Array) -> Array | None:
    """(N,) even times that the stamps (N,) round; None for stamps that are not coarse, or not even."""
    steps = np.diff(seconds)
    if seconds.size < FEWEST_ROWS or not np.all(steps > 0):
        return None
    distinct = np.unique(np.round(steps, STEP_DECIMALS))
    if distinct.size > MOST_STEPS:
        return None
    resolution = float(np.min(np.diff(distinct))) if distinct.size > 1 else 0.0
    row = np.arange(seconds.size)
    step = (seconds[-1] - seconds[0]) / (seconds.size - 1)
    regular = seconds[0] + step * row
    regular = regular + float(np.median(seconds - regular))
    return regular if np.max(np.abs(seconds - regular)) <= COARSE_TOLERANCE * resolution else None


def _with_seconds_filled(name: str, stamps: Stamps) -> Stamps:
    """The stamps, with the rows spread over each second where stamps are whole seconds."""
    spread = _spread_over_seconds(stamps.seconds)
    if spread is None:
        return stamps
    note = f"time column {plain_name(name)} has whole seconds only: its rows were spread over each second"
    return replace(stamps, seconds=spread, notes=(*stamps.notes, note))


def _spread_over_seconds(seconds: Array) -> Array | None:
    """(N,) stamps with the rows of each whole second spread over it, in their order; None where stamps are not whole seconds, or
    too few rows share one.

    The first second is usually incomplete, and so is the last: the rows of the first are put at its end, those of the last at
    its beginning.
    """
    if (
        seconds.size < FEWEST_ROWS
        or not np.all(np.isfinite(seconds))
        or np.any(seconds % 1.0)
        or np.any(np.diff(seconds) < 0)
    ):
        return None
    begins = np.flatnonzero(np.concatenate([[True], np.diff(seconds) > 0]))
    counts = np.diff(np.append(begins, seconds.size))
    if counts.size < 3 or np.median(counts) < 2:
        return None
    typical = float(np.median(counts[1:-1]))
    row_in_second = np.arange(seconds.size) - np.repeat(begins, counts)
    rows_per_second = np.maximum(np.repeat(counts, counts), typical)
    spread = seconds + row_in_second / rows_per_second
    spread[: counts[0]] += max(typical - counts[0], 0.0) / typical
    return np.asarray(spread)


# --------------------------------------------------------------------------------------------------------------- words


def _stamps_of_words(path: Path, name: str, cells: Sequence[str], days: Sequence[str], time: Time) -> Stamps:
    """Stamps from text: dates or times of day. days: cells of the column of dates, or empty."""
    first = next((c for c in cells if c), "")
    if _CLOCK.fullmatch(first):
        return _stamps_of_times_of_day(path, name, cells, days)
    if _MINUTES.fullmatch(first):
        return _stamps_of_minutes(path, name, cells)
    match = _CALENDAR.fullmatch(first)
    if match is not None and _CLOCK.fullmatch(match[2]) and not _is_date(first):
        split = [cell.partition(match[0][len(match[1])]) for cell in cells]
        return _stamps_of_times_of_day(path, name, [c.lstrip(" T,") for _, _, c in split], [day for day, _, _ in split])
    if time.unit != "iso" and not _is_date(first):
        word = next((c for c in cells if c and not is_number(c)), first)
        raise ImportDataError(
            f'{path}: time column {name!r} holds {one_line(word, 60)!r}, not a number; dates need unit = "iso"'
        )
    return _stamps_of_dates(path, name, cells)


def _is_date(cell: str) -> bool:
    try:
        datetime.fromisoformat(cell)
    except ValueError:
        return False
    return not cell.isdigit()


def _stamps_of_dates(path: Path, name: str, cells: Sequence[str]) -> Stamps:
    stamps = []
    for cell in cells:
        try:
            stamps.append(datetime.fromisoformat(cell))
        except ValueError:
            raise ImportDataError(
                f"{path}: time column {name!r}: {one_line(cell, 60)!r} is not a date like 2026-11-21T03:15:00.25"
            ) from None
    if not stamps:
        raise ImportDataError(f"{path}: time column {name!r} is empty")
    zoned = [s.tzinfo is not None for s in stamps]
    if any(zoned) and not all(zoned):
        with_zone, zoneless = zoned.index(True), zoned.index(False)
        raise ImportDataError(
            f"{path}: time column {name!r}: row {zoneless + 1} ({one_line(cells[zoneless], 40)}) has no time zone, row "
            f"{with_zone + 1} ({one_line(cells[with_zone], 40)}) has one; write the same in all rows"
        )
    epoch = datetime(1970, 1, 1, tzinfo=UTC if zoned[0] else None)
    seconds = np.array([(s - stamps[0]).total_seconds() for s in stamps])
    return Stamps(seconds, origin=(stamps[0] - epoch).total_seconds())


def _stamps_of_times_of_day(path: Path, name: str, cells: Sequence[str], days: Sequence[str]) -> Stamps:
    """Stamps from times of day, with the day of the year before them (IRIG) or a column of dates; also over midnight."""
    clock = np.full(len(cells), np.nan)
    irig = False
    for i, cell in enumerate(cells):
        match = _CLOCK.fullmatch(cell)
        if match is None and cell:
            raise ImportDataError(
                f"{path}: time column {name!r}: {one_line(cell, 60)!r} is not a time like 13:05:01.25 or 123:13:05:01.250"
            )
        if match is not None:
            irig = irig or match[1] is not None
            second = float(match[4].replace(",", ".").replace(":", "."))
            hour = float(match[2]) if match[5] is None else float(match[2]) % 12.0 + 12.0 * (match[5] in "Pp")
            clock[i] = DAY * float(match[1] or 0) + HOUR * hour + 60.0 * float(match[3]) + second
    if days and not irig:
        clock = clock + DAY * _day_numbers(days)
    else:
        clock = clock + _days_passed(clock, irig)
    first = np.nanmin(clock) if np.isfinite(clock).any() else 0.0
    words = "IRIG time (day of the year first)" if irig else "time of day" + (" and a column of dates" if days else "")
    return Stamps(clock - first, notes=(f"time column {name}: {words}, counted from the first",), origin=float(first))


def _stamps_of_minutes(path: Path, name: str, cells: Sequence[str]) -> Stamps:
    """Stamps from minutes and seconds without the hour; a step back of more than half an hour begins the next hour."""
    clock = np.full(len(cells), np.nan)
    for i, cell in enumerate(cells):
        match = _MINUTES.fullmatch(cell)
        if match is None and cell:
            raise ImportDataError(
                f"{path}: time column {name!r}: {one_line(cell, 60)!r} is no minute and second like 59:50.25"
            )
        if match is not None:
            clock[i] = 60.0 * float(match[1]) + float(match[2].replace(",", "."))
    rows = np.flatnonzero(np.isfinite(clock))
    clock[rows[1:]] += HOUR * np.cumsum(np.diff(clock[rows]) < -0.5 * HOUR)
    note = f"time column {plain_name(name)}: minutes and seconds without the hour, counted from the first"
    return Stamps(clock - clock[rows[0]], notes=(note,), origin=float(clock[rows[0]]))


def _days_passed(clock: Array, irig: bool) -> Array:
    """(N,) [s] to add to the clock: a day for every midnight; in IRIG time a year wherever the day of the year restarts, of 366
    days if the row before was of day 366."""
    rows = np.flatnonzero(np.isfinite(clock))
    values = clock[rows]
    falls = np.diff(values) < (-0.5 * YEAR_DAYS * DAY if irig else -0.5 * DAY)
    lengths = np.where(values[:-1] // DAY > YEAR_DAYS, YEAR_DAYS + 1, YEAR_DAYS) * DAY if irig else DAY
    passed = np.zeros(clock.size)
    passed[rows[1:]] = np.cumsum(falls * lengths)
    return passed


def _day_numbers(days: Sequence[str]) -> Array:
    """(N,) day number of each row: of the calendar for ISO dates; for other dates one more wherever the date changes."""
    try:
        return np.array([float(datetime.fromisoformat(d.replace("/", "-")).toordinal()) for d in days])
    except ValueError:
        changed = [0.0, *(float(a != b) for a, b in zip(days[:-1], days[1:], strict=True))]
        return np.cumsum(changed)


# ------------------------------------------------------------------------------------------------------ clocks set back


def _records_where_set_back(stamps: Stamps) -> Stamps:
    """Stamps with a new record wherever the clock steps back between two long runs of rows and repeats times: sorting would mix
    these rows. Runs that do not overlap are only in another order, which sorting corrects."""
    seconds = stamps.seconds
    if not np.all(np.isfinite(seconds)):
        return stamps
    falls = np.diff(seconds) < 0
    runs = list(pairwise([0, *(np.flatnonzero(falls) + 1).tolist(), seconds.size]))
    if len(runs) < 2 or min(b - a for a, b in runs) < SHORTEST_RUN:
        return stamps
    if not any(seconds[b - 1] >= seconds[start] for (start, _), (a, b) in pairwise(runs)):
        return stamps
    row = runs[1][0]
    repeats = f", and {len(runs) - 2} times more" if len(runs) > 2 else ""
    text = (
        f"the clock falls back by {seconds[row - 1] - seconds[row]:.4g} s after row {row} (t = {seconds[row - 1]:.4g} s)"
        f"{repeats}: the rows after it are a separate record"
    )
    return _records_in_sequence(replace(stamps, notes=(*stamps.notes, text)), falls)


def _records_in_sequence(stamps: Stamps, restarts: Mask) -> Stamps:
    """Stamps with the records placed one after the other, RECORD_GAP between them. restarts: (N-1,) where a record begins."""
    number = np.concatenate([[0.0], np.cumsum(restarts)])
    step = np.diff(stamps.seconds)
    shift = np.concatenate([[0.0], np.cumsum(np.where(restarts, RECORD_GAP - step, 0.0))])
    return replace(stamps, seconds=stamps.seconds + shift, record=number)


# ------------------------------------------------------------------------------------------------------- missing values


def without_sentinels(columns: Mapping[str, Array]) -> tuple[dict[str, Array], list[str]]:
    """The columns (N,) with NaN in place of SENTINELS, and notes on them."""
    cleaned, notes = dict(columns), []
    for name, values in columns.items():
        for number in SENTINELS:
            sentinel = values == number
            rest = values[np.isfinite(values) & ~sentinel] if sentinel.any() else np.zeros(0)
            if rest.size >= FEWEST_VALUES and OUTLIER_FACTOR * float(np.max(np.abs(rest))) < abs(number):
                cleaned[name] = np.where(sentinel, np.nan, cleaned[name])
                notes.append(
                    f"column {plain_name(name)}: {int(sentinel.sum())} cells of {number:g} taken as not measured"
                )
    return cleaned, notes
