"""Recordings over the standard log messages, so that any MAVLink client can list and fetch them.

Files have ids from 1 on in order of name. LOG_ENTRY carries size and time, LOG_DATA 90 bytes each. A transfer uses the
bandwidth that other messages leave, until its end, another request, or LOG_REQUEST_END.
Files are listed and read by a worker thread: a slow card delays the download, never the scans. Only one listing or reading
is in progress at a time, however many requests come; a repeated request is answered from the last listing.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path

from daq.clock import NS
from daq.telemetry.log_files import MAX_FILES, LogFileEntry, LogFiles
from daq.telemetry.send_queue import Item, item
from daq.telemetry.worker import Worker

DATA_BYTES = 90
_READ_AHEAD = 64 * DATA_BYTES
LISTING_VALID_NS = 2 * NS  # in which a listing is sent again without reading the card
_CLOSE_TIMEOUT_S = 2.0  # for a card that is being read when the link is closed
_UINT32 = 2**32 - 1


class LogServer:
    """Serves the `.mcap` files below some directories. `LOG_ERASE` is ignored: the ground may not delete recordings.

    All methods belong to one thread; `close` ends the worker.
    """

    def __init__(self, directories: Sequence[Path], now_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._now_ns = now_ns
        self._closing = False
        self._files = LogFiles(directories, lambda: self._closing)
        self._worker = Worker("log-server")
        self._last_listing: tuple[int, tuple[LogFileEntry, ...]] | None = None  # when, and what
        self._listing: Future[tuple[LogFileEntry, ...]] | None = None
        self._requested_ids: tuple[int, int] | None = None  # first and last id of the request
        self._entries_to_send: Iterator[Item] | None = None
        self._transfer: _Transfer | None = None

    def request_list(self, first: int, last: int) -> None:
        """Have a LOG_ENTRY sent for each file whose id is in the range."""
        self._entries_to_send = None
        self._requested_ids = (first, last)

    def request_data(self, number: int, offset: int, count: int) -> None:
        """Begin to send `count` bytes of a file from `offset` on."""
        self._transfer = _Transfer(number, offset, min(offset + count, _UINT32 + 1))

    def request_end(self) -> None:
        self._transfer = self._requested_ids = self._entries_to_send = None

    @property
    def busy(self) -> bool:
        return self._transfer is not None or self._requested_ids is not None or self._entries_to_send is not None

    def next_item(self) -> Item | None:
        """The next message to send; None if there is none, or while the card is being read."""
        if self._requested_ids is not None:
            self._begin_listing(*self._requested_ids)
        if self._entries_to_send is not None:
            entry = next(self._entries_to_send, None)
            if entry is not None:
                return entry
            self._entries_to_send = None
        return self._next_data()

    def _begin_listing(self, first: int, last: int) -> None:
        if self._listing is not None and self._listing.done():
            self._last_listing = (self._now_ns(), self._listing.result())
            self._listing = None
        if self._last_listing is not None and self._now_ns() - self._last_listing[0] < LISTING_VALID_NS:
            self._entries_to_send = _log_entries(self._last_listing[1], first, last)
            self._requested_ids = None
        elif self._listing is None:
            self._listing = self._worker.submit(self._files.listing)

    def _next_data(self) -> Item | None:
        t = self._transfer
        if t is None:
            return None
        if not t.buffer:
            if t.block is None:
                t.block = self._worker.submit(self._files.read, t.number, t.offset, min(_READ_AHEAD, t.end - t.offset))
            if t.block is None or not t.block.done():
                return None
            t.buffer, t.block = t.block.result(), None
        data, t.buffer = t.buffer[:DATA_BYTES], t.buffer[DATA_BYTES:]
        offset = t.offset
        t.offset += len(data)
        # Less than a full message is the end of the log, as it is for the client.
        if len(data) < DATA_BYTES or t.offset >= t.end:
            self._transfer = None
        return item("LOG_DATA", id=t.number, ofs=offset, count=len(data), data=data)

    def close(self) -> None:
        self.request_end()
        self._closing = True
        self._worker.close(_CLOSE_TIMEOUT_S)


@dataclass
class _Transfer:
    """A download of bytes [offset, end) of file `number`. buffer: bytes read and not sent; block: those being read."""

    number: int
    offset: int
    end: int
    buffer: bytes = b""
    block: "Future[bytes] | None" = None


def _log_entries(entries: Sequence[LogFileEntry], first: int, last: int) -> Iterator[Item]:
    """The messages for the ids from `first` to `last`, made one by one."""
    if not entries:
        yield item("LOG_ENTRY")
    for entry in entries:
        if first <= entry.number <= last:
            yield item(
                "LOG_ENTRY",
                id=entry.number,
                num_logs=min(len(entries), MAX_FILES),
                last_log_num=entries[-1].number,
                time_utc=min(max(entry.time_s, 0), _UINT32),
                size=min(entry.size, _UINT32),
            )
