"""List and fetch recordings from the aircraft by the standard log messages."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from daq.utilities.durable import open_log
from groundstation.receiver.timeline import NS

DATA_BYTES = 90
RETRY_NS = 2 * NS
_WINDOW = 64 * DATA_BYTES
_EVERY = 2**32 - 1


@dataclass(frozen=True, slots=True)
class LogEntry:
    number: int
    size: int
    time_utc: int


class LogFetcher:
    """Asks one aircraft. A download goes on where its file ends, so an interrupted one is simply begun again."""

    def __init__(self, system: int) -> None:
        self.system = system
        self.entries: dict[int, LogEntry] = {}
        self.done: set[int] = set()
        self.listing = False  # a list has been asked for and has not come
        self._asked_ns: int | None = None
        self._file: IO[bytes] | None = None
        self._number = 0
        self._size = 0
        self._at = 0
        self._ahead: dict[int, bytes] = {}

    def request_list(self) -> None:
        """Ask for all entries; they appear in `entries`."""
        self.entries.clear()
        self.listing = True
        self._asked_ns = None

    def download(self, number: int, path: Path) -> None:
        """Fetch a recording of `entries` into a file; KeyError for an unknown one."""
        entry = self.entries[number]
        self.done.discard(number)
        self.close()
        self._file = open_log(path)
        self._number, self._size, self._at = number, entry.size, self._file.tell()
        self._asked_ns = None
        self._check_end()

    def due(self, now_ns: int) -> list[tuple[str, dict[str, Any]]]:
        """Messages to send now."""
        if self._asked_ns is not None and now_ns - self._asked_ns < RETRY_NS:
            return []
        if self._file is not None:
            self._asked_ns = now_ns
            self._ahead.clear()
            return [("LOG_REQUEST_DATA", {"id": self._number, "ofs": self._at, "count": _EVERY - self._at})]
        if self.listing:
            self._asked_ns = now_ns
            return [("LOG_REQUEST_LIST", {"start": 0, "end": 65535})]
        return []

    def take_answer(self, name: str, f: Mapping[str, Any], now_ns: int) -> None:
        if name == "LOG_ENTRY":
            if f["num_logs"] and f["id"]:
                self.entries[f["id"]] = LogEntry(f["id"], f["size"], f["time_utc"])
            if len(self.entries) >= f["num_logs"]:
                self.listing = False
            return
        if self._file is None or f["id"] != self._number or f["count"] > DATA_BYTES:
            return
        self._asked_ns = now_ns
        offset, data = f["ofs"], bytes(f["data"][: f["count"]])
        if self._at < offset <= self._at + _WINDOW:
            self._ahead[offset] = data
            if offset == self._at + _WINDOW:
                self._asked_ns = None  # a gap that will not close by itself: ask again from there
        elif offset == self._at:
            self._append(data)
            while self._at in self._ahead:
                self._append(self._ahead.pop(self._at))
            self._check_end()

    def _append(self, data: bytes) -> None:
        assert self._file is not None
        self._file.write(data)
        self._at += len(data)

    def _check_end(self) -> None:
        if self._file is not None and self._at >= self._size:
            self.done.add(self._number)
            self.close()

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None
        self._ahead.clear()
