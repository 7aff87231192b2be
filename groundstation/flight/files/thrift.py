"""Structs of Thrift's compact protocol as plain dictionaries, whatever the bytes say.

The footer and the page headers of a Parquet file are such structs. Arrow's own accessors of the footer end the process
where a column's statistics do not fit each other, so what is looked at before Arrow reads a file is read here.

Source: thrift/doc/specs/thrift-compact-protocol.md, "Struct encoding" and "List and set".
"""

import struct
from typing import Any

_DEEPEST = 12  # nested values; the deepest of parquet.thrift's own (statistics of a column of a row group) is 6


class ThriftReader:
    """Reads values one after the other. end: where the next one begins. most: values that are read, those of lists and
    structs included.

    Raises ValueError where the bytes are no such value or more of them: never anything else.
    """

    def __init__(self, data: bytes, at: int = 0, most: int = 1000) -> None:
        self._data = data
        self._left = most
        self.end = at

    def struct(self, depth: int = _DEEPEST) -> dict[int, Any]:
        """Value of each field by its number; the last one counts where a number stands twice."""
        fields: dict[int, Any] = {}
        number = 0
        while (head := self._byte()) != 0:
            number = number + (head >> 4) if head >> 4 else self._signed()
            fields[number] = self._value(head & 15, depth) if head & 15 not in (1, 2) else self._counted(head & 15 == 1)
        return fields

    def _value(self, kind: int, depth: int) -> Any:
        """3 byte, 4 to 6 integers, 7 double, 8 bytes, 9, 10 lists, 12 struct; 1, 2 booleans of a list stand in a byte."""
        self._counted()
        if depth <= 0:
            raise ValueError("a header nested too deep")
        if kind in (1, 2, 3):
            return self._byte()
        if kind in (4, 5, 6):
            return self._signed()
        if kind == 7:
            return struct.unpack("<d", self._take(8))[0]
        if kind == 8:
            return self._take(self._varint())
        if kind in (9, 10):
            return self._list(depth)
        if kind == 12:
            return self.struct(depth - 1)
        raise ValueError("a header that is none")

    def _counted(self, value: bool = True) -> bool:
        self._left -= 1
        if self._left < 0:
            raise ValueError("a header of too many values")
        return value

    def _list(self, depth: int) -> list[Any]:
        head = self._byte()
        length = head >> 4 if head >> 4 < 15 else self._varint()
        return [self._value(head & 15, depth - 1) for _ in range(length)]

    def _byte(self) -> int:
        return self._take(1)[0]

    def _take(self, length: int) -> bytes:
        if length > len(self._data) - self.end:
            raise ValueError("a header runs out of the file")
        self.end += length
        return self._data[self.end - length : self.end]

    def _varint(self) -> int:
        value = 0
        for shift in range(0, 70, 7):
            byte = self._byte()
            value |= (byte & 127) << shift
            if byte < 128:
                return value
        raise ValueError("a header holds a number without end")

    def _signed(self) -> int:
        value = self._varint()
        return value >> 1 ^ -(value & 1)
