"""Messages of ROS 1 in MCAP files that were converted from its bags: encoding `ros1`, definitions `ros1msg`.

Fields follow each other, little-endian, without padding; a string and an array of variable length begin with their count
(wiki.ros.org/msg, mcap.dev/spec/registry).
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
"""Messages within one message: an array of messages without fields takes no bytes and could be endless."""
_SECTION = re.compile(r"^=+\n", re.MULTILINE)
_FIELD = re.compile(r"([\w/]+)(\[(\d*)\])?\s+(\w+)")


@dataclass(frozen=True, slots=True)
class _MessageField:
    """kind: of its elements; count: of an array, -1 where each message states it, None for a single value."""

    name: str
    kind: str
    count: int | None


def ros1_decoder(name: str, definition: str) -> Callable[[bytes], dict[str, Any]]:
    """The decoder of a kind of message; a stamp is a mapping with `sec` and `nanosec`. Raises ValueError for a definition that
    lacks one of its parts."""
    head, *sections = _SECTION.split(definition.replace("\r\n", "\n"))
    texts = {name: head}
    for section in sections:
        first, _, text = section.partition("\n")
        texts[first.removeprefix("MSG:").strip()] = text
    kinds = {kind: [_field(line, kind, texts) for line in _lines(text)] for kind, text in texts.items()}
    parts = 0

    def message(kind: str, data: bytes, offset: int) -> tuple[dict[str, Any], int]:
        nonlocal parts
        parts += 1
        if parts > MOST_PARTS:
            raise ValueError(f"more than {MOST_PARTS} messages within one")
        values: dict[str, Any] = {}
        for field in kinds[kind]:
            values[field.name], offset = value(field, data, offset)
        return values, offset

    def value(field: _MessageField, data: bytes, offset: int) -> tuple[Any, int]:
        count = field.count
        if count == -1:
            count, offset = struct.unpack_from("<I", data, offset)[0], offset + 4
        if count is not None and count > len(data) - offset:
            raise ValueError(f"{count} elements in {len(data) - offset} bytes")
        if field.kind in NUMBERS and count is not None:
            layout = struct.Struct(f"<{count}{NUMBERS[field.kind]}")
            return layout.unpack_from(data, offset), offset + layout.size
        if count is None:
            return single(field.kind, data, offset)
        items = []
        for _ in range(count):
            item, offset = single(field.kind, data, offset)
            items.append(item)
        return items, offset

    def single(kind: str, data: bytes, offset: int) -> tuple[Any, int]:
        if kind in NUMBERS:
            layout = struct.Struct(f"<{NUMBERS[kind]}")
            return layout.unpack_from(data, offset)[0], offset + layout.size
        if kind in STAMPS:
            sec, nanosec = struct.unpack_from(STAMPS[kind], data, offset)
            return {"sec": sec, "nanosec": nanosec}, offset + 8
        if kind == "string":
            end = offset + 4 + struct.unpack_from("<I", data, offset)[0]
            return data[offset + 4 : end].decode("utf-8", "replace"), end
        return message(kind, data, offset)

    def decode(data: bytes) -> dict[str, Any]:
        nonlocal parts
        parts = 0
        return message(name, data, 0)[0]

    return decode


def _lines(text: str) -> list[str]:
    """The lines of a definition that are fields, without comments and constants."""
    lines = (line.partition("#")[0].strip() for line in text.split("\n"))
    return [line for line in lines if line and "=" not in line]


def _field(line: str, owner: str, kinds: Mapping[str, str]) -> _MessageField:
    """The field of a line in the definition of `owner`. kinds: of messages that are defined. Raises ValueError."""
    match = _FIELD.fullmatch(line)
    if match is None:
        raise ValueError(f"no field: {line[:60]}")
    kind, array, size, name = match.groups()
    count = None if array is None else int(size) if size else -1
    if kind in NUMBERS or kind in STAMPS or kind == "string":
        return _MessageField(name, kind, count)
    package = owner.rpartition("/")[0]
    candidates = (kind, f"{package}/{kind}", *(["std_msgs/Header"] if kind == "Header" else []))
    full = next((c for c in candidates if c in kinds), None)
    if full is None:
        raise ValueError(f"no definition of {kind}")
    return _MessageField(name, full, count)
