"""Inputs that once ended in a traceback, a hang or a full memory, or that an attacker would try first; each is answered."""

import io
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from tests.unit.fuzz import seeds

MOST = 16 * 2**20 - 1
"""Length of the largest inputs: what is shorter than 16 MiB is answered within the fence."""


@dataclass(frozen=True)
class Kept:
    """kind: of `KINDS`, whose first reader gets it. large: of some megabytes, part of the study only."""

    kind: str
    what: str
    data: Callable[[], bytes]
    large: bool = False


def _csv(*rows: str) -> bytes:
    return ("\n".join(rows) + "\n").encode()


def _steady(count: int = 9) -> list[str]:
    return [f"{0.05 * i:.2f},0.1,0.2" for i in range(count)]


def _parquet(table: object, **options: object) -> bytes:
    import pyarrow.parquet as pq

    stream = io.BytesIO()
    pq.write_table(table, stream, **options)
    return stream.getvalue()


def _many_equal_rows() -> bytes:
    """Forty million rows in a few kilobytes: run-length encoded."""
    import pyarrow as pa

    rows = 8_000_000
    same = pa.repeat(1.0, rows)
    return _parquet(pa.table({"time": same, **{f"x{i}": same for i in range(5)}}))


def _swollen_page() -> bytes:
    """A page of a hundred megabytes in some kilobytes."""
    import pyarrow as pa

    zeros = pa.array(np.zeros(13_000_000))
    return _parquet(pa.table({"time": zeros}), compression="zstd", use_dictionary=False, data_page_size=2**30)


def _lying_rows() -> bytes:
    """A footer that announces more rows than there are pages."""
    data = seeds.parquet_inputs()[0]
    return data.replace(b"\x16" + bytes([2 * seeds.ROWS]), b"\x16" + bytes([2 * seeds.ROWS + 2]))


def _statistics_that_do_not_fit() -> bytes:
    """A column said to have no empty cells, with statistics that count some: Arrow's accessor of it ends the process."""
    import pyarrow as pa

    data = _parquet(pa.table({"time": [0.0, 0.05], "p": [0.1, 0.2]}))
    optional = b"\x25\x02\x18\x04time"
    assert optional in data
    return data.replace(optional, b"\x25\x00\x18\x04time")


def _deep_parquet() -> bytes:
    import pyarrow as pa

    value: object = 1.0
    for _ in range(60):
        value = [value]
    return _parquet(pa.table({"time": [0.0, 0.1], "p": [1.0, 2.0], "deep": [value, value]}))


def _ulog(*messages: bytes) -> bytes:
    head = b"ULog\x01\x12\x35\x01" + bytes(8) + seeds.ulog_message(b"B", bytes(40))
    return head + b"".join(messages)


def _format(text: str) -> bytes:
    return seeds.ulog_message(b"F", text.encode())


def _topic(name: str, number: int = 0) -> bytes:
    return seeds.ulog_message(b"A", struct.pack("<BH", 0, number) + name.encode())


def _small_topics() -> bytes:
    """As many small samples as fit."""
    one = seeds.ulog_message(b"D", struct.pack("<HQ", 0, 5))
    return _ulog(_format("t:uint64_t timestamp;"), _topic("t"), one * (MOST // len(one) - 20))


def _dataflash_format(kind: int, name: bytes, letters: bytes, labels: bytes, length: int) -> bytes:
    return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", kind, length, name, letters, labels)


def _dataflash_instances() -> bytes:
    """A field of instances that is another number in every message."""
    head = _dataflash_format(130, b"X", b"QIB", b"TimeUS,I,a", 16)
    return head + b"".join(b"\xa3\x95\x82" + struct.pack("<QIB", i, i, 1) for i in range(200_000))


def _frames(number: int, count: int) -> bytes:
    """Frames of one message with all fields zero, the shortest there are."""
    import fastcrc
    from pymavlink.dialects.v20 import ardupilotmega

    body = bytes([1, 0, 0, 0, 1, 1]) + number.to_bytes(3, "little") + b"\0"
    crc = fastcrc.crc16.mcrf4xx(body + bytes([ardupilotmega.mavlink_map[number].crc_extra]))
    return (struct.pack(">Q", 1_700_000_000_000_000) + b"\xfd" + body + crc.to_bytes(2, "little")) * count


def _toml(text: str) -> Callable[[], bytes]:
    return text.encode


def _noise() -> bytes:
    return np.random.default_rng(5).bytes(MOST)


def kept() -> Iterator[Kept]:
    """All of them."""
    yield from _tables()
    yield from _logs()
    yield from _texts()


def _tables() -> Iterator[Kept]:
    head = "time,p,q"
    stamps = ["inf", "-inf", "nan", "1e308", "-1e308", "1e13", "9.3e9", "1e-320", "1_0", ""]
    for stamp in stamps:
        yield Kept("csv", f"time {stamp!r} in every row", lambda s=stamp: _csv(head, *[f"{s},0.1,0.2"] * 9))  # type: ignore[misc]
        yield Kept("csv", f"time {stamp!r} once", lambda s=stamp: _csv(head, *_steady(), f"{s},0.1,0.2"))  # type: ignore[misc]
    yield Kept("csv", "one byte", lambda: b"t")
    yield Kept("csv", "nothing", lambda: b"")
    yield Kept("csv", "only a mark", lambda: b"\xef\xbb\xbf")
    yield Kept("csv", "zeros", lambda: bytes(1000))
    yield Kept("csv", "half a character of UTF-16", lambda: b"\xff\xfet")
    yield Kept("csv", "values of 1e308", lambda: _csv(head, *(f"{0.05 * i},1e308,-1e308" for i in range(9))))
    yield Kept("csv", "a column twice", lambda: _csv("time,p,p", *_steady()))
    yield Kept("csv", "a column named by a script", lambda: _csv("time,p,<script>alert(1)</script>", *_steady()))
    yield Kept("csv", "a column named right to left", lambda: _csv("time,p,\u202egnol", *_steady()))
    yield Kept(
        "csv",
        "column names of 10 kB",
        lambda: _csv(f"time,p,{'x' * 10_000},{'x' * 10_000}y", *(f"{r},1" for r in _steady())),
    )
    yield Kept("csv", "a cell of 200 kB", lambda: _csv(head, *_steady(), f"0.5,{'1' * 200_000},1"))
    yield Kept("csv", "a quote that never ends", lambda: _csv(head, *_steady(), '0.5,"1,1', *_steady(500)))
    yield Kept("csv", "5000 columns", lambda: _csv("time," + ",".join(f"c{i}" for i in range(5000)), "0," * 5000 + "1"))
    yield Kept(
        "csv", "1000 columns", lambda: _csv("time," + ",".join(f"c{i}" for i in range(1000)), *["0," * 1000 + "1"] * 9)
    )
    yield Kept(
        "csv",
        "100,000 columns",
        lambda: _csv("time," + ",".join(f"c{i}" for i in range(100_000)), "0," * 100_000 + "1"),
    )
    for text in ("1,", "ab\n", "\n", "a", '"', "time,p\n", "#\n", "\x0c", ";", "0,0\n"):
        yield Kept("csv", f"16 MiB of {text!r}", lambda t=text: (t * (MOST // len(t))).encode(), large=True)  # type: ignore[misc]
    yield Kept("csv", "8 million rows of a digit", lambda: b"time\n" + b"1\n" * (MOST // 2 - 9))
    yield Kept("csv", "16 MiB of numbers", lambda: b"time,p\n" + b"1,2\n" * (MOST // 4 - 9), large=True)
    yield Kept("csv", "16 MiB of words", lambda: b"time,p\n" + b"ab,cd\n" * (MOST // 6 - 9), large=True)
    yield Kept(
        "csv",
        "16 MiB of wide rows",
        lambda: b"time," + b",".join(b"c%d" % i for i in range(4000)) + b"\n" + (b"0," * 4000 + b"1\n") * 2050,
        large=True,
    )
    yield Kept("csv", "noise", _noise, large=True)
    yield Kept("parquet", "forty million rows in some kilobytes", _many_equal_rows, large=True)
    yield Kept("parquet", "a page of a hundred megabytes in some kilobytes", _swollen_page, large=True)
    yield Kept("parquet", "more rows than pages", _lying_rows)
    yield Kept("parquet", "lists sixty deep", _deep_parquet)
    yield Kept("parquet", "statistics that do not fit their column", _statistics_that_do_not_fit)
    yield Kept(
        "parquet", "a footer as long as the file", lambda: b"PAR1" + bytes(100) + struct.pack("<I", 100) + b"PAR1"
    )
    yield Kept("parquet", "a footer longer than the file", lambda: b"PAR1" + struct.pack("<I", 2**31 - 1) + b"PAR1")
    yield Kept(
        "parquet",
        "16 MiB of footer",
        lambda: b"PAR1" + b"\x15" * (MOST - 12) + struct.pack("<I", MOST - 12) + b"PAR1",
        large=True,
    )


def _logs() -> Iterator[Kept]:
    bag = seeds.bag_inputs()[1]
    yield Kept("bag", "a type that nobody knows", lambda: bag.replace(b"float32[3]", b"float33[3]"))
    yield Kept("ulog", "a format of itself", lambda: _ulog(_format("t:uint64_t timestamp;t[9] x;"), _topic("t")))
    yield Kept(
        "ulog",
        "arrays of arrays of arrays",
        lambda: _ulog(
            _format("c:double[999] x;"), _format("b:c[999] x;"), _format("a:uint64_t timestamp;b[999] x;"), _topic("a")
        ),
    )
    yield Kept(
        "ulog",
        "a short time",
        lambda: _ulog(_format("t:uint8_t timestamp;"), _topic("t"), seeds.ulog_message(b"D", b"\0\0\1") * 9),
    )
    yield Kept(
        "ulog",
        "65,536 topics",
        lambda: _ulog(_format("t:uint64_t timestamp;" + "float x;" * 9), *(_topic("t", i) for i in range(65_536))),
    )
    yield Kept(
        "ulog",
        "appended data before the head",
        lambda: _ulog().replace(bytes(24), struct.pack("<3Q", 1, 2**63, 17)) + b"\xff" * 99,
    )
    yield Kept("ulog", "as many samples as fit", _small_topics, large=True)
    for fill in (0, 0x44, 0x46, 0x41, 0xFF):
        yield Kept("ulog", f"16 MiB of {fill:#x}", lambda f=fill: _ulog(bytes([f]) * (MOST - 99)), large=True)  # type: ignore[misc]
    yield Kept(
        "ulog",
        "noise behind a topic",
        lambda: _ulog(_format("t:uint64_t timestamp;"), _topic("t"), _noise()),
        large=True,
    )
    yield Kept(
        "ulog",
        "D behind a topic",
        lambda: _ulog(_format("t:uint64_t timestamp;"), _topic("t"), b"D" * (MOST - 200)),
        large=True,
    )
    yield Kept("ulog", "F: without end", lambda: _ulog(b"FF:" * (MOST // 3 - 50)), large=True)
    yield Kept(
        "dataflash",
        "a description of no field",
        lambda: _dataflash_format(130, b"X", b"", b"", 3) + b"\xa3\x95\x82" * 99,
    )
    yield Kept("dataflash", "instances without end", _dataflash_instances)
    yield Kept(
        "dataflash",
        "time that is text",
        lambda: _dataflash_format(130, b"X", b"ZB", b"TimeUS,a", 68) + b"\xa3\x95\x82" + bytes(65),
    )
    yield Kept("dataflash", "16 MiB of heads", lambda: b"\xa3\x95" * (MOST // 2), large=True)
    yield Kept(
        "dataflash",
        "16 MiB of the shortest messages",
        lambda: _dataflash_format(130, b"X", b"B", b"TimeUS", 4) + b"\xa3\x95\x82\1" * (MOST // 4 - 30),
        large=True,
    )
    yield Kept(
        "dataflash",
        "16 MiB of descriptions",
        lambda: _dataflash_format(130, b"X", b"QB", b"TimeUS,a", 12) * (MOST // 89),
        large=True,
    )
    yield Kept(
        "dataflash",
        "16 bytes become 16 columns",
        lambda: (
            _dataflash_format(130, b"X", b"Q" + b"b" * 15, b"TimeUS," + b",".join(b"a%x" % i for i in range(15)), 26)
            + b"".join(b"\xa3\x95\x82" + struct.pack("<Q15b", 50_000 * i, *range(15)) for i in range(600_000))
        ),
        large=True,
    )
    yield Kept(
        "dataflash", "noise", lambda: _dataflash_format(130, b"X", b"QB", b"TimeUS,a", 12) + _noise()[:-99], large=True
    )
    yield Kept("tlog", "bytes of 0xFD", lambda: b"\xfd" * 60_000)
    yield Kept("tlog", "16 MiB of 0xFD", lambda: b"\xfd" * MOST, large=True)
    yield Kept("tlog", "16 MiB of 0xFE", lambda: b"\xfe" * MOST, large=True)
    yield Kept("tlog", "16 MiB of zeros", lambda: bytes(MOST), large=True)
    yield Kept("tlog", "16 MiB of plausible stamps", lambda: (b"\0\5" + bytes(6) + b"\xfd") * (MOST // 9), large=True)
    yield Kept("tlog", "noise", _noise, large=True)
    yield Kept("tlog", "long arrays in short frames", lambda: _frames(375, 16_000_000 // 21 // 8))
    yield Kept("tlog", "16 MiB of long arrays in short frames", lambda: _frames(375, MOST // 21), large=True)
    yield Kept("tlog", "16 MiB of many fields in short frames", lambda: _frames(1, MOST // 21), large=True)


def _texts() -> Iterator[Kept]:
    for steps in ("[]", "[0.0]"):
        text = f'version = 1\nkind = "doublet"\ntime_step = 0.05\n[increments]\ndelta_a = {steps}\n'
        yield Kept("manoeuvre", f"increments {steps}", text.encode)
    yield Kept(
        "mapping", "a column without a source", _toml('format = 1\n[time]\ncolumn = "time"\n[columns]\np = []\n')
    )
    yield Kept("mapping", "no columns", _toml("format = 1\n[columns]\n"))
    yield Kept("mapping", "a delimiter of two characters", _toml('format = 1\n[file]\ndelimiter = ",,"\n'))
    yield Kept("mapping", "an endless factor", _toml('format = 1\n[columns]\np = { column = "q", factor = inf }\n'))
    yield Kept("mapping", "a header line beyond the end", _toml("format = 1\n[file]\nheader_line = 99999999999\n"))
    yield Kept(
        "mapping", "many rows after the header", _toml("format = 1\n[file]\nskip_after_header = 9223372036854775807\n")
    )
    for kind in (
        "mapping",
        "logger",
        "ground",
        "scenario",
        "calibration",
        "bench plan",
        "aircraft",
        "model",
        "effects",
    ):
        yield Kept(kind, "arrays 10,000 deep", _toml("a = " + "[" * 10_000 + "]" * 10_000))
        yield Kept(kind, "tables 10,000 deep", _toml("a = " + "{a=" * 10_000 + "1" + "}" * 10_000))
        yield Kept(kind, "a key of 300,000 parts", _toml("a." * 300_000 + "a = 1"))
        yield Kept(kind, "a number of 5000 digits", _toml("a = " + "9" * 5000))
        yield Kept(kind, "a number of a million hexadecimal digits", _toml("a = 0x" + "f" * 1_000_000))
        yield Kept(kind, "two million bytes", lambda: b"#" * 2_000_000)
        yield Kept(kind, "UTF-16", lambda: "a = 1".encode("utf-16"))
        yield Kept(kind, "zeros", lambda: bytes(100))
        yield Kept(kind, "one byte", lambda: b"=")
        yield Kept(kind, "a control character in a key", _toml('"\\u001b[2J\\u202e" = 1'))
    for text in (
        "9**9**9",
        "9**9**9**9**9",
        "(" * 10_000,
        "(" * 1900 + "1" + ")" * 1900,
        "-" * 3000 + "1",
        "+".join("1" * 1500),
        "__class__",
        "().__class__",
        "p.__class__",
        "__import__('os')",
        "ｐ + 1",
        "p if q else r",
        "lambda: 1",
        "[1]*9**9",
        "'a'*9**9",
        "1e999",
        "9" * 3999,
        "0x" + "f" * 3000,
        "p\0q",
        "*".join(["p"] * 1900),
        "1j",
        "True",
        "f'{p}'",
        "",
        "p^" * 900 + "2",
        "max(1, 2",
        "where(1, 2, 3)",
        "sin(sin)",
        "sin = 3",
        "\u202ep",
        "10**400",
        "(-8)**0.5",
        "1/0",
    ):
        yield Kept("expression", text[:40] or "nothing", text.encode)
    for text in (
        '{"sent": Infinity, "heard": 1, "streams": []}',
        "[" * 100_000,
        '{"sent": 1e999, "heard": 1, "streams": []}',
        "null",
        '{"sent": 1, "heard": 2, "streams": [[1]]}',
        '{"sent": -1, "heard": 2, "streams": [[1, 1, 1, -5]]}',
        '{"sent": NaN}',
        '{"sent": 1, "heard": 340282366920938463463374607431768211456, "streams": []}',
        "9" * 5000,
    ):
        yield Kept("signing state", text[:40], text.encode)
    yield Kept("signing key", "zeros", lambda: bytes(32))
    yield Kept("signing key", "one byte 32 times", lambda: b"a" * 32)
    yield Kept("signing key", "two million bytes", lambda: b"ab" * 1_000_000)
