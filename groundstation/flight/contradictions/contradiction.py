"""One contradiction: two measurements of the same quantity in a flight that do not agree."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from daq.contract.recordings.flight_rows import as_texts
from daq.utilities.plain_words import one_line


@dataclass(frozen=True, slots=True)
class Contradiction:
    """Both sides, their difference, the side that other data favour, and the effect on derivatives.

    between: columns, or series of a log. text: a sentence for a person. ratio: of the first side over the second; None where they
    differ by an offset [unit]. std: 1 sigma of ratio or offset. favoured: the side to believe, empty where unknown. moves: effect
    on derivatives, empty where none. stops: whether no estimate from the unchanged flight is recommended. spans: begin and end
    [s] of each time in which a sensor failed, where the rest of the flight is sound.
    """

    between: tuple[str, ...]
    text: str
    ratio: float | None = None
    offset: float | None = None
    unit: str = ""
    std: float = math.nan
    favoured: str = ""
    moves: str = ""
    stops: bool = False
    spans: tuple[tuple[float, float], ...] = ()

    @property
    def failed(self) -> tuple[str, ...]:
        """Columns of the sensor that failed in `spans`; none without such a time."""
        return tuple(n for n in self.between if n not in self.favoured.split(", ")) if self.spans else ()

    def to_json(self) -> dict[str, Any]:
        """An entry of `contradictions` in the JSON of `import`, `check` and `analyse`."""
        names = ("ratio", "offset", "unit", "std", "favoured", "moves", "stops", "text")
        values = {name: getattr(self, name) for name in names}
        values["spans"] = [list(span) for span in self.spans]
        return {"between": list(self.between), **values, "std": self.std if math.isfinite(self.std) else None}


def contradiction_from_json(content: object) -> Contradiction | None:
    """The contradiction of an entry in a flight file's provenance, without its spans; None where the entry is not valid."""
    if not isinstance(content, Mapping):
        return None
    sides = tuple(one_line(name) for name in as_texts(content.get("between")))
    text = content.get("text")
    if not sides or not isinstance(text, str):
        return None
    ratio, offset, std = (_number(content.get(key)) for key in ("ratio", "offset", "std"))
    unit, favoured, moves = (_text(content.get(key)) for key in ("unit", "favoured", "moves"))
    stops = content.get("stops") is True
    return Contradiction(sides, one_line(text), ratio, offset, unit, std or math.nan, favoured, moves, stops)


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else None


def _text(value: object) -> str:
    return one_line(value) if isinstance(value, str) else ""
