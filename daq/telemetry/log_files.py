"""The recordings that can be fetched: found, numbered, and read, by a thread that may wait for the card.

Only ordinary files below the configured directories are offered. A link is followed where it stays below them, and
nowhere else; neither a pipe nor a device that somebody names `.mcap` is opened.
"""

import os
import stat
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from heapq import merge
from itertools import islice
from pathlib import Path

MAX_FILES = 65_535
"""Ids are 16 bits wide and begin at 1. Of more files the last by name, which are the newest, are offered."""
_MAX_DEPTH = 8  # directories within directories; recordings are one deep
_MAX_LOOKED_AT = 4 * MAX_FILES  # directory entries of one listing
_RUN = 1024  # paths sorted in one go
_PAUSE_EVERY, _PAUSE_S = (
    64,
    0.002,
)  # entries: some milliseconds of Python, in which the scan loop would wait for its turn


@dataclass(frozen=True, slots=True)
class LogFileEntry:
    """A recording as LOG_ENTRY tells of it."""

    number: int
    size: int
    time_s: int  # of the last change, Unix time [s]


class LogFiles:
    """Belongs to the thread that reads the card. given_up: whether a listing should end early."""

    def __init__(self, directories: Sequence[Path], given_up: Callable[[], bool]) -> None:
        self._directories = tuple(directories)
        self._real: tuple[str, ...] = ()  # the directories without links
        self._given_up = given_up
        self._paths: list[str] = []  # the number of a file is its place, from 1 on, and stays what it was
        self._listed_paths: set[str] = set()

    def listing(self) -> tuple[LogFileEntry, ...]:
        """All recordings there are now."""
        self._refresh()
        entries: list[LogFileEntry] = []
        folders: dict[str, str] = {}
        for number, path in enumerate(self._paths, 1):
            self._make_way(number)
            if self._given_up():
                break
            status = self._status(path, folders)
            if status is not None:
                entries.append(LogFileEntry(number, status.st_size, int(status.st_mtime)))
        return tuple(entries)

    def read(self, number: int, offset: int, size: int) -> bytes:
        """Some bytes of a recording; empty at its end, or where there is none."""
        if not self._paths:
            self._refresh()
        if not 0 < number <= len(self._paths) or size <= 0:
            return b""
        try:
            path = self._resolved_within(self._paths[number - 1])
            return _read(path, offset, size) if path is not None else b""
        except OSError:
            return b""  # removed meanwhile: the client sees the end of the log

    def _refresh(self) -> None:
        new_paths = _in_order(p for p in self._paths_on_card() if p not in self._listed_paths)
        room = MAX_FILES - len(self._paths)
        new = new_paths[-room:] if room else []
        self._paths += new
        self._listed_paths.update(new)

    def _paths_on_card(self) -> Iterator[str]:
        self._real = tuple(os.path.realpath(d) for d in self._directories)
        looked_at = 0
        queue = [(str(d), 0) for d in self._directories]
        while queue and not self._given_up():
            directory, depth = queue.pop()
            for entry in _entries(directory):
                looked_at += 1
                self._make_way(looked_at)
                if looked_at > _MAX_LOOKED_AT or self._given_up():
                    return
                kind = _kind(entry)
                if kind == "directory" and depth < _MAX_DEPTH:
                    queue.append((entry.path, depth + 1))
                elif entry.name.endswith(".mcap") and (
                    kind == "file" or (kind == "link" and self._leads_within(entry))
                ):
                    yield entry.path

    def _leads_within(self, link: "os.DirEntry[str]") -> bool:
        try:
            return link.is_file() and self._resolved_within(link.path) is not None
        except OSError:
            return False

    def _resolved_within(self, path: str) -> str | None:
        """Where a path really leads; None where that is not below one of the directories. OSError where to nothing."""
        real = os.path.realpath(path, strict=True)
        return real if self._is_below(real) else None

    def _status(self, path: str, folders: dict[str, str]) -> os.stat_result | None:
        """Of the file a path leads to; None where it leads out, to nothing, or to no ordinary file.

        folders: where the directories met so far really are.
        """
        try:
            folder, name = os.path.split(path)
            if folder not in folders:
                folders[folder] = os.path.realpath(folder, strict=True)
            status = os.lstat(f"{folders[folder]}/{name}")
            if stat.S_ISLNK(status.st_mode) or not self._is_below(folders[folder]):
                real = self._resolved_within(path)
                if real is None:
                    return None
                status = os.lstat(real)
        except OSError:
            return None
        return status if stat.S_ISREG(status.st_mode) else None

    def _is_below(self, real: str) -> bool:
        return any(real == d or real.startswith(f"{d}{os.sep}") for d in self._real)

    @staticmethod
    def _make_way(count: int) -> None:
        if count % _PAUSE_EVERY == 0:
            time.sleep(_PAUSE_S)


def _entries(directory: str) -> "list[os.DirEntry[str]]":
    try:
        with os.scandir(directory) as entries:
            return list(islice(entries, _MAX_LOOKED_AT))
    except OSError:
        return []


def _in_order(paths: Iterable[str]) -> list[str]:
    """Paths by name. To sort all in one go would keep the interpreter from every other thread meanwhile."""
    rows = ((p.rpartition(os.sep)[2], p) for p in paths)
    runs = []
    while run := sorted(islice(rows, _RUN)):
        runs.append(run)
    return [path for _, path in merge(*runs)]


def _kind(entry: "os.DirEntry[str]") -> str:
    try:
        if entry.is_symlink():
            return "link"
        return "directory" if entry.is_dir() else "file" if entry.is_file() else "other"
    except OSError:
        return "other"


def _read(path: str, offset: int, size: int) -> bytes:
    """Bytes of a regular file; neither a link put in its place meanwhile is followed, nor a pipe waited for."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            return b""
        return os.pread(descriptor, size, offset)
    finally:
        os.close(descriptor)
