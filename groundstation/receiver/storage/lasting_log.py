"""A file that grows at its end and outlasts its disk: what cannot be written waits in memory and goes when it can.

A disk may be full, read-only, or gone and back, perhaps as another one. A record that went half onto a full disk is finished
when there is room, and begun again where the file is a new one.
"""

import errno
import os
from collections import deque
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import IO

from daq.utilities.durable import open_log, sync_directory

MOST_WAITING = 64 << 20
"""Bytes that wait for a disk: half a day of telemetry at 1.5 kB/s. What comes beyond is refused, and counted."""


class LastingLog:
    """Append records, call `flush`; OSError says what is the matter, and loses nothing."""

    def __init__(self, path: Path, most_waiting: int = MOST_WAITING) -> None:
        self.path = path
        self.refused = 0  # bytes for which there was no room, neither on the disk nor in memory
        self._most = most_waiting
        self._waiting: deque[bytes] = deque()
        self._size = 0
        self._written = 0  # bytes of the first that waits which are in the file already
        self._file: IO[bytes] = open_log(path, buffering=0)

    @property
    def waiting(self) -> int:
        """Bytes that are in memory only."""
        return self._size

    @property
    def records_waiting(self) -> tuple[bytes, ...]:
        """The records that are in memory only, or not whole in the file."""
        return tuple(self._waiting)

    def append(self, record: bytes) -> bool:
        """Take a record; False when it is refused. It is in the file after the next `flush` that succeeds."""
        if self._size + len(record) > self._most:
            self.refused += len(record)
            return False
        self._waiting.append(record)
        self._size += len(record)
        return True

    def flush(self) -> None:
        """Write everything that waits. Raises OSError."""
        while self._waiting:
            record = self._waiting[0]
            count = self._file.write(memoryview(record)[self._written :])
            if not count:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            self._written += count
            if self._written == len(record):
                self._waiting.popleft()
                self._size -= len(record)
                self._written = 0

    def look_after(self) -> bool:
        """Whether the file is still the one under its name; else it is opened anew, with what it held where that can be
        read. Raises OSError while its place is gone."""
        try:
            current, ours = self.path.stat(), os.fstat(self._file.fileno())
            if (current.st_dev, current.st_ino) == (ours.st_dev, ours.st_ino):
                return True
        except FileNotFoundError:
            pass
        new = open_log(self.path, buffering=0)
        try:
            if os.fstat(new.fileno()).st_size == 0:
                self._carry_over(new)
        finally:
            old, self._file = self._file, new
            self._written = 0
            old.close()
        return False

    def _carry_over(self, new: IO[bytes]) -> None:
        """What the old file held up to its last whole record; an old disk that is gone has nothing to give."""
        try:
            size = os.fstat(self._file.fileno()).st_size - self._written
            for offset in range(0, size, 1 << 20):
                new.write(os.pread(self._file.fileno(), min(1 << 20, size - offset), offset))
        except OSError:
            return

    def take_waiting(self) -> list[bytes]:
        """The records that wait, which the caller appends again after what comes before them."""
        records = list(self._waiting)
        self._waiting.clear()
        self._size = self._written = 0
        return records

    def truncate(self, size: int) -> None:
        self._file.truncate(size)

    def descriptor(self) -> int:
        """The open file, for whoever syncs it."""
        return self._file.fileno()

    def close(self) -> None:
        """Write what waits and bring it to the medium; the file is closed in any case."""
        try:
            self.flush()
            os.fsync(self._file.fileno())
        finally:
            self._file.close()


class Disk:
    """Syncs files, one round at a time. All methods belong to one thread."""

    def __init__(self) -> None:
        self._worker: ThreadPoolExecutor | None = None
        self._round: Future[None] | None = None
        self._named: set[Path] = set()  # whose names are on the disk

    def sync(self, files: Iterable[LastingLog]) -> None:
        """Begin to sync these files; nothing while the last round still waits for the disk. OSError when that one failed."""
        if self.busy:
            return
        # Descriptors of its own: the files may be closed meanwhile.
        descriptors = [(os.dup(f.descriptor()), f.path) for f in files]
        if not descriptors:
            return
        if self._worker is None:
            self._worker = ThreadPoolExecutor(1, thread_name_prefix="disk")
        last, self._round = self._round, self._worker.submit(self._sync, descriptors)
        if last is not None:
            last.result()

    @property
    def busy(self) -> bool:
        return self._round is not None and not self._round.done()

    def _sync(self, descriptors: list[tuple[int, Path]]) -> None:
        try:
            for descriptor, path in descriptors:
                os.fsync(descriptor)
                if path not in self._named:
                    sync_directory(path.parent)
                    self._named.add(path)
        finally:
            for descriptor, _ in descriptors:
                os.close(descriptor)

    def close(self) -> None:
        """Wait for the round under way and end the worker."""
        if self._worker is not None:
            self._worker.shutdown(wait=True)
            self._worker = None
