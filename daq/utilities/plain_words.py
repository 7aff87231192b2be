"""Text from outside made safe to show: a name may hold a line end, an escape code of a terminal or a mark that turns the
direction of reading, and would then be shown as something else. Such characters are shown by their number instead."""

import unicodedata
from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any, TextIO

LONGEST_NAME = 120  # characters of a name that are shown
_LONGEST_BYTES = 200  # a file system allows 255 in a file name, of which 55 are left to what is appended

_ALLOWED_CONTROLS = frozenset("\n\t")


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """The end of a sentence on an unknown name: "; did you mean X?" with the most similar known one; "" where none is similar."""
    matches = get_close_matches(word.lower(), list(known), n=1)
    return f"; did you mean {matches[0]}?" if matches else ""


def comma_separated(names: str | Iterable[str]) -> tuple[str, ...]:
    """The names of an option, from "a, b" or from separate names; each once."""
    words = names.split(",") if isinstance(names, str) else names
    return tuple(dict.fromkeys(w.strip() for w in words if w.strip()))


def visible(text: str) -> str:
    """The text with control and format characters (other than line end and tab) and lone surrogates as `\\u202e`.

    Format characters are those of the direction of reading, of zero width and of hyphenation: Unicode categories Cc, Cf, Cs,
    and the line and paragraph separators.
    """
    if text.isascii() and text.isprintable():
        return text
    # a page of megabytes has a hundred different characters
    hidden = {ord(c): _escaped(c) for c in set(text) - _ALLOWED_CONTROLS if _escaped(c) != c}
    return str.translate(text, hidden) if hidden else text


def one_line(text: str, longest: int = 2000) -> str:
    """`visible`, line ends and tabs as blanks, and no longer than `longest` characters."""
    flat = " ".join(visible(text[: 4 * longest]).split())
    return flat if len(flat) <= longest and len(text) <= 4 * longest else f"{flat[: longest - 3]}..."


def plain_name(text: str) -> str:
    """The name of a flight, an aircraft, a model or a column as it is shown on pages and used in file names."""
    return one_line(text, LONGEST_NAME).encode()[:_LONGEST_BYTES].decode("utf-8", "ignore")


def file_name(text: str) -> str:
    """`plain_name` that stays within a folder: no slash, and not only dots."""
    name = plain_name(text).replace("/", "_")
    return name if name.strip(".") else "unnamed"


class VisibleStream:
    """A stream that writes text by `visible`, so that it cannot control the terminal; carriage returns (progress bars) pass."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def flush(self) -> None:
        self._stream.flush()

    @property
    def bare(self) -> TextIO:
        """The stream itself, for callers that write escape codes and have made the text visible themselves."""
        return self._stream

    def write(self, text: str) -> int:
        parts = text.split("\r") if "\r" in text else [text]
        self._stream.write("\r".join(visible(part) for part in parts))
        return len(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def printed(value: object) -> object:
    """A value for a page: text (of whatever type of str) by `visible`, everything else unchanged."""
    return type(value)(visible(value)) if isinstance(value, str) else value


def listed(names: Iterable[str], most: int = 30) -> str:
    """Names with commas, the first `most`, and how many more there are."""
    plain_names = [plain_name(name) for name in names]
    rest = [f"and {len(plain_names) - most} more"] if len(plain_names) > most else []
    return ", ".join(plain_names[:most] + rest)


def _escaped(character: str) -> str:
    if unicodedata.category(character) not in ("Cc", "Cf", "Cs", "Zl", "Zp"):
        return character
    return f"\\u{ord(character):04x}" if ord(character) < 0x10000 else f"\\U{ord(character):08x}"
