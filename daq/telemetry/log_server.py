"""Recordings over the standard log messages, so that any MAVLink client can list and fetch them.

Files are offered in order of name under ids from 1 on. LOG_ENTRY carries size and time; LOG_DATA 90 bytes each. A
transfer goes on by itself, in what bandwidth is left, until its end, another request, or LOG_REQUEST_END.
Files are listed and read by a worker thread: a slow card delays the download, never the scans.
"""

import os
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from daq.telemetry.send_queue import Item, item

DATA_BYTES = 90
_READ_AHEAD = 64 * DATA_BYTES

T = TypeVar("T")


class LogServer:
    """Serves the `.mcap` files below some directories. `LOG_ERASE` is never obeyed: recordings are not the ground's.

    All methods but the worker's belong to one thread; `close` ends the worker.
    """

    def __init__(self, directories: Sequence[Path]) -> None:
        self._directories = tuple(directories)
        self._files: list[Path] = []
        self._entries: deque[Item] = deque()
        self._worker: ThreadPoolExecutor | None = None
        self._listing: Future[list[Item]] | None = None
        self._transfer: _Transfer | None = None
        self._block: Future[bytes] | None = None

    def request_list(self, first: int, last: int) -> None:
        """Have a LOG_ENTRY made for each file whose id is in the range."""
        self._entries.clear()
        self._listing = self._submit(self._list, first, last)

    def request_data(self, number: int, offset: int, count: int) -> None:
        """Begin to send `count` bytes of a file from `offset` on."""
        self._transfer = _Transfer(number, offset, offset + count)
        self._block = None

    def request_end(self) -> None:
        """Stop sending."""
        self._transfer = self._block = self._listing = None
        self._entries.clear()

    @property
    def busy(self) -> bool:
        """Whether a list or a download is under way."""
        return self._transfer is not None or self._listing is not None or bool(self._entries)

    def next_item(self) -> Item | None:
        """The next message to send; None while there is nothing, or while the card is being read."""
        if self._listing is not None and self._listing.done():
            self._entries.extend(self._listing.result())
            self._listing = None
        if self._entries:
            return self._entries.popleft()
        return self._next_data()

    def _next_data(self) -> Item | None:
        t = self._transfer
        if t is None:
            return None
        if not t.ahead:
            if self._block is None:
                self._block = self._submit(self._read, t.number, t.offset, min(_READ_AHEAD, t.end - t.offset))
            if not self._block.done():
                return None
            t.ahead, self._block = self._block.result(), None
        data, t.ahead = t.ahead[:DATA_BYTES], t.ahead[DATA_BYTES:]
        offset = t.offset
        t.offset += len(data)
        # Less than a full message is the end of the log, as it is for the client.
        if len(data) < DATA_BYTES or t.offset >= t.end:
            self._transfer = None
        return item("LOG_DATA", id=t.number, ofs=offset, count=len(data), data=data)

    def close(self) -> None:
        """End the worker."""
        self.request_end()
        if self._worker is not None:
            self._worker.shutdown(wait=True, cancel_futures=True)
            self._worker = None

    def _submit(self, work: Callable[..., T], *arguments: int) -> "Future[T]":
        if self._worker is None:
            self._worker = ThreadPoolExecutor(1, thread_name_prefix="log-server")
        return self._worker.submit(work, *arguments)

    # ------------------------------------------------------------------------------------ in the worker's thread

    def _list(self, first: int, last: int) -> list[Item]:
        self._refresh()
        stats = [(i, s) for i, p in enumerate(self._files, 1) if (s := _stat(p)) is not None]
        if not stats:
            return [item("LOG_ENTRY")]
        return [
            item(
                "LOG_ENTRY",
                id=number,
                num_logs=len(stats),
                last_log_num=len(self._files),
                time_utc=int(stat.st_mtime),
                size=min(stat.st_size, 2**32 - 1),
            )
            for number, stat in stats
            if first <= number <= last
        ]

    def _refresh(self) -> None:
        found = [p for d in self._directories if d.is_dir() for p in d.rglob("*.mcap")]
        known = set(self._files)
        # Ids stay what they were: new files are added behind the known ones.
        self._files += sorted((p for p in found if p not in known), key=lambda p: (p.name, str(p)))

    def _read(self, number: int, offset: int, size: int) -> bytes:
        if not self._files:
            self._refresh()
        if not 0 < number <= len(self._files) or size <= 0:
            return b""
        try:
            with self._files[number - 1].open("rb") as handle:
                handle.seek(offset)
                return handle.read(size)
        except OSError:
            return b""  # removed meanwhile: the client sees the end of the log


@dataclass
class _Transfer:
    number: int
    offset: int
    end: int
    ahead: bytes = b""


def _stat(path: Path) -> os.stat_result | None:
    try:
        return path.stat()
    except OSError:
        return None
