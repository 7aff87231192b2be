"""What logger and companion say to each other: frames of bytes one way, lines of JSON the other.

A frame is its length (4 bytes, big-endian) and that many bytes: first a `Setup` as JSON, then encoded scans. A line is an answer.
"""

import json
import math
import re
import struct
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import BinaryIO

LENGTH = struct.Struct(">I")
LONGEST_FRAME = 1 << 20
LONGEST_LINE = 1 << 14
MOST_VALUES = 64
LONGEST_TEXT = 500
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_.]{0,9}")  # what NAMED_VALUE_FLOAT has room for


@dataclass(frozen=True)
class Setup:
    """aircraft: its name, or the path of its file. calibration: directory. details: facts of the sensors. every_s: of flight
    between two answers. model: name or file of what is estimated; empty: lateral. watch: with the gap monitor beside it.
    until: the derivative that the sequencer flies a set for; empty: none."""

    aircraft: str
    calibration: str
    details: Mapping[str, str]
    every_s: float
    model: str = ""
    watch: bool = False
    until: str = ""


@dataclass(frozen=True)
class CompanionReply:
    """values: derivative -> estimate and bound, those that can be told. words: one line for a person. trouble: why there is
    no more. point: a line on the test point that is just over; alarm: a warning, such as the gap monitor's; empty: none new."""

    time: float = math.nan
    values: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    words: str = ""
    trouble: str = ""
    point: str = ""
    alarm: str = ""

    def line(self) -> bytes:
        """As the companion writes it."""
        return json.dumps({**asdict(self), "time": self.time if math.isfinite(self.time) else None}).encode() + b"\n"

    @property
    def record(self) -> str:
        """As the recording keeps it: JSON of time and values."""
        return json.dumps({"time": self.time, "values": {n: list(v) for n, v in self.values.items()}})


def frame(data: bytes) -> bytes:
    """Bytes with their length before them."""
    return LENGTH.pack(len(data)) + data


def setup_frame(setup: Setup) -> bytes:
    """The first frame."""
    return frame(json.dumps(asdict(setup)).encode())


def read_frame(stream: BinaryIO) -> bytes | None:
    """The next frame of a blocking stream; None at its end."""
    head = stream.read(LENGTH.size)
    if len(head) < LENGTH.size:
        return None
    (length,) = LENGTH.unpack(head)
    data = stream.read(length) if length <= LONGEST_FRAME else b""
    return data if len(data) == length else None


def read_setup(data: bytes) -> Setup:
    """The setup of the first frame."""
    return Setup(**json.loads(data))


def read_answer(line: bytes) -> CompanionReply | None:
    """An answer, of what it holds only what can be shown; None for a line that is none."""
    try:
        answer = json.loads(line)
        values = answer["values"]
        pairs = {
            str(name): (float(pair[0]), float(pair[1]))
            for name, pair in list(values.items())[:MOST_VALUES]
            if _NAME.fullmatch(name) and len(pair) == 2
        }
        time = math.nan if answer["time"] is None else float(answer["time"])
        texts = [str(answer.get(name, ""))[:LONGEST_TEXT] for name in ("words", "trouble", "point", "alarm")]
    except (ValueError, KeyError, TypeError, AttributeError, IndexError, RecursionError, OverflowError):
        return None
    finite = {n: v for n, v in pairs.items() if all(map(math.isfinite, v))}
    return CompanionReply(time, finite, *texts)
