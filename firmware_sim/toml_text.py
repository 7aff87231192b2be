"""Writing TOML: the standard library reads it only. Tables, arrays of tables, and plain values."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def toml_text(table: Mapping[str, Any]) -> str:
    """A table as TOML text that reads back to the same table; None values are left out."""
    return "\n".join(_lines(table, ())).strip("\n") + "\n"


def _lines(table: Mapping[str, Any], path: tuple[str, ...]) -> list[str]:
    tables = {k: v for k, v in table.items() if isinstance(v, Mapping)}
    arrays = {k: v for k, v in table.items() if _is_array_of_tables(v)}
    plain = {k: v for k, v in table.items() if k not in tables and k not in arrays and v is not None}
    lines = [f"{_key(k)} = {_value(v)}" for k, v in plain.items()]
    for key, inner in tables.items():
        lines += ["", f"[{'.'.join(map(_key, (*path, key)))}]", *_lines(inner, (*path, key))]
    for key, items in arrays.items():
        for item in items:
            lines += ["", f"[[{'.'.join(map(_key, (*path, key)))}]]", *_lines(item, (*path, key))]
    return lines


def _is_array_of_tables(value: Any) -> bool:
    return isinstance(value, list | tuple) and bool(value) and all(isinstance(v, Mapping) for v in value)


def _key(name: str) -> str:
    bare = name and all(c.isascii() and (c.isalnum() or c in "_-") for c in name)
    return name if bare else _value(name)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str | Path):
        return '"' + "".join(_escaped(c) for c in str(value)) + '"'
    if isinstance(value, float):
        return (
            repr(value)
            if math.isfinite(value)
            else {True: "nan", False: "inf" if value > 0 else "-inf"}[value != value]
        )
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items() if v is not None) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(v) for v in value) + "]"
    return str(value)


def _escaped(character: str) -> str:
    if character in '"\\':
        return "\\" + character
    if ord(character) < 0x20 or ord(character) == 0x7F:
        return f"\\u{ord(character):04x}"
    return character
