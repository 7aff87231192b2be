"""What the viewer shows, derived from the channel table: groups of series, their units and colours.

Columns that share an entity in the table are logged together as one vector of scalars, because in rerun the cost is
per entity and chunk, not per number. Angles are shown in degrees.
"""

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from daq.contract.channels import COLUMNS, GROUPS, FlightColumn
from daq.utilities.constants import ZERO_CELSIUS

TIMELINE = "flight_time"
APPLICATION = "sideslip"

HEALTH = "/health"
EVENTS = "/events"
STATUS = "/status"
READOUTS = "/readouts"
ALARM = "/alarm"
ALARM_WORDS = "/alarms"
AIRCRAFT = "/world/aircraft"
ATTITUDE = "/attitude3d"
CHASED = f"{ATTITUDE}/aircraft"
TRACK = "/world/track"
MAP_POSITION = "/map/position"
MAP_TRACK = "/map/track"
LINK_LOSS = "/link/loss"
LINK_RATE = "/link/rate"
LINK_SIGNAL = "/link/signal"
LINK_LATENCY = "/link/latency"
MODEL = "/model"
IDENTIFICATION = "/identification"
IDENTIFIED = f"{IDENTIFICATION}/words"

# Okabe-Ito: colour-blind people can distinguish them too, and they are readable on rerun's dark background.
PALETTE = (0x56B4E9FF, 0xE69F00FF, 0x009E73FF, 0xF0E442FF, 0xCC79A7FF, 0xD55E00FF, 0x0072B2FF, 0xBBBBBBFF)

LINK_SERIES = (
    (LINK_LOSS, "lost [%]", PALETTE[5]),
    (LINK_RATE, "scans [1/s]", PALETTE[2]),
    (LINK_SIGNAL, "signal [dBm]", PALETTE[0]),
    (LINK_LATENCY, "latency [ms]", PALETTE[1]),
)


@dataclass(frozen=True, slots=True)
class LinkSample:
    """State of the radio link: loss [%], frame rate [1/s], received signal [dBm], latency [s]; NaN unknown."""

    loss_percent: float = math.nan
    rate_hz: float = math.nan
    signal_dbm: float = math.nan
    latency_s: float = math.nan

    @classmethod
    def reported(cls, loss: float, rate_hz: float, signal: float | None, latency_s: float | None) -> "LinkSample":
        """From a report of the receiver. loss: share of frames; None: not known."""
        unknown = math.nan
        return cls(
            100 * loss, rate_hz, unknown if signal is None else signal, unknown if latency_s is None else latency_s
        )

    def by_entity(self) -> dict[str, float]:
        """Values as shown, by the entity that shows them."""
        values = (self.loss_percent, self.rate_hz, self.signal_dbm, 1e3 * self.latency_s)
        return dict(zip((row[0] for row in LINK_SERIES), values, strict=True))


_HUES: Mapping[str, int] = {"/controls/commanded": 3}  # drawn in one plot with the measured deflections
_MODEL_HUE = 4  # of a model's series, drawn with the measured ones

_SHOWN: Mapping[str, tuple[str, float, float]] = {
    "rad": ("deg", math.degrees(1), 0.0),
    "rad/s": ("deg/s", math.degrees(1), 0.0),
    "T": ("µT", 1e6, 0.0),
    "K": ("°C", 1.0, -ZERO_CELSIUS),
}


@dataclass(frozen=True, slots=True)
class SeriesGroup:
    """Columns drawn from one entity. shown = value * scale + offset, element by element.

    hue: index in the palette at which its colours begin, so that groups drawn in one plot differ.
    """

    entity: str
    columns: tuple[str, ...]
    labels: tuple[str, ...]
    scale: NDArray[np.float64]
    offset: NDArray[np.float64]
    hue: int = 0

    def shown(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Column values, last axis in order of `columns`, in the units shown."""
        return values * self.scale + self.offset

    @property
    def colors(self) -> NDArray[np.uint32]:
        """One colour a series, in table order."""
        return np.array([PALETTE[(i + self.hue) % len(PALETTE)] for i in range(len(self.columns))], np.uint32)


def _group(entity: str, columns: Iterable[FlightColumn], suffix: str = "") -> SeriesGroup:
    rows = tuple(columns)
    conversions = [_SHOWN.get(c.unit, (c.unit, 1.0, 0.0)) for c in rows]
    labels = tuple(f"{c.name}{suffix} [{unit}]" for c, (unit, _, _) in zip(rows, conversions, strict=True))
    scale, offset = np.array([s for _, s, _ in conversions]), np.array([o for _, _, o in conversions])
    return SeriesGroup(entity, tuple(c.name for c in rows), labels, scale, offset, _HUES.get(entity, 0))


def series_groups(available: Iterable[str] | None = None) -> tuple[SeriesGroup, ...]:
    """Series groups in table order, of the columns that are available (all of the table by default)."""
    names = {c.name for c in COLUMNS} if available is None else set(available)
    entities = dict.fromkeys(c.entity for c in COLUMNS if c.name in names)
    return tuple(_group(e, (c for c in COLUMNS if c.entity == e and c.name in names)) for e in entities)


def model_groups(available: Iterable[str], whose: str = "model") -> tuple[SeriesGroup, ...]:
    """Series of the columns `<name>_model`: an estimated model that a flight carries, or another flight. whose: word that follows
    each name in the legend."""
    names = {c.removesuffix("_model") for c in available if c.endswith("_model")}
    rows = [c for c in COLUMNS if c.name in names]
    groups = []
    for entity in dict.fromkeys(c.entity for c in rows):
        group = _group(MODEL + entity, (c for c in rows if c.entity == entity), f" {whose}")
        names_in_flight = tuple(f"{c}_model" for c in group.columns)
        groups.append(replace(group, columns=names_in_flight, hue=_MODEL_HUE))
    return tuple(groups)


def health_entity(group: str) -> str:
    return f"{HEALTH}/{group}"


HEALTH_TITLES: Mapping[str, str] = {g.name: g.title for g in GROUPS}
NO_ALARM = "no alarm"
ALARM_COLORS: Mapping[str, int] = {
    NO_ALARM: 0x2E8B57FF,
    "WARN": 0xE69F00FF,
    "ERROR": 0xD55E00FF,
    "CRITICAL": 0xFF1F1FFF,
}
STATE_COLORS: Mapping[str, int] = {
    "ok": 0x2E8B57FF,
    "stale": 0xF0E442FF,
    "out of range": 0xE69F00FF,
    "stuck": 0xD55E00FF,
    "absent": 0xB22222FF,
    "recovering": 0x56B4E9FF,
    "fault": 0xB22222FF,
    "off": 0x555555FF,
}


# letters missing in rerun's only font: its native viewer (0.41) crashes at the first
UNDRAWN = re.compile("[^\n -~¡-¬®-ňŊ-ſΑ-ΡΣ-Ωα-ωА-я\u0302\u0307ḣṗṙẊ→−√≠■…]")


def drawable(text: str) -> str:
    """`text` with a question mark for every letter that the viewer cannot draw."""
    return UNDRAWN.sub("?", text)


SPAN, ROOT_CHORD, TAPER, CG_AFT_OF_NOSE = 1.50, 0.90, 0.1667, 0.44  # m, of the drawn flying wing
ELEVON_CHORD, FIN_HEIGHT, FIN_ROOT, FIN_TIP = 0.12, 0.30, 0.28, 0.16  # m
_WING, _ELEVON, _FIN = (0x9FB4C7FF, 0xE69F00FF, 0xD55E00FF)


def airframe_mesh() -> tuple[NDArray[np.float32], NDArray[np.uint32], NDArray[np.uint32]]:
    """Vertices (n, 3) in body axes [m], triangles (m, 3) and vertex colours (n,) 0xRRGGBBAA; both faces of every plate."""
    nose = CG_AFT_OF_NOSE
    tail = nose - ROOT_CHORD
    tip_lead = tail + ROOT_CHORD * TAPER
    half = SPAN / 2
    hinge = tail + ELEVON_CHORD
    plates: list[tuple[list[tuple[float, float, float]], int]] = []
    for side in (-1.0, 1.0):
        y = side * half
        plates.append(([(nose, 0.0, 0.0), (tip_lead, y, 0.0), (hinge, y, 0.0), (hinge, 0.0, 0.0)], _WING))
        plates.append(([(hinge, 0.0, 0.0), (hinge, y, 0.0), (tail, y, 0.0), (tail, 0.0, 0.0)], _ELEVON))
    fin = [(tail + FIN_ROOT, 0.0, 0.0), (tail + FIN_TIP, 0.0, -FIN_HEIGHT), (tail, 0.0, -FIN_HEIGHT), (tail, 0.0, 0.0)]
    plates.append((fin, _FIN))
    vertices = np.array([v for corners, _ in plates for v in corners], np.float32)
    colors = np.array([color for corners, color in plates for _ in corners], np.uint32)
    quads = np.arange(len(vertices)).reshape(-1, 4)
    front = np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return vertices, np.vstack([front, front[:, ::-1]]).astype(np.uint32), colors
