"""A log of lines that cannot fill a disk: a new file is begun where one is long enough, and the oldest go."""

import contextlib
from pathlib import Path
from types import TracebackType
from typing import Self

from daq.utilities.durable import open_log

LARGEST = 8 << 20
"""Bytes of one file: some 80,000 lines, more than a day of a talkative aircraft."""
FILES = 4
"""That are there at most: the present one, and NAME.1 to NAME.3, the oldest last."""


class RotatingLog:
    """Append lines. It never raises: `trouble` is what the disk said last, "" while it takes them."""

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
        """Append; what the disk does not take is lost, for it is words."""
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
