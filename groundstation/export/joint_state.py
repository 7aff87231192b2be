"""Named scalars as ROS 2 `sensor_msgs/JointState`: the one message of lists of names and values that stock viewers plot.

Rerun shows protobuf messages of an unknown schema as one value each, and of the ROS messages plots only those that it
knows; this is the one of them that has names. Its `position` then holds values of any kind, the unit is in the name.
CDR, little-endian: OMG DDS-RTPS 2.3, chapter 10; alignment counts from after the four bytes of the head.
"""

import struct
from collections.abc import Sequence

SCHEMA = "sensor_msgs/msg/JointState"
SCHEMA_ENCODING, MESSAGE_ENCODING = "ros2msg", "cdr"
_RULE = "=" * 80
DEFINITION = f"""std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
{_RULE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_RULE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_HEAD = b"\x00\x01\x00\x00"
_NS = 1_000_000_000


class JointStates:
    """Messages with always the same names; values may be NaN, where they are not known."""

    def __init__(self, names: Sequence[str]) -> None:
        self._count = len(names)
        body = bytearray(8) + _text("")  # the time goes into the first eight bytes
        _align(body, 4)
        body += struct.pack("<I", len(names))
        for name in names:
            _align(body, 4)
            body += _text(name)
        _align(body, 4)
        body += struct.pack("<I", len(names))
        _align(body, 8)
        self._before = bytes(body[8:])
        self._values = struct.Struct(f"<{len(names)}d")
        self._after = bytes(8)  # no velocities, no efforts

    def encode(self, stamp_ns: int, values: Sequence[float]) -> bytes:
        """The message of one instant; stamp_ns: UTC or monotonic, below 2^31 seconds."""
        time = struct.pack("<iI", *divmod(stamp_ns, _NS))
        return _HEAD + time + self._before + self._values.pack(*values) + self._after


def _align(body: bytearray, size: int) -> None:
    body += bytes(-len(body) % size)


def _text(words: str) -> bytes:
    data = words.encode() + b"\0"
    return struct.pack("<I", len(data)) + data
