"""A manoeuvre on the radio: packed small, cut into fragments of MANOEUVRE_DATA, and put together again.

Packed are JSON and zlib: what is flown as second differences of whole numbers (a designed input is smooth, so they are small),
kind, aircraft and model, and the digest that a file has, which proves the whole. Predictions and limits stay on the ground.
"""

import json
import zlib
from collections.abc import Sequence
from itertools import accumulate
from typing import Any

from daq.contract.manoeuvre import FINENESS, Manoeuvre, ManoeuvreError, checked

FRAGMENT_BYTES = 190
"""Bytes of a fragment in the dialect definition."""
MOST_FRAGMENTS = 64
"""Bits of MANOEUVRE_STATUS.held; 12 kB are a minute of three controls."""
RECEIVING, CHECKING, TAKEN, REFUSED = range(4)
"""MANOEUVRE_STATUS.result."""
_MOST_UNPACKED = 2**17
"""Bytes of JSON: ten minutes of doublets; whoever holds the key cannot make the logger unpack more."""
_FIRST_DIFFERENCES = 2


def pack(manoeuvre: Manoeuvre) -> bytes:
    """What is sent. Raises ManoeuvreError where it is too long for the link."""
    steps = {name: _differences([round(v / FINENESS) for v in values]) for name, values in manoeuvre.increments.items()}
    content = {
        "kind": manoeuvre.kind,
        "aircraft": manoeuvre.aircraft,
        "model": manoeuvre.model,
        "time_step": manoeuvre.time_step,
        "digest": manoeuvre.digest,
        "steps": steps,
    }
    data = zlib.compress(json.dumps(content, separators=(",", ":")).encode(), 9)
    limit = FRAGMENT_BYTES * MOST_FRAGMENTS
    if len(data) > limit:
        raise ManoeuvreError(
            f"manoeuvre {manoeuvre.digest[:6]}: {len(data)} bytes, at most {limit} go up the link (some minute of smooth "
            "inputs); put the file on board, or design a shorter one"
        )
    return data


def unpack(data: bytes) -> Manoeuvre:
    """The manoeuvre, its digest proven and its values checked. Raises ManoeuvreError with one sentence."""
    try:
        unpacker = zlib.decompressobj()
        text = unpacker.decompress(data, _MOST_UNPACKED)
        if not unpacker.eof or unpacker.unused_data:
            raise ManoeuvreError("manoeuvre sent up: longer than it may be, or torn; send it again")
        content = json.loads(text)
        manoeuvre = Manoeuvre(
            str(content["kind"]),
            float(content["time_step"]),
            {str(name): _values(values) for name, values in content["steps"].items()},
            aircraft=str(content["aircraft"]),
            model=str(content["model"]),
        )
        digest = content["digest"]
    except (zlib.error, ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise ManoeuvreError(f"manoeuvre sent up: not one ({type(error).__name__}); send it again") from error
    checked(manoeuvre, "manoeuvre sent up")
    if digest != manoeuvre.digest:
        raise ManoeuvreError("manoeuvre sent up: its digest does not fit its values; send it again")
    return manoeuvre


def fragments(data: bytes) -> list[bytes]:
    return [data[i : i + FRAGMENT_BYTES] for i in range(0, len(data), FRAGMENT_BYTES)]


def _differences(values: Sequence[int]) -> list[int]:
    for _ in range(_FIRST_DIFFERENCES):
        values = [b - a for a, b in zip((0, *values), values, strict=False)]
    return list(values)


def _values(differences: Any) -> tuple[float, ...]:
    integers: list[int] = [int(v) for v in differences]
    for _ in range(_FIRST_DIFFERENCES):
        integers = list(accumulate(integers))
    return tuple(v * FINENESS for v in integers)
