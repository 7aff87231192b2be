"""What of a MATLAB 5 file (`save -v6`, `-v7`) is sound, unpacked and with sizes that hold, then read by scipy.

scipy takes the memory that a file announces, for dimensions as for what is packed; here each element is looked at once before
it does. Variables of classes that only MATLAB can read (objects, tables, function handles) and sparse ones are left out.

Format: MathWorks, "MAT-File Format" (level 5).
"""

import io
import struct
import subprocess
import sys
import zlib
from dataclasses import dataclass, field
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.importers.errors import ImportDataError

HEADER = 128
LEAST_UNPACKED, MOST_TIMES_PACKED = 2**26, 16
"""A file may unpack to 64 MiB, or to 16 times its length: numbers of flights pack to a half, constants to nothing."""
MOST_ELEMENTS = 100_000
"""Arrays within arrays of a file; each takes scipy some 20 us."""
DEEPEST = 16
"""Structs within structs; flight records have three or four."""

_MATRIX, _COMPRESSED = 14, 15
_SIZES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8}  # bytes of a number by its type
_TEXTS = (1, 2, 3, 4, 16, 17, 18)
_CELL, _STRUCT, _CHAR = 1, 2, 4
_NUMBERS = range(6, 16)
_DAMAGE = (
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    OSError,
    AttributeError,
    NotImplementedError,
    OverflowError,
    RecursionError,
)


class _Unsound(Exception):
    """An element that does not fit together."""


@dataclass
class _Matlab5Scan:
    """Budgets of one file. order: of its bytes, '<' or '>'."""

    order: str
    unpacked: int
    elements: int = MOST_ELEMENTS
    left_out: int = field(default=0)

    def tag(self, data: bytes, at: int, end: int) -> tuple[int, int, int, int]:
        """Type, begin and end of the content, and where the next element begins."""
        if at + 8 > end:
            raise _Unsound
        kind, size = struct.unpack_from(self.order + "II", data, at)
        if kind >> 16:  # content of up to 4 bytes stands in the tag itself
            kind, size = kind & 0xFFFF, kind >> 16
            if size > 4:
                raise _Unsound
            return kind, at + 4, at + 4 + size, at + 8
        after = at + 8 + size + (-size % 8)
        if at + 8 + size > end:
            raise _Unsound
        return kind, at + 8, at + 8 + size, min(after, end)

    def matrix(self, data: bytes, at: int, end: int, depth: int = 0) -> None:
        """Look at the content of a matrix; raises _Unsound for one that scipy should not see."""
        self.elements -= 1
        if at == end:  # an empty one
            return
        if depth > DEEPEST or self.elements < 0:
            raise _Unsound
        kind, flags_at, flags_end, at = self.tag(data, at, end)
        if kind != 6 or flags_end - flags_at != 8:
            raise _Unsound
        (flags,) = struct.unpack_from(self.order + "I", data, flags_at)
        kind, dims_at, dims_end, at = self.tag(data, at, end)
        count, rest = divmod(dims_end - dims_at, 4)
        if kind != 5 or rest or not 2 <= count <= 8:
            raise _Unsound
        dims = struct.unpack_from(f"{self.order}{count}i", data, dims_at)
        if min(dims) < 0 or prod(dims) > end - at + 8:  # a number takes a byte at least, wherever it stands
            raise _Unsound
        kind, _, _, at = self.tag(data, at, end)  # the name
        if kind not in (1, 2, 16):
            raise _Unsound
        self._content(data, at, end, flags, prod(dims), depth)

    def _content(self, data: bytes, at: int, end: int, flags: int, count: int, depth: int) -> None:
        made = flags & 0xFF
        if made in _NUMBERS:
            for _ in range(2 if flags & 0x0800 else 1):
                kind, a, b, at = self.tag(data, at, end)
                if b - a != count * _SIZES.get(kind, 0) and count:
                    raise _Unsound
        elif made == _CHAR:
            kind, a, b, at = self.tag(data, at, end)
            if kind not in _TEXTS or count > b - a:
                raise _Unsound
        elif made in (_STRUCT, _CELL):
            fields = 1
            if made == _STRUCT:
                at, fields = self._field_names(data, at, end)
            for _ in range(count * fields):
                kind, a, b, at = self.tag(data, at, end)
                if kind != _MATRIX:
                    raise _Unsound
                self.matrix(data, a, b, depth + 1)
        else:
            raise _Unsound

    def _field_names(self, data: bytes, at: int, end: int) -> tuple[int, int]:
        kind, a, b, at = self.tag(data, at, end)
        (length,) = struct.unpack_from(self.order + "i", data, a) if kind == 5 and b - a == 4 else (0,)
        kind, a, b, at = self.tag(data, at, end)
        if kind != 1 or not 0 < length <= 64 or (b - a) % length:
            raise _Unsound
        return at, (b - a) // length

    def inflated(self, packed: bytes) -> bytes:
        """An unpacked element. Raises _Unsound for one that is damaged or swells beyond the budget."""
        try:
            engine = zlib.decompressobj()
            data = engine.decompress(packed, self.unpacked)
        except zlib.error:
            raise _Unsound from None
        self.unpacked -= len(data)
        if engine.unconsumed_tail or self.unpacked <= 0:
            raise _Unsound
        return data


def read_v5(path: Path, data: bytes) -> tuple[dict[str, Any], int]:
    """Variables by name, as `plain` has them, and how many were left out. Raises ImportDataError for a file without any."""
    import warnings

    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError, MatReadWarning

    sound, left_out = _sound(path, data)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MatReadWarning)  # of names that come twice
            _survives(path, sound)
            found = loadmat(io.BytesIO(sound), chars_as_strings=True)
    except (*_DAMAGE, MatReadError) as error:
        raise ImportDataError(f"{path}: damaged MATLAB file ({type(error).__name__}); save it anew with -v7") from error
    return {str(k): plain(v) for k, v in found.items() if not str(k).startswith("__")}, left_out


_TRIAL = (
    "import io, sys; from scipy.io import loadmat; loadmat(io.BytesIO(sys.stdin.buffer.read()), chars_as_strings=True)"
)


def _survives(path: Path, sound: bytes) -> None:
    """Raise ImportDataError for a file at which scipy's compiled reader crashes: tried in a process of its own first."""
    try:
        done = subprocess.run(
            [sys.executable, "-I", "-c", _TRIAL], input=sound, capture_output=True, timeout=60, check=False
        )
    except subprocess.TimeoutExpired:
        raise ImportDataError(f"{path}: damaged MATLAB 5 file (no end after 60 s); save it anew") from None
    if done.returncode < 0:
        raise ImportDataError(f"{path}: damaged MATLAB 5 file, at which its reader crashes; save it anew")


def _sound(path: Path, data: bytes) -> tuple[bytes, int]:
    """The file unpacked, of its sound variables only."""
    if len(data) < HEADER or data[126:128] not in (b"IM", b"MI"):
        raise ImportDataError(
            f"{path}: not a MATLAB 5 or 7.3 file; save it with -v7 or -v7.3 (older ones, of MATLAB 4, are not read)"
        )
    order = "<" if data[126:128] == b"IM" else ">"
    scan = _Matlab5Scan(order, max(LEAST_UNPACKED, MOST_TIMES_PACKED * len(data)))
    out, at, left_out = [data[:116], bytes(8), data[124:HEADER]], HEADER, 0
    while at + 8 <= len(data):
        kind, size = struct.unpack_from(order + "II", data, at)
        end = min(at + 8 + size, len(data))
        try:
            element = scan.inflated(data[at + 8 : end]) if kind == _COMPRESSED else data[at:end]
            kind, a, b, _ = scan.tag(element, 0, len(element))
            if kind != _MATRIX:
                raise _Unsound
            scan.matrix(element, a, b)
            out.append(element[:b] + bytes(-b % 8))
        except (_Unsound, struct.error):
            left_out += 1
        at += 8 + size
    return b"".join(out), left_out


def plain(value: Any) -> Any:
    """What scipy gives as dictionaries (structs), lists (cells, arrays of structs), texts and arrays of numbers."""
    if isinstance(value, np.ndarray) and value.dtype.names:
        records = [{n: plain(item[n]) for n in value.dtype.names} for item in value.ravel(order="F")]
        return records[0] if len(records) == 1 else records
    if isinstance(value, np.ndarray) and value.dtype == object:
        return [plain(v) for v in value.ravel(order="F")]
    if isinstance(value, np.ndarray) and value.dtype.kind == "U":
        return "".join(str(v) for v in value.ravel()[:1])
    if isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
        return value.astype(float)
    return None
