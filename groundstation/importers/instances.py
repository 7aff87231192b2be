"""Which of several sensors of one kind an autopilot flew by: by its own word (Pri), by use, by health; and whether they agree."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from groundstation.flight.contradictions import Contradiction
from groundstation.importers.series import Array, TimeSeries

ALL_OF_ONE_KIND = ("ARSP", "GPS", "BARO", "IMU", "MAG")
"""Messages of ArduPilot that come from several sensors and say which is in use."""
_HEALTH = ("H", "Health", "GH")
_USED = ("U", "Use")
AGREE = 0.08
"""Of the median of a quantity, by which two sensors of it may differ: pitots differ by 3 %."""
COMPARED: Mapping[str, str] = {"ARSP": "DiffPress", "BARO": "Press"}
"""What of a message is compared between instances."""


@dataclass(frozen=True)
class ChosenInstances:
    """series: those of the instance in use, under the plain name of the message, and of the first under its number."""

    series: Mapping[str, TimeSeries]
    notes: tuple[str, ...] = ()
    contradictions: tuple[Contradiction, ...] = ()


def with_primaries(series: Mapping[str, TimeSeries]) -> ChosenInstances:
    """The series with the plain name (`ARSP.Airspeed`) standing for the instance in use; each stays under its number, too."""
    out = dict(series)
    notes: list[str] = []
    found: list[Contradiction] = []
    for message in ALL_OF_ONE_KIND:
        instances = _instances(series, message)
        if len(instances) < 2:
            continue
        primary, why = _primary(instances)
        first = next(iter(instances))
        for name, values in instances[first].items():
            out[f"{message}[{first}].{name}"] = values
        if primary is None:
            out.update({f"{message}.{n}": v for n, v in _by_time(instances).items()})
            notes.append(f"{message}: the instance in use changes in flight ({why}); each sample is of the one in use")
        elif primary != first:
            out = {n: v for n, v in out.items() if not n.startswith(f"{message}.")}
            out.update({f"{message}.{n}": v for n, v in instances[primary].items()})
            notes.append(f"{message}: instance {primary} is taken, {why}")
        found += _disagreements(message, instances, primary, why)
    return ChosenInstances(out, tuple(notes), tuple(found))


def _instances(series: Mapping[str, TimeSeries], message: str) -> dict[int, dict[str, TimeSeries]]:
    """Instance number -> field -> series."""
    out: dict[int, dict[str, TimeSeries]] = {}
    for name, values in series.items():
        head, _, field = name.partition(".")
        if head == message:
            label = series.get(f"{message}.I")
            known = label.values[np.isfinite(label.values)] if label is not None else np.zeros(0)
            number = int(known[0]) if known.size else 0
        elif head.startswith(f"{message}[") and head.endswith("]") and head[len(message) + 1 : -1].isdigit():
            number = int(head[len(message) + 1 : -1])
        else:
            continue
        out.setdefault(number, {})[field] = values
    return dict(sorted(out.items()))


def _primary(instances: Mapping[int, Mapping[str, TimeSeries]]) -> tuple[int | None, str]:
    """The instance in use and why; None where it changes, as each says at its own time."""
    stated = [fields["Pri"].values for fields in instances.values() if "Pri" in fields]
    if stated:
        numbers = np.unique(np.concatenate(stated))
        numbers = numbers[np.isfinite(numbers)]
        known = [int(n) for n in numbers if int(n) in instances]
        if len(known) == 1:
            return known[0], f"the log names it the primary (Pri {known[0]})"
        if known:
            return None, f"Pri {', '.join(map(str, known))}"
    for fields, word in ((_USED, "in use"), (_HEALTH, "healthy")):
        share = {n: _mean(f, fields) for n, f in instances.items()}
        good = [n for n, s in share.items() if s is not None and s > 0.5]
        if good and len(good) < len(instances):
            others = ", ".join(str(n) for n in instances if n not in good)
            return good[0], f"{others} is not {word} by the log"
    first = next(iter(instances))
    return first, "nothing in the log says which is in use"


def _mean(fields: Mapping[str, TimeSeries], names: tuple[str, ...]) -> float | None:
    found = next((fields[n].values for n in names if n in fields), None)
    return float(np.nanmean(found)) if found is not None and found.size else None


def _by_time(instances: Mapping[int, Mapping[str, TimeSeries]]) -> dict[str, TimeSeries]:
    """Samples of each instance from the times at which it was the primary."""
    chosen = {n: f["Pri"].values == n for n, f in instances.items() if "Pri" in f}
    out = {}
    for name in next(iter(instances.values())):
        parts = [
            (f[name].time[chosen[n]], f[name].values[chosen[n]])
            for n, f in instances.items()
            if n in chosen and name in f
        ]
        time, values = (np.concatenate([p[i] for p in parts]) for i in (0, 1))
        order = np.argsort(time, kind="stable")
        out[name] = TimeSeries(time[order], values[order])
    return out


def _disagreements(
    message: str, instances: Mapping[int, Mapping[str, TimeSeries]], primary: int | None, why: str
) -> Iterator[Contradiction]:
    """What two instances show of one quantity, where they differ beyond what two sensors do."""
    field = COMPARED.get(message)
    against = primary if primary is not None else next(iter(instances))
    reference = instances[against].get(field or "")
    for number, fields in instances.items():
        other = fields.get(field or "")
        if number == against or other is None or reference is None or field is None:
            continue
        ratio = _ratio(other, reference)
        if ratio is None or abs(ratio - 1.0) <= AGREE:
            continue
        sure = not why.startswith("nothing")
        first, second = f"{message}[{number}].{field}", f"{message}[{against}].{field}"
        text = f"{first} is {ratio:.3g} times {second}; {second} is taken, {why}"
        moves = f"every derivative by {abs(ratio - 1.0):.0%}, if it were the other" if message == "ARSP" else "density"
        yield Contradiction((first, second), text, ratio, favoured=second if sure else "", moves=moves, stops=not sure)


def _ratio(first: TimeSeries, second: TimeSeries) -> float | None:
    values: Array = np.interp(first.time, second.time, second.values) if second.time.size > 1 else np.zeros(0)
    if values.size == 0:
        return None
    use = np.abs(values) > 0.5 * np.nanmedian(np.abs(values))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = float(np.nanmedian(first.values[use] / values[use])) if use.any() else np.nan
    return ratio if np.isfinite(ratio) else None
