"""Logs in which the autopilot's clock begins anew: files of several flights put together, or written on after a restart."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from groundstation.importers.series import Array, Log, TimeSeries

FALLS_BACK = 1.0
"""[s] by which a message is earlier than the one before only after a restart: out of order they are by milliseconds."""


def by_boot(log: Log) -> list[Log]:
    """A log for each run of the clock, in the order of the file; the log itself where it never falls back.

    Messages that were not written in every run cannot be told apart by their order: they are left out, and said.
    """
    clocks = {id(s.time): s.time for s in log.series.values()}
    runs = {key: _runs(time) for key, time in clocks.items()}
    count = max((len(r) for r in runs.values()), default=1)
    if count < 2:
        return [log]
    lost = {n.split(".")[0] for n, s in log.series.items() if len(runs[id(s.time)]) != count}
    words = f"messages that were not written in each of {count} boots are left out: {', '.join(sorted(lost))}"
    told = (words,) if lost else ()
    return [
        replace(
            log,
            series=_part(log.series, runs, number, count),
            notes=(
                *(log.notes if number == 0 else ()),
                f"boot {number + 1} of {count} in this log: a record of its own",
                *told,
            ),
        )
        for number in range(count)
    ]


def _runs(time: Array) -> list[slice]:
    """Ranges between falls of a clock; one that falls back for single samples only is damaged, and is one range."""
    with np.errstate(invalid="ignore"):
        falls = np.flatnonzero(np.diff(time) < -FALLS_BACK) + 1
    edges = [0, *falls.tolist(), time.size]
    parts = [slice(a, b) for a, b in zip(edges[:-1], edges[1:], strict=True)]
    wild = any(b.stop - b.start < 2 or _overtakes(time, a, b) for a, b in zip(parts[:-1], parts[1:], strict=True))
    return [slice(0, time.size)] if wild else parts


def _overtakes(time: Array, before: slice, after: slice) -> bool:
    """Whether a fall is but the end of a spike: the sample before it lies far above its own neighbour."""
    if before.stop - before.start < 3:
        return True
    steps = np.diff(time[before])
    return bool(steps[-1] > 100.0 * max(float(np.median(steps)), 1e-3))


def _part(
    series: Mapping[str, TimeSeries], runs: Mapping[int, list[slice]], number: int, count: int
) -> dict[str, TimeSeries]:
    cut: dict[int, Array] = {}
    out: dict[str, TimeSeries] = {}
    for name, s in series.items():
        parts = runs[id(s.time)]
        if len(parts) == count:
            rows = parts[number]
            time: NDArray[np.float64] = cut.setdefault(id(s.time), s.time[rows])
            out[name] = TimeSeries(time, s.values[rows])
    return out
