"""The sensor in use among several of one kind: by the log's primary (Pri), by use or by health; and whether they agree."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from groundstation.flight.contradictions import Contradiction
from groundstation.importers.series import Array, TimeSeries

REDUNDANT_MESSAGES = ("ARSP", "GPS", "BARO", "IMU", "MAG")
"""Messages of ArduPilot that may come from several sensors, and state which is in use."""
TOLERANCE = 0.08  # relative difference of two sensors' medians: pitots differ by 3 %
MAJORITY = 0.5  # share of its samples, above which a flag counts as set for the whole log
COMPARED: Mapping[str, str] = {"ARSP": "DiffPress", "BARO": "Press"}
"""Message -> field that is compared between instances."""
LEAST_SHARE = 0.5  # of the median, from which samples are compared as a ratio
_NO_EVIDENCE = "nothing in the log shows which is in use"


@dataclass(frozen=True)
class ChosenInstances:
    """series: of the instance in use without a number ('ARSP.Airspeed'), of all with a number but the first, which has both
    names where it is in use; notes: on the choice; contradictions: between instances."""

    series: Mapping[str, TimeSeries]
    notes: tuple[str, ...] = ()
    contradictions: tuple[Contradiction, ...] = ()


def with_primaries(series: Mapping[str, TimeSeries]) -> ChosenInstances:
    """The series with the instance in use under the name without a number, and the first one also under its number."""
    primaries = dict(series)
    notes: list[str] = []
    contradictions: list[Contradiction] = []
    for message in REDUNDANT_MESSAGES:
        instances = _instances(series, message)
        if len(instances) < 2:
            continue
        primary, reason = _primary(instances)
        first = next(iter(instances))
        primaries |= {f"{message}[{first}].{n}": v for n, v in instances[first].items()}
        if primary is None:
            primaries |= {f"{message}.{n}": v for n, v in _by_time(instances).items()}
            notes.append(
                f"{message}: the instance in use changes in flight ({reason}); each sample is of the one in use"
            )
        elif primary != first:
            primaries = {n: v for n, v in primaries.items() if not n.startswith(f"{message}.")}
            primaries |= {f"{message}.{n}": v for n, v in instances[primary].items()}
            notes.append(f"{message}: instance {primary} is taken, {reason}")
        contradictions += _disagreements(message, instances, primary, reason)
    return ChosenInstances(primaries, tuple(notes), tuple(contradictions))


def _instances(series: Mapping[str, TimeSeries], message: str) -> dict[int, dict[str, TimeSeries]]:
    """Instance number -> field -> series, of one message."""
    instances: dict[int, dict[str, TimeSeries]] = {}
    label = series.get(f"{message}.I")
    numbers = label.values[np.isfinite(label.values)] if label is not None else np.zeros(0)
    pattern = re.compile(re.escape(message) + r"(?:\[(\d+)\])?")
    for name, values in series.items():
        head, _, field = name.partition(".")
        if match := pattern.fullmatch(head):
            number = int(match[1] or (numbers[0] if numbers.size else 0))
            instances.setdefault(number, {})[field] = values
    return dict(sorted(instances.items()))


def _primary(instances: Mapping[int, Mapping[str, TimeSeries]]) -> tuple[int | None, str]:
    """The instance in use and why; None where the log's primary changes in flight."""
    priorities = [fields["Pri"].values for fields in instances.values() if "Pri" in fields]
    if priorities:
        numbers = np.unique(np.concatenate(priorities))
        numbers = numbers[np.isfinite(numbers)]
        candidates = [int(n) for n in numbers if int(n) in instances]
        if len(candidates) == 1:
            return candidates[0], f"the log names it the primary (Pri {candidates[0]})"
        if candidates:
            return None, f"Pri {', '.join(map(str, candidates))}"
    for fields, word in ((("U", "Use"), "in use"), (("H", "Health", "GH"), "healthy")):
        share = {n: mean_of_first(f, fields) for n, f in instances.items()}
        working = [n for n, s in share.items() if s is not None and s > MAJORITY]
        if working and len(working) < len(instances):
            unused = ", ".join(str(n) for n in instances if n not in working)
            return working[0], f"{unused} is not {word} by the log"
    return next(iter(instances)), _NO_EVIDENCE


def mean_of_first(series: Mapping[str, TimeSeries], names: Sequence[str]) -> float | None:
    """Mean of the first of the named series that exists and is not empty; None without one."""
    values = next((series[n].values for n in names if n in series), None)
    return float(np.nanmean(values)) if values is not None and values.size else None


def _by_time(instances: Mapping[int, Mapping[str, TimeSeries]]) -> dict[str, TimeSeries]:
    """Field -> the samples of each instance while it was the primary, in order of time."""
    in_use = {n: f["Pri"].values == n for n, f in instances.items() if "Pri" in f}
    merged = {}
    for name in next(iter(instances.values())):
        parts = [(instances[n][name], use) for n, use in in_use.items() if name in instances[n]]
        time = np.concatenate([series.time[use] for series, use in parts])
        values = np.concatenate([series.values[use] for series, use in parts])
        order = np.argsort(time, kind="stable")
        merged[name] = TimeSeries(time[order], values[order])
    return merged


def _disagreements(
    message: str, instances: Mapping[int, Mapping[str, TimeSeries]], primary: int | None, reason: str
) -> Iterator[Contradiction]:
    """Contradictions between the instance in use and the others, where they differ by more than TOLERANCE. reason: of the
    choice."""
    field = COMPARED.get(message, "")
    in_use = primary if primary is not None else next(iter(instances))
    reference = instances[in_use].get(field)
    for number, fields in instances.items():
        if number == in_use or field not in fields or reference is None:
            continue
        ratio = _ratio(fields[field], reference)
        if ratio is None or abs(ratio - 1.0) <= TOLERANCE:
            continue
        sure = reason != _NO_EVIDENCE
        first, second = f"{message}[{number}].{field}", f"{message}[{in_use}].{field}"
        text = f"{first} is {ratio:.3g} times {second}; {second} is taken, {reason}"
        moves = f"every derivative by {abs(ratio - 1.0):.0%}, if it were the other" if message == "ARSP" else "density"
        yield Contradiction((first, second), text, ratio, favoured=second if sure else "", moves=moves, stops=not sure)


def _ratio(first: TimeSeries, second: TimeSeries) -> float | None:
    """Median of first over second, where the second is not small; None where they have no common time."""
    values: Array = np.interp(first.time, second.time, second.values) if second.time.size > 1 else np.zeros(0)
    if not np.isfinite(values).any():
        return None
    use = (np.abs(values) > LEAST_SHARE * np.nanmedian(np.abs(values))) & np.isfinite(first.values)
    return float(np.median(first.values[use] / values[use])) if use.any() else None
