"""Files that people name, read within bounds: what comes back is what the file holds, or one sentence says why not.

A name can be a pipe that never ends, a device, a folder or a loop of links; a text can be of another encoding; TOML can nest
so deeply, or string together so many key parts, that its reader takes minutes. Each is refused before it costs anything.
"""

import os
import re
import stat
import tomllib
from pathlib import Path
from typing import IO, Any

from daq.contract.errors import UserError

LARGEST_TEXT = 2**20
"""Bytes of a TOML file; the longest that this program writes, a model with all its effects, has some 30 kB."""
LARGEST_DATA = 2**31
"""Bytes of a log that is read whole: a day at 100 Hz with forty channels."""
_PIECE = 2**20
DEEPEST = 32
"""Tables within tables, and parts of one dotted key; the files described in docs/ need five."""

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
        return os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # without waiting for the other end of a pipe
    except FileNotFoundError:
        raise error(f"{path}: no such {what}") from None
    except (OSError, ValueError) as reason:
        why = reason.strerror if isinstance(reason, OSError) else reason
        raise error(f"{path}: cannot be read ({why})") from reason


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
        said = f"{path}: cannot be read as a text file in UTF-8 ({hint}byte {reason.start}); save it as UTF-8"
        raise error(said) from reason


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
        said = str(reason).splitlines()[0][:200]
        raise error(
            f"{where}: not valid TOML: {said}; correct it, or give another if it is not a TOML file"
        ) from reason
    _check_values(table, where, error)
    return table


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
