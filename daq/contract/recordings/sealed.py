"""Search for stretches of bytes with a valid seal, wherever they begin and end, in time proportional to the bytes.

A message is proven by its seal: the CRC-32 over the name of its schema and its content equals the four bytes behind the
tag. Trying every beginning with every end costs the square of the length. CRC-32 is linear, so the state of the checksum
from s to t can be taken apart into a part that depends on s and one that depends on t only:

    state(s, t) = P[t] ^ Z^(t-s) (P[s] ^ start)       P[i]: state after the bytes before i, from 0; Z: one zero byte
    Z^(W-s) (P[s] ^ start) = Z^(W-t) (P[t] ^ sealed)  both sides brought to the end of a window of W bytes

A beginning and an end belong together where the two sides are equal: one number for each position, and a search for equal
numbers. What is found is checked by the plain CRC before it is given out.
"""

import zlib
from collections.abc import Iterator, Mapping
from functools import cache

import numpy as np
from numpy.typing import NDArray

from daq.contract.seal import SEAL_SIZE, SEAL_TAG, seal_start

REACH = 1 << 12
"""Longest content found by its seal alone [bytes]: a scan of all channels has 400; longer messages are found by record heads."""
SHORTEST = 10
"""Shortest content with its seal [bytes]: a field's tag and the seal are six, and every message of ours has a time."""

_WINDOW = 1 << 14
_BUCKETS = 1 << 18
_HALF = np.uint64(32)
_PLACE = np.uint64(0xFFFFFFFF)
_FIRST_TAGS = (0x08, 0x0A, 0x10, 0x18)
"""First bytes of our messages: tag of field 1, a number or a timestamp, or of field 2 or 3 where earlier fields are 0 and
therefore omitted."""
_MAY_BEGIN = np.isin(np.arange(256), _FIRST_TAGS)

Keys = NDArray[np.uint32]
Found = tuple[int, int, str]


@cache
def _byte_table() -> Keys:
    return np.array([zlib.crc32(bytes([b]), 0xFFFFFFFF) ^ 0xFFFFFFFF for b in range(256)], np.uint32)


@cache
def _powers() -> Keys:
    """(window, 256): contribution of a byte at a position of the window to the state at the window's end."""
    table = _byte_table()
    powers = np.empty((_WINDOW, 256), np.uint32)
    powers[-1] = table
    for i in range(_WINDOW - 2, -1, -1):
        next_row = powers[i + 1]
        powers[i] = (next_row >> np.uint32(8)) ^ table[next_row & np.uint32(0xFF)]
    return powers


@cache
def _start_keys(schema: str) -> Keys:
    """(window - 3,): contribution of the initial state of a schema's seal, at a position of the window, to its end."""
    state = (seal_start(schema) ^ 0xFFFFFFFF).to_bytes(4, "little")
    powers = _powers()
    keys = np.zeros(_WINDOW - 3, np.uint32)
    for k in range(4):
        keys ^= powers[k : _WINDOW - 3 + k, state[k]]
    return keys


def sealed_stretches(data: bytes, schemas: Mapping[str, str]) -> Iterator[Found]:
    """Yield (begin, end, key) of each stretch that is sealed as one of `schemas` (key -> schema name), without overlaps.

    end: behind the seal, the nearest one for each beginning; the search continues behind it.
    """
    last_end = 0
    for window_start in range(0, max(len(data) - SHORTEST + 1, 0), _WINDOW - REACH):
        window = data[window_start : window_start + _WINDOW]
        if window.find(SEAL_TAG, SHORTEST - SEAL_SIZE) < 0:
            continue
        is_last = window_start + _WINDOW >= len(data)
        for begin, end, key in _in_window(window, schemas, max(0, last_end - window_start)):
            if begin >= _WINDOW - REACH and not is_last:
                break
            last_end = window_start + end
            yield window_start + begin, last_end, key
        if is_last:
            return


def _in_window(window: bytes, schemas: Mapping[str, str], begin_at: int) -> Iterator[Found]:
    data = np.frombuffer(window, np.uint8)
    tails = np.flatnonzero(data[: -SEAL_SIZE + 1] == SEAL_TAG[0])
    starts = np.flatnonzero(_MAY_BEGIN[data[: -SHORTEST + 1]])
    starts = starts[starts >= begin_at]
    if not tails.size or not starts.size:
        return
    powers = _powers()
    prefix = np.zeros(data.size + 1, np.uint32)
    np.bitwise_xor.accumulate(powers[np.arange(data.size), data], out=prefix[1:])
    ends = prefix[tails]
    for k in range(4):
        ends = ends ^ powers[tails + k, data[tails + 1 + k] ^ 0xFF]
    last_end = begin_at
    for begin, end, key in sorted(_pairs(prefix, starts, tails, ends, schemas)):
        if begin < last_end:
            continue
        content = window[begin : end - SEAL_SIZE]
        if zlib.crc32(content, seal_start(schemas[key])) == int.from_bytes(window[end - 4 : end], "little"):
            last_end = end
            yield begin, end, key


def _pairs(
    prefix: Keys, starts: NDArray[np.int64], tails: NDArray[np.int64], ends: Keys, schemas: Mapping[str, str]
) -> Iterator[Found]:
    """Yield each beginning with the nearest end that has the same key, for all schemas."""
    present = np.zeros(_BUCKETS, bool)
    present[ends & (_BUCKETS - 1)] = True
    # key and position in one number: the first one not below (key, nearest allowed position) is the matching end
    places = np.sort(ends.astype(np.uint64) << _HALF | tails.astype(np.uint64))
    for name, schema in schemas.items():
        keys = prefix[starts] ^ _start_keys(schema)[starts]
        candidates = present[keys & (_BUCKETS - 1)]
        begin, target_keys = starts[candidates], keys[candidates].astype(np.uint64) << _HALF
        nearest = np.searchsorted(places, target_keys | (begin + (SHORTEST - SEAL_SIZE)).astype(np.uint64))
        nearest_ends = places[np.minimum(nearest, places.size - 1)]
        tail = (nearest_ends & _PLACE).astype(np.int64)
        fits = (
            (nearest < places.size)
            & (nearest_ends >> _HALF == target_keys >> _HALF)
            & (tail - begin + SEAL_SIZE <= REACH)
        )
        for b, t in zip(begin[fits].tolist(), tail[fits].tolist(), strict=True):
            yield b, t + SEAL_SIZE, name
