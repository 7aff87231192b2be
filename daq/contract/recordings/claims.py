"""What a file claims of itself, taken for no more than it can be: sizes of tables, and values of somebody's JSON."""

import json
from typing import Any

MAX_COLUMNS = 4096
"""Columns of a flight. Ours has 52; a wide log of an autopilot some hundred."""
_CELLS = 12_000_000
_CELLS_PER_BYTE = 0.75
"""Cells a table may have: as many as any file (96 MB), more where the file is larger. A cell takes nine bytes in a row before
compression, more than one after it where values are measured; absent cells are nearly free, and so they are what is forged."""


def table_fits(rows: int, columns: int, file_size: int) -> bool:
    """Whether a file of `file_size` bytes can hold such a table: compressed, a few bytes claim billions of cells."""
    return columns <= MAX_COLUMNS and rows * columns <= max(_CELLS, _CELLS_PER_BYTE * file_size)


def json_object(text: str | bytes) -> dict[str, Any]:
    """A JSON object; empty for any other text."""
    try:
        return mapping(json.loads(text))
    except (ValueError, RecursionError):
        return {}


def mapping(value: object) -> dict[str, Any]:
    """A value of somebody's JSON where an object belongs."""
    return {str(k): v for k, v in value.items()} if isinstance(value, dict) else {}


def texts(value: object) -> list[str]:
    """A value of somebody's JSON where a list of sentences belongs."""
    return [str(v) for v in value] if isinstance(value, list) else []
