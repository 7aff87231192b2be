"""A log that cannot fill a disk: at a limit of length a new file is begun, and the oldest is removed."""

import contextlib
from pathlib import Path
from types import TracebackType
from typing import Self

from daq.utilities.durable import open_log

LARGEST = 8 << 20
"""Bytes of one file: some 80,000 lines, more than a day of an aircraft with many messages."""
FILES = 4
"""Most files of a log: the present one and NAME.1 to NAME.3, the oldest."""


class RotatingLog:
    """Appends lines and never raises an error of the disk. trouble: the last error in words, "" after a success."""

    def __init__(self, path: Path, largest: int = LARGEST, files: int = FILES) -> None:
        self.path, self.trouble = path, ""
        self._largest, self._files = largest, files
        self._file = open_log(path, buffering=0)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def write(self, data: bytes) -> None:
        """Append a line; it is lost when the disk fails, and `trouble` set."""
        try:
            if self._file.tell() + len(data) > self._largest:
                self._rotate()
            self._file.write(data)
            self.trouble = ""
        except OSError as error:
            self.trouble = error.strerror or str(error)

    def _rotate(self) -> None:
        old = [self.path.with_name(f"{self.path.name}.{n}") for n in range(1, self._files)]
        for older, newer in zip(reversed(old), [*reversed(old[:-1]), self.path], strict=True):
            with contextlib.suppress(FileNotFoundError):
                newer.replace(older)
        new = open_log(self.path, buffering=0)
        self._file.close()
        self._file = new

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._file.close()
