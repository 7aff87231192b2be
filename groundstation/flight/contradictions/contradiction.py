"""One contradiction: two quantities of a flight that say the same thing differently."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from daq.contract.plain_words import one_line
from daq.contract.recordings.flight_rows import as_texts


@dataclass(frozen=True, slots=True)
class Contradiction:
    """Both sides, by how much they differ, whom the rest of the data favour, and what it does to derivatives.

    between: columns, or series of a log. ratio: of the first side over the second; None where they differ by an offset [unit].
    std: 1 sigma of ratio or offset. favoured: the side to believe, `neither known` as an empty string. moves: what it does to
    derivatives, empty where nothing. stops: whether no estimate of the flight as it stands is to be recommended.
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

    def to_json(self) -> dict[str, Any]:
        """As in the JSON of `import`, `check` and `analyse`."""
        return {
            "between": list(self.between),
            "ratio": self.ratio,
            "offset": self.offset,
            "unit": self.unit,
            "std": self.std if math.isfinite(self.std) else None,
            "favoured": self.favoured,
            "moves": self.moves,
            "stops": self.stops,
            "text": self.text,
        }


def from_json(content: object) -> Contradiction | None:
    """A contradiction as a flight file carries it; None for what is none."""
    if not isinstance(content, Mapping):
        return None
    between = tuple(one_line(name) for name in as_texts(content.get("between")))
    text = content.get("text")
    if not between or not isinstance(text, str):
        return None
    return Contradiction(
        between,
        one_line(text),
        _number(content.get("ratio")),
        _number(content.get("offset")),
        _word(content.get("unit")),
        _number(content.get("std")) or math.nan,
        _word(content.get("favoured")),
        _word(content.get("moves")),
        content.get("stops") is True,
    )


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else None


def _word(value: object) -> str:
    return one_line(value) if isinstance(value, str) else ""
