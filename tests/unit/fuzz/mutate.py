"""Ways to spoil an input: bytes whatever they mean, words of a text, values of a TOML tree. All from one generator."""

import datetime as dt
import math
import tomllib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import tomli_w

Rng = np.random.Generator
Mutator = Callable[[bytes, Rng], bytes]

LARGEST = 2**20
"""Bytes of a mutated input; the largest inputs that are answered stand as cases of their own."""

SCRIPT = "<script>alert(1)</script>"
BIDI = "abc\u202edcm.exe\u2066"

WORDS: tuple[bytes, ...] = (
    b"nan", b"inf", b"-inf", b"1e308", b"-1e308", b"1e-308", b"1e999", b"9" * 30, b"9" * 5000, b"0x" + b"f" * 40, b"1_0", b"",
    b"-", b".", b"--", b"''", b'"', b'"""', b"\0", b"\n", b"\r", b"\t", b",", b";", b"=", b"[", b"[[", b"]", b"{", b"}", b"#",
    b"\xef\xbb\xbf", b"\xff\xfe", b"\xff", b"\xc3\x28", SCRIPT.encode(), BIDI.encode(), "µ°²".encode(), "１２".encode(),
    b"\x1b[2J", b"true", b"null", b"None", b"2026-13-45", b"1979-05-27T07:32:00Z", b"__class__", b"9**9**9", b"../../etc/passwd",
    b"A" * 10_000, b"time", b"segment", b"format = 2", b"1e-320", b"4294967296", b"18446744073709551616", b"-1",
)  # fmt: skip

ODD: tuple[Any, ...] = (
    0, -1, 1, 2, 1e308, -1e308, 1e-320, math.inf, -math.inf, math.nan, 2**31, 2**62, -(2**62), 0.5, True, False, "", "x" * 10_000,
    SCRIPT, BIDI, "a\nb", "nan", "../..", [], [1], [[]], ["a", 1.0], {}, {"a": {"b": 1}}, dt.date(2026, 1, 1),
    dt.time(1, 2), [0.0] * 2000, "deg", "m/s", "x = 1", "9**9**9", "/dev/zero", "-", "9" * 400,
)  # fmt: skip


def _pick(rng: Rng, things: Sequence[Any]) -> Any:
    return things[int(rng.integers(len(things)))]


def _place(data: bytes, rng: Rng) -> int:
    return int(rng.integers(len(data) + 1))


# -------------------------------------------------------------------------------------------------------------- bytes


def flip_bits(data: bytes, rng: Rng) -> bytes:
    """One to sixteen bits the other way round."""
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 17))):
        if out:
            out[int(rng.integers(len(out)))] ^= 1 << int(rng.integers(8))
    return bytes(out)


def cut(data: bytes, rng: Rng) -> bytes:
    """A stretch taken out, in half of all cases up to the end."""
    a, b = sorted((_place(data, rng), _place(data, rng)))
    return data[:a] if rng.random() < 0.5 else data[:a] + data[b:]


def double(data: bytes, rng: Rng) -> bytes:
    """A stretch that stands there twice, or elsewhere too."""
    a, b = sorted((_place(data, rng), _place(data, rng)))
    at = _place(data, rng)
    return data[:at] + data[a:b] + data[at:]


def noise(data: bytes, rng: Rng) -> bytes:
    """A stretch of random bytes, zeros or one byte, in place of what was there or between."""
    length = int(rng.integers(1, 400))
    kinds = (rng.bytes(length), bytes(length), bytes([int(rng.integers(256))]) * length)
    at = _place(data, rng)
    return data[:at] + _pick(rng, kinds) + data[at + int(rng.integers(2)) * length :]


def odd_number(data: bytes, rng: Rng) -> bytes:
    """A number of one to eight bytes at the edge of its range, in place of what was there."""
    size = int(_pick(rng, (1, 2, 4, 8)))
    value = _pick(
        rng, (0, 1, 2 ** (8 * size) - 1, 2 ** (8 * size - 1), 2 ** (8 * size - 1) - 1, 0x7F, 0xFFFF % 2 ** (8 * size))
    )
    at = _place(data, rng)
    return data[:at] + int(value).to_bytes(size, _pick(rng, ("little", "big"))) + data[at + size :]


def odd_double(data: bytes, rng: Rng) -> bytes:
    """A NaN, an infinity or a number near the largest in place of eight bytes or four."""
    kind = _pick(rng, ("<f8", "<f4"))
    with np.errstate(over="ignore"):
        value = np.array(_pick(rng, (np.nan, np.inf, -np.inf, 1e308, 3e38, 1e-310)), kind).tobytes()
    at = _place(data, rng)
    return data[:at] + value + data[at + len(value) :]


BYTES: tuple[Mutator, ...] = (flip_bits, cut, double, noise, odd_number, odd_double)

# --------------------------------------------------------------------------------------------------------------- text


def odd_word(data: bytes, rng: Rng) -> bytes:
    """An odd word in place of what stands between two separators."""
    places = [i for i, byte in enumerate(data[:20_000]) if byte in b" ,;=\n\t[]{}\"'().+*"]
    if len(places) < 2:
        return bytes(_pick(rng, WORDS))
    i = int(rng.integers(len(places) - 1))
    return data[: places[i] + 1] + bytes(_pick(rng, WORDS)) + data[places[i + 1] :]


def lines_moved(data: bytes, rng: Rng) -> bytes:
    """A line left out, doubled, exchanged, or many times there."""
    lines = data.split(b"\n")
    i, j = int(rng.integers(len(lines))), int(rng.integers(len(lines)))
    match int(rng.integers(4)):
        case 0:
            del lines[i]
        case 1:
            lines.insert(j, lines[i])
        case 2:
            lines[i], lines[j] = lines[j], lines[i]
        case _:
            lines[i:i] = [lines[i]] * int(rng.integers(2, 300))
    return b"\n".join(lines)


def encoded(data: bytes, rng: Rng) -> bytes:
    """The text in another encoding, or with a mark in front."""
    text = data.decode("utf-8", "replace")
    coded = (
        b"\xef\xbb\xbf" + data,
        text.encode("utf-16"),
        text.encode("utf-16-le"),
        text.encode("utf-32"),
        text.encode("latin-1", "replace"),
        data.replace(b"\n", b"\r"),
        data.replace(b"\n", b"\r\n"),
    )
    return bytes(_pick(rng, coded))


def nested(data: bytes, rng: Rng) -> bytes:
    """Brackets in brackets, some thousands deep."""
    left, right = _pick(rng, ((b"[", b"]"), (b"(", b")"), (b"{a=", b"}"), (b"a.", b""), (b"-", b"")))
    depth = int(_pick(rng, (40, 300, 10_000)))
    at = _place(data, rng)
    return data[:at] + left * depth + b"1" + right * depth + data[at:]


TEXT: tuple[Mutator, ...] = (odd_word, odd_word, odd_word, lines_moved, lines_moved, encoded, nested)

# --------------------------------------------------------------------------------------------------------------- TOML


def odd_value(data: bytes, rng: Rng) -> bytes:
    """One value of the tree another, away, under another name, or one more."""
    try:
        tree = tomllib.loads(data.decode())
    except (ValueError, RecursionError):
        return flip_bits(data, rng)
    holders = _holders(tree)
    holder = _pick(rng, holders)
    odd = _pick(rng, ODD)
    keys: list[Any] = list(holder) if isinstance(holder, dict) else list(range(len(holder)))
    if not keys:
        return data
    key = _pick(rng, keys)
    match int(rng.integers(6)):
        case 0:
            del holder[key]
        case 1 if isinstance(holder, dict):
            holder[str(odd)[:200]] = holder.pop(key)
        case 2 if isinstance(holder, list):
            holder.append(odd)
        case _:
            holder[key] = odd
    try:
        return tomli_w.dumps(tree).encode("utf-8", "replace")
    except (ValueError, TypeError, RecursionError):
        return data


def _holders(tree: dict[str, Any]) -> list[Any]:
    found: list[Any] = [tree]
    for holder in found:
        inner = holder.values() if isinstance(holder, dict) else holder
        found += [value for value in inner if isinstance(value, (dict, list))]
    return found


TOML: tuple[Mutator, ...] = (*[odd_value] * 12, *TEXT, flip_bits, cut)


def mutated(data: bytes, mutators: Sequence[Mutator], rng: Rng) -> bytes:
    """One to three mutations, one after the other."""
    for _ in range(int(rng.integers(1, 4))):
        data = _pick(rng, mutators)(data, rng)[:LARGEST]
    return data
