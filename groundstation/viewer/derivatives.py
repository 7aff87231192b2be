"""Identified derivatives as curves relative to their beliefs, with bands, one plot a coefficient.

Plotted is (derivative - believed) / standard deviation of the belief, because rerun fits a scale only to the first data and this
number fits one scale for all. The band is two bounds to each side. The derivatives themselves are in the text beside the plots.
"""

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from daq.identification.airframe import Belief
from groundstation.identification.history import BELIEVED, DETAIL, history_of
from groundstation.identification.session import LiveState
from groundstation.identification.words import markdown
from groundstation.viewer import entities as e
from groundstation.viewer.entities import drawable

Array = NDArray[np.float64]

BAND = 2.0  # bounds to each side: 95 %
BAND_LABEL = " "  # of a band's edges: their colour names the derivative, and keeps the legend short
THIN, THICK = 0.6, 2.0  # widths of lines, in points


def entity(coefficient: str) -> str:
    return f"{e.IDENTIFICATION}/{coefficient}"


def by_coefficient(names: Iterable[str]) -> dict[str, list[str]]:
    """Coefficient -> its derivatives, both in the given order."""
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(name.partition("_")[0], []).append(name)
    return groups


def send_scalars(stream: rr.RecordingStream, entity: str, time: Array, table: Array) -> None:
    """Log scalars of a whole flight at once. time: (N,) [s]; table: (N, series)."""
    index = rr.TimeColumn(e.TIMELINE, duration=time)
    columns = rr.Scalars.columns(scalars=table.ravel()).partition([table.shape[1]] * len(time))
    stream.send_columns(entity, indexes=[index], columns=columns)


class DerivativeCurves:
    """Logs into a recording stream; not thread-safe."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._named = False

    def show(self, state: LiveState) -> None:
        """Log one live state: a point on each curve, and the text."""
        beliefs = state.aircraft.airframe.beliefs
        self._name_once(by_coefficient(state.aircraft.shown), state.aircraft.sources)
        self._stream.set_time(e.TIMELINE, duration=state.time)
        for coefficient, names in by_coefficient(state.aircraft.shown).items():
            derivatives = [state.estimates.derivatives[n] for n in names]
            rows = [
                _band(d.estimate if d.told else math.nan, d.std, beliefs.get(d.name, Belief(0.0, 0.0)))
                for d in derivatives
            ]
            self._stream.log(entity(coefficient), rr.Scalars(np.ravel(rows)))
        text = rr.TextDocument(drawable(markdown(state)), media_type=rr.MediaType.MARKDOWN)
        self._stream.log(e.IDENTIFIED, text)

    def show_history(self, detail: Mapping[str, object]) -> None:
        """Log the history that a finished flight carries, if any."""
        history = history_of(detail)
        if history is None:
            return
        times, series = history
        beliefs = _beliefs_of(detail)
        groups = by_coefficient(n for n in series if not n.endswith("_0"))
        self._name_once(groups, {})
        for coefficient, names in groups.items():
            empty = ([math.nan] * len(times),) * 2
            table = [
                [_band(v, s, beliefs.get(n, Belief(0.0, 0.0))) for v, s in zip(*series.get(n, empty), strict=True)]
                for n in names
            ]
            flat = np.array(table).transpose(1, 0, 2).reshape(len(times), -1)
            send_scalars(self._stream, entity(coefficient), np.array(times), flat)

    def _name_once(self, groups: Mapping[str, Sequence[str]], sources: Mapping[str, str]) -> None:
        if self._named:
            return
        self._named = True
        for coefficient, names in groups.items():
            headings = [f"{n} (0: {sources[n]})" if sources.get(n) else n for n in names]
            labels = [label for heading in headings for label in (heading, BAND_LABEL, BAND_LABEL)]
            colors = [c for i in range(len(names)) for c in (e.PALETTE[i], _faded(e.PALETTE[i]), _faded(e.PALETTE[i]))]
            lines = rr.SeriesLines(
                names=labels, colors=np.array(colors, np.uint32), widths=[THICK, THIN, THIN] * len(names)
            )
            self._stream.log(entity(coefficient), lines, static=True)


def _band(value: float, bound: float, belief: Belief) -> Sequence[float]:
    """Estimate and the edges of its band, in standard deviations of the belief; NaN without an estimate or a belief."""
    if not (math.isfinite(value) and belief.std > 0.0):
        return (math.nan,) * 3
    centre, half = (value - belief.value) / belief.std, BAND * bound / belief.std
    return centre, centre - half, centre + half


def _faded(color: int) -> int:
    return (color & 0xFFFFFF00) | 0x80


def _beliefs_of(detail: Mapping[str, object]) -> dict[str, Belief]:
    identification = detail.get(DETAIL)
    rows = identification.get(BELIEVED) if isinstance(identification, Mapping) else None
    beliefs = {}
    for name, row in rows.items() if isinstance(rows, Mapping) else ():
        if isinstance(row, Mapping):
            value, std = row.get("value"), row.get("std")
            if isinstance(value, int | float) and isinstance(std, int | float):
                beliefs[str(name)] = Belief(float(value), float(std))
    return beliefs
