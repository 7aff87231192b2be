"""An append-only file that survives failures of its disk: records wait in memory until they can be written.

A disk may be full, read-only, or removed and replaced. A partly written record is completed when there is room; in a new file it
is written again from its start.
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
"""Bytes that may wait for a disk: half a day of telemetry at 1.5 kB/s. Further records are refused and counted."""
_COPY_BYTES = 1 << 20  # copied to a new file at once


class LastingLog:
    """Use: `append` records, call `flush`. An OSError of `flush` loses nothing. refused: bytes for which there was no room,
    neither on the disk nor in memory."""

    def __init__(self, path: Path, most_waiting: int = MOST_WAITING) -> None:
        self.path = path
        self.refused = 0
        self._most = most_waiting
        self._waiting: deque[bytes] = deque()
        self._size = 0
        self._written = 0  # bytes of the first waiting record that are in the file already
        self._file: IO[bytes] = open_log(path, buffering=0)

    @property
    def bytes_waiting(self) -> int:
        """Bytes that are in memory only."""
        return self._size

    @property
    def records_waiting(self) -> tuple[bytes, ...]:
        """The records that are not completely in the file."""
        return tuple(self._waiting)

    def append(self, record: bytes) -> bool:
        """Add a record, which the next successful `flush` writes; False where it is refused."""
        if self._size + len(record) > self._most:
            self.refused += len(record)
            return False
        self._waiting.append(record)
        self._size += len(record)
        return True

    def flush(self) -> None:
        """Write all waiting records. Raises OSError."""
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
        """Check that the open file is still the one at its path; else create it again, with the old content if that can be read.
        Returns whether it was the same file. Raises OSError while the folder is missing."""
        try:
            at_path, opened = self.path.stat(), os.fstat(self._file.fileno())
            if (at_path.st_dev, at_path.st_ino) == (opened.st_dev, opened.st_ino):
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
        """Copy the old file up to its last complete record to `new`; nothing where the old disk is gone."""
        try:
            size = os.fstat(self._file.fileno()).st_size - self._written
            for offset in range(0, size, _COPY_BYTES):
                new.write(os.pread(self._file.fileno(), min(_COPY_BYTES, size - offset), offset))
        except OSError:
            return

    def take_waiting(self) -> list[bytes]:
        """Remove and return the waiting records; the caller appends them again after earlier ones."""
        records = list(self._waiting)
        self._waiting.clear()
        self._size = self._written = 0
        return records

    def truncate(self, size: int) -> None:
        """Shorten the file to `size` bytes. Raises OSError."""
        self._file.truncate(size)

    def descriptor(self) -> int:
        """File descriptor, for `Disk.sync`."""
        return self._file.fileno()

    def close(self) -> None:
        """Write the waiting records, sync and close; the file is closed even where that raises OSError."""
        try:
            self.flush()
            os.fsync(self._file.fileno())
        finally:
            self._file.close()


class Disk:
    """Syncs files in a worker thread, one round at a time. Its methods must be called from one thread."""

    def __init__(self) -> None:
        self._worker: ThreadPoolExecutor | None = None
        self._round: Future[None] | None = None
        self._named: set[Path] = set()  # files whose folder was synced, and with it their names

    def sync(self, files: Iterable[LastingLog]) -> None:
        """Start to sync these files; does nothing while the last round runs. Raises the OSError of the last round."""
        if self.busy:
            return
        # duplicated, since the files may be closed before the round ends
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
        """Whether a round is running."""
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
        """Wait for the running round and end the worker."""
        if self._worker is not None:
            self._worker.shutdown(wait=True)
            self._worker = None
