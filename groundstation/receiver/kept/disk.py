"""Brings what was received to the disk once a second, in a thread of its own: reception never waits for a disk.

A process that is killed loses nothing that it has written; a computer whose power fails loses up to half a minute of it,
the time after which an operating system writes by itself.
"""

import os
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Protocol

from daq.contract.durable import sync_directory


class OpenFile(Protocol):
    """A file being written to, everything handed to the operating system."""

    path: Path

    def descriptor(self) -> int:
        """Its open file."""
        ...


class Disk:
    """Syncs files, one round at a time. All methods belong to one thread."""

    def __init__(self) -> None:
        self._worker: ThreadPoolExecutor | None = None
        self._round: Future[None] | None = None
        self._named: set[Path] = set()  # whose names are on the disk

    def sync(self, files: Iterable[OpenFile]) -> None:
        """Begin to sync these files; nothing while the last round still waits for the disk. OSError when that one failed."""
        if self.busy:
            return
        # Descriptors of its own: the files may be closed meanwhile.
        held = [(os.dup(f.descriptor()), f.path) for f in files]
        if not held:
            return
        last, self._round = self._round, self._submit(held)
        if last is not None:
            last.result()

    @property
    def busy(self) -> bool:
        """Whether a round is under way."""
        return self._round is not None and not self._round.done()

    def _submit(self, held: list[tuple[int, Path]]) -> "Future[None]":
        if self._worker is None:
            self._worker = ThreadPoolExecutor(1, thread_name_prefix="disk")
        return self._worker.submit(self._sync, held)

    def _sync(self, held: list[tuple[int, Path]]) -> None:
        try:
            for descriptor, path in held:
                os.fsync(descriptor)
                if path not in self._named:
                    sync_directory(path.parent)
                    self._named.add(path)
        finally:
            for descriptor, _ in held:
                os.close(descriptor)

    def close(self) -> None:
        """Wait for the round under way and end the worker."""
        if self._worker is not None:
            self._worker.shutdown(wait=True)
            self._worker = None
