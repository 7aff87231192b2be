"""Messages in damaged bytes: found by their seals, whatever became of the records around them.

Time goes with the bytes, whatever they are: beginnings and ends are matched all at once (`recordings.sealed`), and what could be
repeated without end (long messages, compressed parts) is paid for from the file's `Effort`.
"""

import re
import struct
from collections.abc import Iterator

from daq.contract.recordings.expand import Bad, Effort, expand_torn
from daq.contract.recordings.recording import SCHEMA_OF_TOPIC, RecordedMessage, entry_of
from daq.contract.seal import SEAL_SIZE, SEAL_TAG, seal_holds
from daq.utilities.errors import UserError

_RECORD_HEAD = struct.Struct("<BQ")
_MESSAGE = 5
_MESSAGE_HEAD = _RECORD_HEAD.size + 22  # channel, sequence, two times
_DECLARATIONS = 1 << 16  # schemas and channels stand at the beginning of a chunk
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_ZSTD_MARK = b"\x04\x00\x00\x00zstd"
_LONG_MESSAGE = re.compile(rb"\x05(?=..\x00{6})", re.DOTALL)


def salvage_region(region: bytes, effort: Effort) -> Iterator[RecordedMessage]:
    """Messages whose seals hold within a damaged stretch, its compressed parts included."""
    yield from find_sealed(region, effort)
    frame_end = 0
    for match in re.finditer(re.escape(_ZSTD_MAGIC), region):
        if match.start() < frame_end:
            continue  # within a frame that was whole
        content, frame_bytes = expand_torn(memoryview(region)[match.start() :], effort)
        frame_end = match.start() + frame_bytes
        yield from _in_content(content, effort)
    for match in re.finditer(re.escape(_ZSTD_MARK), region):
        frame = match.end() + 8
        if region[frame : frame + 4] != _ZSTD_MAGIC and len(region) > frame + 4:
            piece = region[frame + 4 : frame + 4 + int.from_bytes(region[match.end() : frame], "little")]
            yield from _in_content(expand_torn(_ZSTD_MAGIC + piece, effort)[0], effort)


def _in_content(content: bytes, effort: Effort) -> Iterator[RecordedMessage]:
    """Messages in the content of a torn chunk: record by record as far as it is sound, by their seals from there on."""
    offset = 0
    while offset + _MESSAGE_HEAD <= len(content):
        opcode, length = _RECORD_HEAD.unpack_from(content, offset)
        begin, end = offset + _MESSAGE_HEAD, offset + _RECORD_HEAD.size + length
        if end > len(content):
            break
        if opcode == _MESSAGE:
            data = content[begin:end]
            topic = next((t for t, schema in SCHEMA_OF_TOPIC.items() if seal_holds(schema, data)), None)
            if topic is None:
                break
            effort.record()
            yield from _entry(topic, data)
        elif offset > _DECLARATIONS:
            break
        offset = end
    try:
        effort.search(len(content) - offset)
    except Bad:
        return
    yield from find_sealed(content[offset:], effort)


def find_sealed(region: bytes, effort: Effort) -> Iterator[RecordedMessage]:
    """Messages with intact content in a stretch of bytes: those of usual length by their seals alone, long ones by their
    record heads too, which say where they end."""
    from daq.contract.recordings.sealed import sealed_stretches  # needs numpy, which a sound recording does without

    if SEAL_TAG not in region:
        return
    for begin, end, topic in sealed_stretches(region, SCHEMA_OF_TOPIC):
        effort.record()
        yield from _entry(topic, region[begin:end])
    yield from _find_long(region, effort)


def _find_long(region: bytes, effort: Effort) -> Iterator[RecordedMessage]:
    from daq.contract.recordings.sealed import REACH

    last_end = 0
    for match in _LONG_MESSAGE.finditer(region):
        head = match.start()
        begin, end = head + _MESSAGE_HEAD, head + _RECORD_HEAD.size + region[head + 1] + 256 * region[head + 2]
        if head < last_end or end - begin <= REACH or end > len(region) or region[end - SEAL_SIZE] != SEAL_TAG[0]:
            continue
        try:
            effort.check((end - begin) * len(SCHEMA_OF_TOPIC))
        except Bad:
            return
        content = region[begin:end]
        for topic in (t for t, schema in SCHEMA_OF_TOPIC.items() if seal_holds(schema, content)):
            effort.record()
            yield from _entry(topic, content)
            last_end = end


def _entry(topic: str, content: bytes) -> Iterator[RecordedMessage]:
    """The message around sealed content; nothing for content that was sealed but is none (nobody but a forger does that)."""
    try:
        yield entry_of(topic, content)
    except UserError:
        return
