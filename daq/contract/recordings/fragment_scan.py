"""Messages in damaged bytes: found by their seals, whatever became of the records around them."""

import re
from collections.abc import Iterator

import zstandard

from daq.contract.errors import UserError
from daq.contract.recordings.mcap_records import MAX_CHUNK
from daq.contract.recordings.recording import SCHEMA_OF_TOPIC, Entry, entry_of
from daq.contract.seal import SEAL_SIZE, seal_holds

_MAX_HEADLESS = 1 << 12  # longer messages are found by their record heads only
_MESSAGE_HEAD = 9 + 22  # record head, channel, sequence, two times
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_ZSTD_MARK = b"\x04\x00\x00\x00zstd"
_MAYBE_MESSAGE = re.compile(rb"\x05(?=..\x00{6})", re.DOTALL)
_MAYBE_CONTENT = re.compile(rb"[\x08\x0a]")  # tag of field 1, a number or a timestamp: all our messages begin so
_SEAL_TAG = re.compile(rb"\x7d")


def salvage_region(region: bytes) -> Iterator[Entry]:
    """Messages whose seals hold within a damaged stretch, its compressed parts included."""
    yield from find_sealed(region)
    for match in re.finditer(re.escape(_ZSTD_MAGIC), region):
        yield from find_sealed(decompress_torn(region[match.start() :]))
    for match in re.finditer(re.escape(_ZSTD_MARK), region):
        frame = match.end() + 8
        if region[frame : frame + 4] != _ZSTD_MAGIC:
            yield from find_sealed(decompress_torn(_ZSTD_MAGIC + region[frame + 4 :]))


def find_sealed(region: bytes) -> Iterator[Entry]:
    """Messages with intact content in a stretch of damaged bytes.

    First by their record heads, which say where they end; then, in the gaps between those found, by content alone.
    """
    done = 0
    for match in _MAYBE_MESSAGE.finditer(region):
        at = match.start()
        if at < done:
            continue
        end = at + 9 + int.from_bytes(region[at + 1 : at + 9], "little")
        entry = _sealed_entry(region[at + _MESSAGE_HEAD : end]) if end <= len(region) else None
        if entry is None:
            continue
        yield from _headless(region[done:at])
        yield entry
        done = end
    yield from _headless(region[done:])


def _headless(gap: bytes) -> Iterator[Entry]:
    """Messages whose record head is damaged but whose content is not: from a first field to a seal that holds."""
    done = 0
    for match in _MAYBE_CONTENT.finditer(gap):
        start = match.start()
        if start < done:
            continue
        limit = min(len(gap), start + _MAX_HEADLESS)
        for tail in _SEAL_TAG.finditer(gap, start, limit):
            entry = _sealed_entry(gap[start : tail.start() + SEAL_SIZE])
            if entry is not None:
                yield entry
                done = tail.start() + SEAL_SIZE
                break


def _sealed_entry(data: bytes) -> Entry | None:
    for topic, schema in SCHEMA_OF_TOPIC.items():
        if seal_holds(schema, data):
            try:
                return entry_of(topic, data)
            except UserError:
                return None
    return None


def decompress_torn(data: bytes) -> bytes:
    """As much of a zstd frame as can be decompressed."""
    decoder = zstandard.ZstdDecompressor().decompressobj()
    out = bytearray()
    for at in range(0, len(data), 64):
        try:
            out += decoder.decompress(data[at : at + 64])
        except zstandard.ZstdError:
            break
        if decoder.eof or len(out) > MAX_CHUNK:
            break
    return bytes(out)
