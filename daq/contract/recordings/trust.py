"""Where in damaged bytes a record may begin that can prove itself: found by the bytes that must stand in its head.

One pass of a regular expression; whether the record is what was written is for the checks to tell.
"""

import re

from daq.contract.recordings.mcap_records import MAGIC

_LENGTH = rb".{5}\x00{3}"  # below 2^40
_SHORT = rb".\x00{3}"  # length of a text below 256
_CANDIDATE = re.compile(
    rb"(?s:"
    rb"\x06" + _LENGTH + rb"(?=.{16}" + _LENGTH + rb".{4}(?:\x00{4}|\x04\x00{3}zstd|\x03\x00{3}lz4)" + _LENGTH + rb")"
    rb"|\x09" + _LENGTH + rb"(?=.{16}" + _SHORT + rb")"
    rb"|\x0c" + _LENGTH + rb"(?=" + _SHORT + rb"sideslip\.)"
    rb"|\x07" + _LENGTH + rb"(?=...\x00)"
    rb"|\x08" + _LENGTH + rb"(?=.{32}...\x00)"
    rb"|\x0f\x04\x00{7}"
    rb"|\x02\x14\x00{7}(?=.{20}" + re.escape(MAGIC) + rb")"
    rb"|" + re.escape(MAGIC) + rb"\x01)"
)
_HEADER = re.compile(re.escape(MAGIC) + rb"(?s:\x01" + _LENGTH + rb")")


def next_candidate(data: bytes, at: int, end: int | None = None) -> int:
    """The first byte from `at` on where a record may begin that is worth a check; the length of `data` if there is none.

    end: heads are looked for in the bytes before it only.
    """
    match = _CANDIDATE.search(data, at, len(data) if end is None else end)
    return match.start() if match else len(data)


def begins(data: bytes, at: int) -> bool:
    """Whether a file begins here: the mark, and a header whose lengths fit."""
    match = _HEADER.match(data, at)
    if match is None:
        return False
    body = match.end()
    end = body + int.from_bytes(data[at + 9 : at + 17], "little")
    for _ in range(2):  # profile and library
        if body + 4 > min(end, len(data)):
            return False
        body += 4 + int.from_bytes(data[body : body + 4], "little")
    return body == end <= len(data)
