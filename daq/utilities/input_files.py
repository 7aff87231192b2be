"""Files that people name, read within bounds: what comes back is what the file holds, or one sentence says why not.

A name can be a pipe that never ends, a device, a folder or a loop of links; a text can be of another encoding; TOML can nest
so deeply, or string together so many key parts, that its reader takes minutes. Each is refused before it costs anything.
"""

import json
import os
import re
import stat
import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from typing import IO, Any

from daq.utilities import limits
from daq.utilities.errors import UserError

LARGEST_TEXT, LARGEST_DATA, DEEPEST = limits.TEXT_BYTES, limits.DATA_BYTES, limits.TOML_DEPTH
_PIECE = 2**20
READ_AT_ONCE = os.O_RDONLY
"""Flags to open a file for its bytes without waiting for the other end of a pipe; Windows lacks some, and needs one more."""
for _flag in ("O_NONBLOCK", "O_CLOEXEC", "O_BINARY"):
    READ_AT_ONCE |= getattr(os, _flag, 0)

_SUNDRIES = re.compile(
    r"""\#[^\n]*+ | \"{3}(?:\\.|[^\\])*?(?:\"{3}|\\?\Z) | '{3}.*?(?:'{3}|\Z) | "(?:\\.|[^"\\\n])*+" | '[^'\n]*+'""",
    re.VERBOSE | re.DOTALL,
)
_KEY_PART = r"[A-Za-z0-9_\-]++[ \t]*+\.[ \t]*+"
_LONG_KEY = re.compile(rf"(?<![A-Za-z0-9_\-])(?:{_KEY_PART}){{{DEEPEST}}}")
_INTEGERS = range(-(2**63), 2**63)  # TOML 1.0: integers are of 64 bits

_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}


def check_file(path: Path, what: str = "file", error: type[UserError] = UserError, most: int = LARGEST_DATA) -> int:
    """Size in bytes of an ordinary file. Raises `error` when it is none, cannot be read or is longer than `most`.

    what: what there should be, told where nothing is.
    """
    handle = _opened(path, what, error)
    try:
        return _measured(handle, path, what, error, most)
    finally:
        os.close(handle)


def read_bytes(path: Path, what: str = "file", error: type[UserError] = UserError, most: int = LARGEST_DATA) -> bytes:
    """The bytes of an ordinary file. Raises `error` as `check_file` does."""
    handle = _opened(path, what, error)
    try:
        _measured(handle, path, what, error, most)
        with os.fdopen(handle, "rb", closefd=False) as file:
            data = _read_on(file, most + 1)
    except OSError as reason:
        raise error(f"{path}: cannot be read ({reason.strerror})") from reason
    finally:
        os.close(handle)
    if len(data) > most:
        raise error(f"{path}: longer than the {most} bytes that are read")
    return data


def _read_on(file: IO[bytes], most: int) -> bytes:
    """Bytes to the end, no further than `most`: a file of /proc says 0 bytes and holds more.

    Piece by piece, for reading `most` bytes at once takes room for all of them before the first is there.
    """
    data = bytearray()
    while piece := file.read(min(_PIECE, most - len(data))):
        data += piece
    return bytes(data)


def _opened(path: Path, what: str, error: type[UserError]) -> int:
    try:
        return os.open(path, READ_AT_ONCE)  # without waiting for the other end of a pipe
    except FileNotFoundError:
        raise error(f"{path}: no such {what}") from None
    except (OSError, ValueError) as reason:
        cause = reason.strerror if isinstance(reason, OSError) else reason
        raise error(f"{path}: cannot be read ({cause})") from reason


def _measured(handle: int, path: Path, what: str, error: type[UserError], most: int) -> int:
    status = os.fstat(handle)
    if not stat.S_ISREG(status.st_mode):
        kind = _KINDS.get(stat.S_IFMT(status.st_mode), "no ordinary file")
        raise error(f"{path}: that is {kind}; give the name of an ordinary file")
    if status.st_size > most:
        raise error(f"{path}: {status.st_size} bytes long; at most {most} are read")
    return status.st_size


def read_text(path: Path, what: str = "file", error: type[UserError] = UserError) -> str:
    """The text of a small UTF-8 file, without a byte-order mark. Raises `error` as `check_file` does, or for another encoding."""
    data = read_bytes(path, what, error, LARGEST_TEXT)
    try:
        return data.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as reason:
        hint = "it looks like UTF-16; " if data[:2] in (b"\xff\xfe", b"\xfe\xff") else ""
        sentence = f"{path}: cannot be read as a text file in UTF-8 ({hint}byte {reason.start}); save it as UTF-8"
        raise error(sentence) from reason


def read_toml(path: Path, what: str = "file", error: type[UserError] = UserError) -> dict[str, Any]:
    """The tables of a TOML file. Raises `error` for a file that cannot be read or is no TOML."""
    return parse_toml(read_text(path, what, error), str(path), error)


def parse_toml(text: str, where: str, error: type[UserError] = UserError) -> dict[str, Any]:
    """The tables of a TOML text; `where` begins the sentence of the `error` raised for anything that is none."""
    if _LONG_KEY.search(_SUNDRIES.sub(_stand_in, text)):
        raise error(f"{where}: a key of more than {DEEPEST} parts; write it with fewer dots")
    try:
        table = tomllib.loads(text)
    except RecursionError:
        raise error(f"{where}: nested more than {DEEPEST} deep; write it flatter") from None
    except ValueError as reason:  # TOMLDecodeError, and what int() says of five thousand digits
        message = str(reason).splitlines()[0][:200]
        raise error(
            f"{where}: not valid TOML: {message}; correct it, or give another if it is not a TOML file"
        ) from reason
    _check_values(table, where, error)
    return table


def read_json(path: Path, what: str = "file", error: type[UserError] = UserError) -> Any:
    """What a JSON file holds, of whatever kind. Raises `error` for a file that cannot be read or is no JSON."""
    data = read_bytes(path, what, error, limits.TREE_BYTES)
    try:
        return json.loads(data)
    except RecursionError:
        raise error(f"{path}: nested beyond reading; write it flatter") from None
    except ValueError as reason:
        raise error(f"{path}: not valid JSON: {str(reason)[:200]}; correct it, or give another file") from reason


def read_xml(path: Path, what: str = "file", error: type[UserError] = UserError) -> ET.Element:
    """The root of an XML file. Raises `error` for a file that cannot be read, is no XML, declares entities (with which a few
    lines swell to gigabytes), or nests deeper or holds more than limits.XML_DEPTH and XML_ELEMENTS."""
    data = read_bytes(path, what, error, limits.TREE_BYTES)
    if b"<!ENTITY" in data or b"<\x00!\x00E\x00N\x00T" in data:
        raise error(f"{path}: declares entities, which a {what} has no need of; remove them")
    parser: Any = ET.XMLPullParser(("start", "end"))
    root: ET.Element | None = None
    depth = count = 0
    try:
        for offset in range(0, len(data), _PIECE):
            parser.feed(data[offset : offset + _PIECE])
            for event, element in parser.read_events():
                root = element if root is None else root
                depth += 1 if event == "start" else -1
                count += event == "start"
                if depth > limits.XML_DEPTH or count > limits.XML_ELEMENTS:
                    raise error(
                        f"{path}: more than {limits.XML_DEPTH} elements in one another or {limits.XML_ELEMENTS} in all;"
                        f" that is no {what}"
                    )
        parser.close()
    except (ET.ParseError, ValueError, LookupError) as reason:  # the last: an encoding that nobody knows
        raise error(f"{path}: no XML ({reason})") from reason
    if root is None:
        raise error(f"{path}: no XML (nothing in it)")
    return root


def matching(pattern: Path, error: type[UserError] = UserError) -> list[Path]:
    """The files that a pattern with * ? [ ] and ** names, sorted. Links to folders are not followed by **. Raises `error` where
    more names than limits.LOOKED_AT would have to be looked at, or more than limits.FLIGHTS match."""
    budget = [limits.LOOKED_AT]
    paths: list[Path] = []
    for path in _matched(Path(pattern.anchor), pattern.parts[1:] if pattern.anchor else pattern.parts, budget):
        if budget[0] < 0 or len(paths) >= limits.FLIGHTS:
            break
        paths.append(path)
    if budget[0] < 0 or len(paths) >= limits.FLIGHTS:
        raise error(
            f"{pattern}: more than {limits.LOOKED_AT} names to look at, or {limits.FLIGHTS} that match;"
            " begin the pattern further in"
        )
    return sorted(dict.fromkeys(paths))


def _matched(folder: Path, parts: tuple[str, ...], budget: list[int]) -> Iterator[Path]:
    if not parts:
        yield folder
        return
    first, rest = parts[0], parts[1:]
    if not any(c in first for c in "*?["):
        inner = folder / first
        if inner.exists() or inner.is_symlink():
            yield from _matched(inner, rest, budget)
        return
    try:
        with os.scandir(folder) as listing:
            entries = sorted(listing, key=lambda e: e.name)
    except OSError:
        return  # a file, or a folder that may not be looked into
    budget[0] -= len(entries)
    if first == "**":
        yield from _matched(folder, rest, budget)
    for entry in entries:
        if budget[0] < 0:
            return
        hidden = entry.name.startswith(".")
        if first == "**":
            if not hidden and entry.is_dir(follow_symlinks=False):
                yield from _matched(folder / entry.name, parts, budget)
        elif fnmatchcase(entry.name, first) and not (hidden and not first.startswith(".")):
            yield from _matched(folder / entry.name, rest, budget)


def _stand_in(found: "re.Match[str]") -> str:
    """A quoted key counts as a part; what a comment holds counts for nothing."""
    return " " if found[0].startswith("#") else "q"


def _check_values(table: dict[str, Any], where: str, error: type[UserError]) -> None:
    level: list[tuple[str, Any]] = list(table.items())
    for _ in range(DEEPEST):
        inner: list[tuple[str, Any]] = []
        for key, value in level:
            if isinstance(value, dict):
                inner += [(f"{key}.{k}"[:80], v) for k, v in value.items()]
            elif isinstance(value, list):
                inner += [(key, v) for v in value]
            elif isinstance(value, int) and value not in _INTEGERS:
                raise error(f"{where}: key {key[:80]}: a whole number of more than 64 bits; write it as 1.0e30")
        if not inner:
            return
        level = inner
    raise error(f"{where}: nested more than {DEEPEST} deep; write it flatter")
