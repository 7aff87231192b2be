"""Decompression and checksums under a bound: what one file may cost, whatever its bytes.

A damaged or hostile file can claim any size and hide gigabytes in a few bytes. Everything a reader computes over such a
file is therefore paid for from an `Effort`, which grows with the size of the file and is far more than a sound file needs.
"""

import zlib
from dataclasses import dataclass

MIB = 1 << 20

MAX_CHUNK = 16 * MIB
"""Content of a compressed chunk. The recorder closes a chunk at 1 MiB, stock tools that rewrite recordings at 4 or 8 MiB;
what claims more than twice that was not written by any of them."""

_CHECKS = 8
"""Times a file's bytes may pass through a checksum. A sound file needs three: its chunks, its data section, its index."""
_EXPANSION = 12
"""Bytes of content for each byte of file. Compressed flights have 2; constant values 4.5 in chunks of half a second, 9.6 in
chunks of 1 MiB."""
_TORN_STEP = 4
"""What a byte of a torn frame costs against a byte of a checksum: it is taken in small steps."""
_TORN_FRAME = 4096
"""What a frame costs besides, for a decoder has to be made for it. Chunks of the recorder are that long or longer."""
_CONTENT_FREE = 32 * MIB
"""Content that any file may have, however small: two of the largest chunks."""
_SEARCH_FREE = 8 * MIB
"""Damaged content of compressed chunks that is searched by seals besides once the file's size: eight chunks of the recorder."""
_SMALLEST_RECORD = 28
"""Bytes of file for a record: uncompressed a message takes 38 or more (head 31, seal 5, content 2) and the index of a chunk
31; a scan of constant values, compressed in chunks of 1 MiB, 45."""
_RECORDS_FREE = 50_000


class Bad(Exception):
    """The bytes at hand are not what was written, or could only be read at a cost that no sound file has."""


class Exhausted(Exception):
    """The file gives more records than any file of its size can hold."""


@dataclass(slots=True)
class Effort:
    """What may still be spent on one file: bytes checked, bytes of decompressed content and how many of them are searched
    for messages, records."""

    checks: int
    content: int
    searches: int
    records: int

    @classmethod
    def for_size(cls, size: int) -> "Effort":
        """The allowance of a file of `size` bytes."""
        return cls(
            checks=_CHECKS * size + MIB,
            content=_EXPANSION * size + _CONTENT_FREE,
            searches=size + _SEARCH_FREE,
            records=size // _SMALLEST_RECORD + _RECORDS_FREE,
        )

    def check(self, size: int) -> None:
        """Pay for a checksum over `size` bytes; Bad when the file has used up its allowance."""
        if size > self.checks:
            raise Bad("the file claims records over records; what they hold is searched for messages only")
        self.checks -= size

    def expand(self, size: int) -> None:
        self.content -= size
        if self.content < 0:
            raise Bad(f"it holds more content than {_EXPANSION} times the file: not a recording's")

    def search(self, size: int) -> None:
        """Pay for a search of `size` bytes of content for messages."""
        if size > self.searches:
            raise Bad("more of its content is damaged than is searched")
        self.searches -= size

    def record(self) -> None:
        """Count a record or message; Exhausted when no file of this size can hold so many."""
        self.records -= 1
        if self.records < 0:
            raise Exhausted


def expand(compression: str, stored: memoryview | bytes, size: int, effort: Effort) -> bytes:
    """The `size` bytes that were compressed into `stored`. Bad for anything else, at no more cost than `size`."""
    if size > MAX_CHUNK:
        raise Bad("its size was altered")
    effort.expand(size)
    return expand_within(compression, stored, size, MAX_CHUNK)


def expand_within(compression: str, stored: memoryview | bytes, size: int, most: int) -> bytes:
    """The `size` bytes, no more than `most`, that were compressed into `stored`. Bad for anything else."""
    if size > most:
        raise Bad(f"{size} bytes of content; at most {most} are read")
    if compression == "zstd":
        return _expand_zstd(stored, size, most)
    if compression == "lz4":
        return _expand_lz4(stored, size)
    raise Bad(f"unknown compression {compression[:16]!r}")


def _expand_zstd(stored: memoryview | bytes, size: int, most: int) -> bytes:
    import zstandard

    # a reader with a limit of its own: what the frame's head claims decides nothing, neither memory nor the loop
    try:
        with zstandard.ZstdDecompressor(max_window_size=most).stream_reader(stored, closefd=False) as reader:
            content = reader.read(size + 1)
    except (zstandard.ZstdError, MemoryError) as error:
        raise Bad(f"cannot be decompressed ({error})") from error
    return bytes(content)


def _expand_lz4(stored: memoryview | bytes, size: int) -> bytes:
    import lz4.frame

    try:
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(bytes(stored), max_length=size + 1))
    except (RuntimeError, EOFError, ValueError, MemoryError) as error:
        raise Bad(f"cannot be decompressed ({error})") from error


def expand_torn(data: memoryview | bytes, effort: Effort) -> tuple[bytes, int]:
    """As much of a zstd frame as can be decompressed, and the bytes it took where the frame is whole (0: it is torn)."""
    import zstandard

    content = bytearray()
    try:
        effort.check(_TORN_FRAME)
    except Bad:
        return b"", 0
    decoder = zstandard.ZstdDecompressor(max_window_size=MAX_CHUNK).decompressobj()
    step = 64  # small, for what an error leaves undecoded is lost with its step
    for offset in range(0, len(data), step):
        try:
            effort.check(_TORN_STEP * step)
            piece = decoder.decompress(data[offset : offset + step])
            effort.expand(len(piece))
        except (zstandard.ZstdError, Bad, MemoryError):
            break
        content += piece
        if decoder.eof:
            return bytes(content), min(len(data), offset + step) - len(decoder.unused_data)
        if len(content) > MAX_CHUNK:
            break
    return bytes(content), 0


def crc_matches(stated: int, data: memoryview, effort: Effort) -> bool:
    """Whether a stated CRC-32 holds; False too when the file has used up what may be spent on it."""
    try:
        effort.check(len(data))
    except Bad:
        return False
    return zlib.crc32(data) == stated
