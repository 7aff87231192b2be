"""Files that claim more than they hold, each a few kilobytes to a few megabytes: what the tests of bounded readers share."""

import json
import random
import struct
import zlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from io import BytesIO

from daq.contract.link.wire import SCAN_FAST_ID, layouts, pack_scan
from daq.contract.recordings.messages import Statistics
from daq.contract.recordings.recording import INFO_NAME, RecordingWriter, scan_entry, with_digest
from daq.contract.scan import Scan, encode_scan
from daq.contract.seal import seal
from daq.transport.mavlink_codec import FrameEncoder
from tests.unit.daq.synthetic import make_info, make_scan

MAGIC = b"\x89MCAP0\r\n"
_ZSTD = b"\x28\xb5\x2f\xfd"


def text(content: str | bytes) -> bytes:
    """A string as MCAP writes it."""
    data = content.encode() if isinstance(content, str) else content
    return struct.pack("<I", len(data)) + data


def record(opcode: int, body: bytes) -> bytes:
    """Code, length, body."""
    return struct.pack("<BQ", opcode, len(body)) + body


HEAD = MAGIC + record(1, text("sideslip") + text("x"))


def chunk(compression: str, stored: bytes, size: int, crc: int = 1) -> bytes:
    """A chunk that claims `size` bytes of content."""
    return record(
        6, struct.pack("<QQQI", 0, 0, size, crc) + text(compression) + struct.pack("<Q", len(stored)) + stored
    )


def message(number: int, data: bytes) -> bytes:
    """A message of a channel that nobody declared: its seal has to tell what it is."""
    return record(5, struct.pack("<HIQQ", 77, number, number * 50_000_000, number * 50_000_000) + data)


def metadata(name: str, fields: Mapping[str, str]) -> bytes:
    """A metadata record."""
    pairs = b"".join(text(k) + text(v) for k, v in fields.items())
    return record(12, text(name) + struct.pack("<I", len(pairs)) + pairs)


def attachment(name: str, data: bytes) -> bytes:
    """An attachment with its checksum."""
    body = struct.pack("<QQ", 0, 0) + text(name) + text("") + struct.pack("<Q", len(data)) + data
    return record(9, body + struct.pack("<I", zlib.crc32(body)))


def zstd_of_one_byte(size: int, byte: int = 0) -> bytes:
    """A frame of `size` equal bytes, four bytes for each 128 KiB: 131 kB hold 4 GiB."""
    blocks = [struct.pack("<I", 1 << 1 | (1 << 17) << 3)[:3] + bytes([byte])] * (size >> 17)
    return _ZSTD + b"\x00\x38" + b"".join(blocks) + b"\x01\x00\x00"


def zstd_claiming(size: int) -> bytes:
    """A frame whose head claims `size` bytes, with none behind it."""
    return _ZSTD + b"\xe0" + struct.pack("<Q", size) + b"\x01\x00\x00"


def lz4_of_zeros(size: int) -> bytes:
    """An lz4 frame of zeros."""
    import lz4.frame

    compressor = lz4.frame.LZ4FrameCompressor()
    piece = bytes(1 << 24)
    return compressor.begin() + b"".join(compressor.compress(piece) for _ in range(size >> 24)) + compressor.flush()


def torn_frames(count: int) -> bytes:
    """Chunks whose compressed content is whole up to its middle."""
    import zstandard

    content = b"".join(message(n, encode_scan(make_scan(n))) for n in range(40))
    frame = zstandard.ZstdCompressor().compress(content)
    torn = frame[: len(frame) // 2] + bytes(16) + frame[len(frame) // 2 + 16 :]
    return chunk("zstd", torn, len(content), zlib.crc32(content)) * count


def recording(scans: Iterable[Scan], statistics: Statistics | None = None, **identity: object) -> bytes:
    """A sound recording."""
    stream = BytesIO()
    writer = RecordingWriter(stream, replace(make_info(), **identity))  # type: ignore[arg-type]
    for scan in scans:
        writer.write(scan_entry(scan))
    if statistics is not None:
        writer.write_message(statistics)
    writer.finish()
    return stream.getvalue()


def tiny_scans(count: int) -> bytes:
    """Messages that hold a number, a time and a seal: as many as bytes allow."""
    sealed = (
        seal("sideslip.Scan", bytes([0x08, 0x80 | n & 0x7F, 0x80 | n >> 7 & 0x7F, n >> 14, 0x10, 1]))
        for n in range(count)
    )
    return b"".join(message(n, data) for n, data in enumerate(sealed))


_IDENTITY = dict.fromkeys(("session", "source", "aircraft", "role", "software"), "x")
_LIES = Statistics(
    2**64 - 1, 0, "s1", 2**32 - 1, next_number=2**32 - 1, written=2**32 - 1, dropped=5, absent=((0, 2**32 - 1), (5, 2)),
    final=True, extra={"abandoned_x": 1, "abandoned_99999999999": 2, "abandoned_": 3},
)  # fmt: skip
_SCANS = [make_scan(n) for n in range(0, 60, 2)]

CASES: dict[str, Callable[[], bytes]] = {
    "tags 2 KiB": lambda: b"\x08\x7d" * (1 << 10),
    "tags 16 KiB": lambda: b"\x08\x7d" * (1 << 13),
    "tags 2 MiB": lambda: HEAD + b"\x08\x7d" * (1 << 20),
    "noise 1 MiB": lambda: random.Random(1).randbytes(1 << 20),
    "noise 6 MiB": lambda: HEAD + random.Random(2).randbytes(6 << 20),
    "zeros": lambda: HEAD + bytes(2 << 20),
    "200 torn frames": lambda: HEAD + torn_frames(200),
    "frames within frames": lambda: (_ZSTD + b"\x00\x38" + struct.pack("<I", 100 << 3)[:3] + bytes(11)) * 100_000,
    "zstd of 4 GiB": lambda: HEAD + chunk("zstd", zstd_of_one_byte(4 << 30), 4 << 30),
    "zstd of 4 GiB claiming 1 MiB": lambda: HEAD + chunk("zstd", zstd_of_one_byte(4 << 30), 1 << 20),
    "zstd of 4 GiB claiming none": lambda: HEAD + chunk("zstd", zstd_of_one_byte(4 << 30), 0),
    "zstd of tags, many": lambda: HEAD + chunk("zstd", zstd_of_one_byte(16 << 20, 0x7D), 16 << 20) * 300,
    "zstd claiming 2^62": lambda: HEAD + chunk("zstd", zstd_claiming(1 << 62), 0) + chunk("zstd", zstd_claiming(1 << 62), 9),
    "lz4 of 1 GiB": lambda: HEAD + chunk("lz4", lz4_of_zeros(1 << 30), 1 << 20) + chunk("lz4", lz4_of_zeros(1 << 24), 0),
    "scans 0 and 2^32-1": lambda: recording([make_scan(0), Scan(2**32 - 1, 2**64 - 1)]),
    "tiny scans": lambda: HEAD + tiny_scans(8_000),
    "tiny scans, loose": lambda: b"\xff" * 9 + tiny_scans(8_000),
    "statistics that lie": lambda: recording(_SCANS, _LIES),
    "lost ranges of 32 bits": lambda: recording(_SCANS, details={"lost_to_damage": "[[0, 4294967295]]"}),
    "lost ranges nested": lambda: recording(_SCANS, details={"lost_to_damage": "[" * 100_000}),
    "lost ranges infinite": lambda: recording(_SCANS, details={"lost_to_damage": "[[0, 1e400], [0, NaN]]"}),
    "segment number huge": lambda: HEAD
    + metadata(INFO_NAME, with_digest({**_IDENTITY, "segment": "99999999999", "scan_rate_hz": "nan", "started_utc_ns": "9" * 40}))
    + tiny_scans(9),
    "identity of 5000 digits": lambda: HEAD
    + metadata(INFO_NAME, with_digest({**_IDENTITY, "segment": "9" * 5000, "scan_rate_hz": "1", "started_utc_ns": "1"})),
    "identity poor": lambda: HEAD + metadata(INFO_NAME, with_digest({"session": "x"})) + tiny_scans(9),
    "identity nested": lambda: HEAD + attachment("sideslip.recording.json", b"[" * 1_000_000) + tiny_scans(9),
    "identity a list": lambda: HEAD + attachment("sideslip.recording.json", b"[1]") + tiny_scans(9),
    "identity of numbers": lambda: HEAD + attachment("sideslip.recording.json", json.dumps({"session": 5}).encode()),
    "metadata of 8 MiB": lambda: HEAD + metadata(INFO_NAME, {"a": "b" * (8 << 20)}),
    "metadata, many": lambda: HEAD + metadata("", {}) * 50_000,
    "metadata within metadata": lambda: HEAD
    + b"".join(b"\x0c" + struct.pack("<Q", 3 << 20) + text("sideslip.detail") for _ in range(150_000)),
    "attachments, many": lambda: HEAD + attachment("a", b"") * 20_000,
    "channels, thousands": lambda: HEAD
    + b"".join(
        record(4, struct.pack("<HH", i, 0) + text(f"/topic/{i}") + text("b") + text(""))
        + record(5, struct.pack("<HIQQ", i, 0, 0, 0))
        for i in range(12_000)
    ),
    "chunks within chunks": lambda: HEAD
    + b"".join(
        struct.pack("<BQQQQII", 6, size + 40, 0, 0, size, 1, 0) + struct.pack("<Q", size) + bytes(8)
        for size in range(4 << 20, 50_000, -57)
    ),
    "ends of data, many": lambda: HEAD + record(15, b"1234") * 100_000,
    "damages, many": lambda: HEAD + (record(7, b"\x01\x00" + struct.pack("<I", 16) + bytes(16)) + b"\xee" * 9) * 20_000,
    "files, many": lambda: (HEAD + record(15, bytes(4)) + record(2, bytes(20)) + MAGIC) * 20_000,
    "footer that lies": lambda: HEAD + record(15, bytes(4)) + record(2, struct.pack("<QQI", 1 << 63, 1 << 62, 1)) + MAGIC,
    "message heads of 64 KiB": lambda: HEAD + b"\x05\xff\xff\x00\x00\x00\x00\x00\x00\x7d\x7d" * 100_000,
    "calibration that is no text": lambda: recording(_SCANS, attachments={"calibration/pitot.toml": b"\xff\xfe"}),
    "calibration nested": lambda: recording(_SCANS, attachments={"calibration/a.toml": b"a=" + b"[" * 100_000}),
    "facts that are none": lambda: recording(_SCANS, details={"static.nvm": "00ff", "imu.accel_scale_m_s2": "nan"}),
}  # fmt: skip
"""Name -> bytes of a file that once hung, filled the memory or ended in a traceback, or could."""

_STAMP = struct.pack(">Q", 1_790_000_000_000_000)


def telemetry(count: int, between: bytes = b"") -> bytes:
    """Records of a telemetry log, a scan each, its number and boot id all over the place."""
    encoder, layout, rng = FrameEncoder(1, 1), layouts()[SCAN_FAST_ID], random.Random(4)
    base = make_scan(5)
    out = []
    for _ in range(count):
        scan = replace(
            base, number=rng.choice((0, 2**32 - 1, rng.randrange(2**32))), time_monotonic_ns=rng.randrange(2**48)
        )
        out += [_STAMP, encoder.frame(SCAN_FAST_ID, pack_scan(layout, scan, rng.randrange(256))), between]
    return b"".join(out)


TLOGS: dict[str, Callable[[], bytes]] = {
    "noise": lambda: random.Random(3).randbytes(4 << 20),
    "heads of frames": lambda: (_STAMP + b"\xfd\xff\x00\x00\x00\x01\x01\x00\x00\x00") * 100_000,
    "magics": lambda: b"\x00\x01\xfd\x00\x01\xfd\x00\x00\xfd" * 100_000,
    "frames among noise": lambda: telemetry(500, random.Random(5).randbytes(300)),
    "scans of any number": lambda: telemetry(5000),
}
"""The same for telemetry logs."""
