"""Lists and fetches recordings from an aircraft by MAVLink's standard log messages."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from daq.utilities.durable import open_log
from groundstation.receiver.timeline import NS

DATA_BYTES = 90  # of one LOG_DATA
RETRY_NS = 2 * NS  # time without an answer, after which a request is repeated
_WINDOW = 64 * DATA_BYTES  # beyond a gap, that is stored before the gap is requested again
_WHOLE_LOG = 2**32 - 1  # as a number of bytes


@dataclass(frozen=True, slots=True)
class LogEntry:
    """A recording of the aircraft. size: [bytes]; time_utc: [s since 1970]."""

    number: int
    size: int
    time_utc: int


class LogFetcher:
    """Lists and downloads recordings of one aircraft. A download continues at the end of its file: start an interrupted one
    again. entries: by number; done: numbers downloaded; listing: whether a requested list is incomplete."""

    def __init__(self, system: int) -> None:
        self.system = system
        self.entries: dict[int, LogEntry] = {}
        self.done: set[int] = set()
        self.listing = False
        self._requested_ns: int | None = None
        self._file: IO[bytes] | None = None
        self._number = 0
        self._size = 0
        self._position = 0  # bytes in the file
        self._ahead: dict[int, bytes] = {}  # data beyond a gap, by offset

    def request_list(self) -> None:
        """Request the list of recordings, which will appear in `entries`."""
        self.entries.clear()
        self.listing = True
        self._requested_ns = None

    def download(self, number: int, path: Path) -> None:
        """Download a recording of `entries` into a file. Raises KeyError for an unknown one."""
        entry = self.entries[number]
        self.done.discard(number)
        self.close()
        self._file = open_log(path)
        self._number, self._size, self._position = number, entry.size, self._file.tell()
        self._requested_ns = None
        self._check_end()

    def due(self, now_ns: int) -> list[tuple[str, dict[str, Any]]]:
        """Messages to send now: name, and fields without the target."""
        if self._requested_ns is not None and now_ns - self._requested_ns < RETRY_NS:
            return []
        if self._file is not None:
            self._requested_ns = now_ns
            self._ahead.clear()
            count = _WHOLE_LOG - self._position
            return [("LOG_REQUEST_DATA", {"id": self._number, "ofs": self._position, "count": count})]
        if self.listing:
            self._requested_ns = now_ns
            return [("LOG_REQUEST_LIST", {"start": 0, "end": 65535})]
        return []

    def take_answer(self, name: str, f: Mapping[str, Any], now_ns: int) -> None:
        """Use a LOG_ENTRY or LOG_DATA. Raises OSError where the file cannot be written."""
        if name == "LOG_ENTRY":
            if f["num_logs"] and f["id"]:
                self.entries[f["id"]] = LogEntry(f["id"], f["size"], f["time_utc"])
            if len(self.entries) >= f["num_logs"]:
                self.listing = False
            return
        if self._file is None or f["id"] != self._number or f["count"] > DATA_BYTES:
            return
        self._requested_ns = now_ns
        offset, data = f["ofs"], bytes(f["data"][: f["count"]])
        if self._position < offset <= self._position + _WINDOW:
            self._ahead[offset] = data
            if offset == self._position + _WINDOW:
                self._requested_ns = None  # the gap was lost: request again from there
        elif offset == self._position:
            self._append(data)
            while self._position in self._ahead:
                self._append(self._ahead.pop(self._position))
            self._check_end()

    def _append(self, data: bytes) -> None:
        assert self._file is not None
        self._file.write(data)
        self._position += len(data)

    def _check_end(self) -> None:
        if self._file is not None and self._position >= self._size:
            self.done.add(self._number)
            self.close()

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None
        self._ahead.clear()
