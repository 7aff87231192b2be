"""Messages of ROS 1, as MCAP files carry them that were made of its bags: encoding `ros1`, definitions `ros1msg`.

Fields stand one behind the other, little-endian, nothing between them; a string and an array without a length begin with their
count (wiki.ros.org/msg, mcap.dev/spec/registry).
"""

import re
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

NUMBERS: Mapping[str, str] = {
    "bool": "?", "byte": "b", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I",
    "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
STAMPS: Mapping[str, str] = {"time": "<II", "duration": "<ii"}
MOST_PARTS = 1 << 16
"""Messages within one message: parts that take no bytes could stand in it without end."""
_SECTION = re.compile(r"^=+\n", re.MULTILINE)
_FIELD = re.compile(r"([\w/]+)(\[(\d*)\])?\s+(\w+)")


@dataclass(frozen=True, slots=True)
class _MessageField:
    """kind: of its elements; count: of an array, -1 where each message says it, None of a single value."""

    name: str
    kind: str
    count: int | None


def ros1_decoder(name: str, definition: str) -> Callable[[bytes], dict[str, Any]]:
    """What reads messages of a kind; a stamp is a mapping with `sec` and `nanosec`. Raises ValueError for a definition that
    lacks one of its parts."""
    head, *others = _SECTION.split(definition.replace("\r\n", "\n"))
    texts = {name: head}
    for section in others:
        first, _, text = section.partition("\n")
        texts[first.removeprefix("MSG:").strip()] = text
    kinds = {kind: [_field(line, kind, texts) for line in _lines(text)] for kind, text in texts.items()}
    parts = 0

    def message(kind: str, data: bytes, at: int) -> tuple[dict[str, Any], int]:
        nonlocal parts
        parts += 1
        if parts > MOST_PARTS:
            raise ValueError(f"more than {MOST_PARTS} messages within one")
        values: dict[str, Any] = {}
        for field in kinds[kind]:
            values[field.name], at = value(field, data, at)
        return values, at

    def value(field: _MessageField, data: bytes, at: int) -> tuple[Any, int]:
        count = field.count
        if count == -1:
            count, at = struct.unpack_from("<I", data, at)[0], at + 4
        if count is not None and count > len(data) - at:
            raise ValueError(f"{count} elements in {len(data) - at} bytes")
        if field.kind in NUMBERS and count is not None:
            layout = struct.Struct(f"<{count}{NUMBERS[field.kind]}")
            return layout.unpack_from(data, at), at + layout.size
        if count is None:
            return single(field.kind, data, at)
        items = []
        for _ in range(count):
            item, at = single(field.kind, data, at)
            items.append(item)
        return items, at

    def single(kind: str, data: bytes, at: int) -> tuple[Any, int]:
        if kind in NUMBERS:
            layout = struct.Struct(f"<{NUMBERS[kind]}")
            return layout.unpack_from(data, at)[0], at + layout.size
        if kind in STAMPS:
            sec, nanosec = struct.unpack_from(STAMPS[kind], data, at)
            return {"sec": sec, "nanosec": nanosec}, at + 8
        if kind == "string":
            end = at + 4 + struct.unpack_from("<I", data, at)[0]
            return data[at + 4 : end].decode("utf-8", "replace"), end
        return message(kind, data, at)

    def decode(data: bytes) -> dict[str, Any]:
        nonlocal parts
        parts = 0
        return message(name, data, 0)[0]

    return decode


def _lines(text: str) -> list[str]:
    """The lines of a definition that are fields: no remarks, no constants."""
    lines = (line.partition("#")[0].strip() for line in text.split("\n"))
    return [line for line in lines if line and "=" not in line]


def _field(line: str, owner: str, known: Mapping[str, str]) -> _MessageField:
    match = _FIELD.fullmatch(line)
    if match is None:
        raise ValueError(f"no field: {line[:60]}")
    kind, array, size, name = match.groups()
    count = None if array is None else int(size) if size else -1
    if kind in NUMBERS or kind in STAMPS or kind == "string":
        return _MessageField(name, kind, count)
    package = owner.rpartition("/")[0]
    candidates = (kind, f"{package}/{kind}", *(["std_msgs/Header"] if kind == "Header" else []))
    full = next((c for c in candidates if c in known), None)
    if full is None:
        raise ValueError(f"nothing says what {kind} is")
    return _MessageField(name, full, count)
