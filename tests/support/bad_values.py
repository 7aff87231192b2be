"""Every message of the dialect with every kind of bad value: in all fields, in each field of a sound one, of wrong length."""

import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from daq.transport.mavlink_codec import FrameEncoder, message_types

LONGEST = 255  # bytes of a payload
FLOATS: Mapping[str, float] = {
    "nan": float("nan"), "inf": float("inf"), "-inf": -float("inf"), "huge": 3.4e38, "negative": -1.0, "tiny": 1e-45,
}  # fmt: skip
TEXTS: Mapping[str, bytes] = {
    "control": b"\x1b[2J\x1b]0;x\x07\r\n", "turned": "\u202e\u2066".encode(), "no text": b"\xff\xfe\x80", "markup": b"<script>",
    "number": b"nan", "long": b"\\" * 255,
}  # fmt: skip


@dataclass(frozen=True)
class BadFrame:
    """what: message and kind of value, for a person."""

    what: str
    data: bytes


def fields_of(layout: str) -> list[tuple[int, str]]:
    """Count and code of the parts of a struct format; a text is one part."""
    parts = [(int(count or 1), code) for count, code in re.findall(r"(\d*)([a-zA-Z?])", layout)]
    return [part for count, code in parts for part in ([(count, code)] if code == "s" else [(1, code)] * count)]


def bad_values(count: int, code: str) -> dict[str, Any]:
    """Kind -> value for one part of a format."""
    if code == "s":
        return {kind: text[:count] for kind, text in TEXTS.items()}
    if code in "fd":
        return dict(FLOATS)
    bits = 8 * struct.calcsize(f"<{code}")
    low, high = (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if code.islower() else (0, 2**bits - 1)
    return {"lowest": low, "huge": high, "half": high // 2 + 1 if code.isupper() else -1}


def bad_frames(encoder: FrameEncoder, sound: Mapping[int, bytes]) -> Iterator[BadFrame]:
    """Frames as an encoder's sender would send them. sound: payloads by message id, whose other fields stay; zeros elsewhere."""
    for made in sorted(message_types().values(), key=lambda m: m.msg_id):
        layout, parts = made.codec.format, fields_of(made.codec.format)
        choices = [bad_values(*part) for part in parts]
        base = list(struct.unpack(layout, sound.get(made.msg_id, b"")[: made.codec.size].ljust(made.codec.size, b"\0")))
        for n in range(max(map(len, choices), default=0)):
            every = [list(kinds.values())[n % len(kinds)] for kinds in choices]
            yield BadFrame(f"{made.name} all {n}", encoder.frame(made.msg_id, struct.pack(layout, *every)))
        for place, kinds in enumerate(choices):
            for kind, value in kinds.items():
                payload = struct.pack(layout, *base[:place], value, *base[place + 1 :])
                yield BadFrame(f"{made.name} field {place} {kind}", encoder.frame(made.msg_id, payload))
        for size in {0, 1, made.codec.size // 2, made.codec.size - 1, min(LONGEST, made.codec.size + 1), LONGEST}:
            yield BadFrame(f"{made.name} of {size} bytes", encoder.frame(made.msg_id, b"\xff" * size))
