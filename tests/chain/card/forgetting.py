"""A card that forgets: what a file system keeps of what was written but not synced when the power goes.

Written data, sizes and names stay in memory until `sync_file` or `sync_directory` moves them to the medium. `survivors`
gives the medium as it is found after a cut at this instant. The rules are those of POSIX and no kinder: syncing a file
secures its data and size, not its name; a name is secured by syncing the directory it is in. Real file systems keep more
(ext4 commits a new file's name with its data), and none keeps less while the card honours a flush.
"""

import errno
import os
import random
import stat
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import PurePosixPath

PAGE = 4096
SECTOR = 512
ROOT = 1


class Metadata(StrEnum):
    """What became of sizes and names that were not synced."""

    LOST = "lost"
    KEPT = "kept"
    SOME = "some"  # each by chance, in whatever order


class Pages(StrEnum):
    """What became of pages that were not synced."""

    LOST = "lost"
    KEPT = "kept"
    SOME = "some"  # a random subset: written back out of order


@dataclass(frozen=True, slots=True)
class Cut:
    """One way to lose power. torn: of the page written last only some sectors of 512 bytes have made it."""

    name: str
    pages: Pages
    metadata: Metadata
    torn: bool = False


CUTS: tuple[Cut, ...] = (
    Cut("nothing unsynced", Pages.LOST, Metadata.LOST),
    Cut("sizes and names without data", Pages.LOST, Metadata.KEPT),
    Cut("names by chance, no data", Pages.LOST, Metadata.SOME),
    Cut("pages by chance", Pages.SOME, Metadata.KEPT),
    Cut("pages by chance, old sizes and names", Pages.SOME, Metadata.LOST),
    Cut("pages, sizes and names by chance", Pages.SOME, Metadata.SOME),
    Cut("last page torn", Pages.KEPT, Metadata.KEPT, torn=True),
    Cut("pages by chance, last one torn", Pages.SOME, Metadata.SOME, torn=True),
)
"""The ways a power cut is tried. The first is what a promise may rest on; all others only add to it."""


@dataclass
class Inode:
    """A file or directory: what programs see, and what is on the medium."""

    number: int
    mode: int
    data: bytearray = field(default_factory=bytearray)
    medium: bytearray = field(default_factory=bytearray)
    dirty: dict[int, int] = field(default_factory=dict)  # page -> when it was last written
    shortest: int | None = None  # smallest size since the last sync, where it was cut shorter than on the medium
    entries: dict[str, int] = field(default_factory=dict)
    medium_entries: dict[str, int] = field(default_factory=dict)

    @property
    def is_directory(self) -> bool:
        """Whether it holds names instead of data."""
        return stat.S_ISDIR(self.mode)


@dataclass(frozen=True, slots=True)
class _Change:
    """A change of names, whole or not at all: (directory, name, inode or None for no such name)."""

    names: tuple[tuple[int, str, int | None], ...]


@dataclass
class Traffic:
    """What has gone to the medium so far."""

    written: int = 0  # bytes programs wrote
    pages: int = 0  # pages of data that syncs moved
    syncs: int = 0
    directory_syncs: int = 0


class ForgettingFiles:
    """The file system. Paths are absolute; errors are OSError. room: bytes of data it takes, None without limit."""

    def __init__(self, room: int | None = None) -> None:
        self.room = room
        self.traffic = Traffic()
        self._inodes = {ROOT: Inode(ROOT, stat.S_IFDIR | 0o777)}
        self._changes: list[_Change] = []
        self._next = ROOT + 1
        self._written = 0  # counts pages, to know which was the last

    # ------------------------------------------------------------------------------------------ names

    def find(self, path: str) -> Inode:
        """The file or directory of a path; ENOENT or ENOTDIR."""
        inode = self._inodes[ROOT]
        for name in PurePosixPath(path).parts[1:]:
            if not inode.is_directory:
                raise _error(errno.ENOTDIR, path)
            if name not in inode.entries:
                raise _error(errno.ENOENT, path)
            inode = self._inodes[inode.entries[name]]
        return inode

    def child(self, number: int) -> Inode:
        """The file or directory that an entry points to."""
        return self._inodes[number]

    def make(self, path: str, mode: int) -> Inode:
        """A new file or directory (by its mode); EEXIST."""
        parent, name = self._place(path)
        if name in parent.entries:
            raise _error(errno.EEXIST, path)
        inode = self._inodes[self._next] = Inode(self._next, mode)
        self._next += 1
        self._change((parent.number, name, inode.number))
        return inode

    def remove(self, path: str) -> None:
        """Take a name away; ENOTEMPTY for a directory that holds something."""
        parent, name = self._place(path)
        inode = self.find(path)
        if inode.entries:
            raise _error(errno.ENOTEMPTY, path)
        self._change((parent.number, name, None))

    def rename(self, old: str, new: str) -> None:
        """Move a name, over another if there is one: after a cut either both or neither."""
        inode = self.find(old)
        source, target = self._place(old), self._place(new)
        self._change((source[0].number, source[1], None), (target[0].number, target[1], inode.number))

    def _place(self, path: str) -> tuple[Inode, str]:
        pure = PurePosixPath(path)
        parent = self.find(str(pure.parent))
        if not parent.is_directory:
            raise _error(errno.ENOTDIR, path)
        return parent, pure.name

    def _change(self, *names: tuple[int, str, int | None]) -> None:
        self._changes.append(_Change(names))
        _apply(names, {d: self._inodes[d].entries for d, _, _ in names})

    # ------------------------------------------------------------------------------------------ data

    def write(self, inode: Inode, data: bytes, offset: int) -> int:
        """Write into memory; ENOSPC, after the part that still fits, when there is no room."""
        fits = len(data) if self.room is None else max(0, self.room - self.used() + max(0, len(inode.data) - offset))
        if data and not fits:
            raise _error(errno.ENOSPC, str(inode.number))
        data = data[:fits]
        if len(inode.data) < offset:
            inode.data.extend(bytes(offset - len(inode.data)))
        inode.data[offset : offset + len(data)] = data
        for page in range(offset // PAGE, (offset + len(data) - 1) // PAGE + 1):
            self._written += 1
            inode.dirty[page] = self._written
        self.traffic.written += len(data)
        return len(data)

    def truncate(self, inode: Inode, size: int) -> None:
        """Cut a file off, or lengthen it with zeros."""
        if size < len(inode.data):
            del inode.data[size:]
            inode.shortest = min(size, len(inode.medium) if inode.shortest is None else inode.shortest)
            inode.dirty = {p: n for p, n in inode.dirty.items() if p * PAGE < size}
        else:
            inode.data.extend(bytes(size - len(inode.data)))

    def used(self) -> int:
        """Bytes of data in all files that have a name."""
        return sum(len(i.data) for i in self._named(ROOT))

    def _named(self, number: int) -> Iterator[Inode]:
        for child in self._inodes[number].entries.values():
            yield self._inodes[child]
            yield from self._named(child)

    # ------------------------------------------------------------------------------------------ to the medium

    def sync_file(self, inode: Inode) -> int:
        """Data and size go to the medium; how many bytes that were, in whole pages."""
        pages = [p for p in inode.dirty if p * PAGE < len(inode.data)]
        inode.medium = _resized(inode.medium, inode.shortest, len(inode.data))
        for page in pages:
            inode.medium[page * PAGE : (page + 1) * PAGE] = inode.data[page * PAGE : (page + 1) * PAGE]
        inode.dirty.clear()
        inode.shortest = None
        self.traffic.syncs += 1
        self.traffic.pages += len(pages)
        return len(pages) * PAGE

    def sync_directory(self, inode: Inode) -> None:
        """The names in a directory go to the medium."""
        here = [c for c in self._changes if any(d == inode.number for d, _, _ in c.names)]
        self._changes = [c for c in self._changes if c not in here]
        for change in here:
            _apply(change.names, {d: self._inodes[d].medium_entries for d, _, _ in change.names})
        self.traffic.directory_syncs += 1

    def sync_all(self) -> None:
        """All data and all names go to the medium."""
        for inode in self._inodes.values():
            (self.sync_directory if inode.is_directory else self.sync_file)(inode)

    def sync_fails(self, inode: Inode) -> None:
        """The card refuses: the system forgets that the pages were not written, as Linux does, and they never will be."""
        inode.dirty.clear()

    # ------------------------------------------------------------------------------------------ the cut

    def survivors(self, cut: Cut, seed: int) -> "ForgettingFiles":
        """What is found on the medium after a cut now; this file system goes on as if nothing had happened."""
        rng = random.Random(f"{cut.name} {seed}")
        kept = [c for c in self._changes if _chosen(cut.metadata, rng)]
        entries = {n: dict(i.medium_entries) for n, i in self._inodes.items()}
        for change in kept:
            _apply(change.names, entries)
        last = max((n for i in self._inodes.values() for n in i.dirty.values()), default=0)
        after = ForgettingFiles(self.room)
        after._next = self._next
        reachable = [ROOT]
        for number in reachable:  # grows while it is gone through
            inode = self._inodes[number]
            data = b"" if inode.is_directory else _content(inode, cut, last, rng)
            after._inodes[number] = Inode(
                number,
                inode.mode,
                bytearray(data),
                bytearray(data),
                entries=entries[number],
                medium_entries=dict(entries[number]),
            )
            reachable += [n for n in entries[number].values() if n not in reachable]
        return after

    def files(self) -> Mapping[str, bytes]:
        """Content of all files by path, for a look from outside; directories end in a slash."""
        return dict(self._walk(ROOT, ""))

    def _walk(self, number: int, at: str) -> Iterator[tuple[str, bytes]]:
        for name, child in self._inodes[number].entries.items():
            inode = self._inodes[child]
            if inode.is_directory:
                yield f"{at}/{name}/", b""
                yield from self._walk(child, f"{at}/{name}")
            else:
                yield f"{at}/{name}", bytes(inode.data)


def _apply(names: tuple[tuple[int, str, int | None], ...], entries: Mapping[int, dict[str, int]]) -> None:
    for directory, name, inode in names:
        if inode is None:
            entries[directory].pop(name, None)
        else:
            entries[directory][name] = inode


def _chosen(metadata: Metadata, rng: random.Random) -> bool:
    return metadata is Metadata.KEPT or (metadata is Metadata.SOME and rng.random() < 0.5)


def _resized(medium: bytearray, shortest: int | None, size: int) -> bytearray:
    """The medium's content under a new size: what was cut off meanwhile is zeros, not the old bytes."""
    base = medium[: len(medium) if shortest is None else shortest][:size]
    return base + bytes(size - len(base))


def _content(inode: Inode, cut: Cut, last: int, rng: random.Random) -> bytes:
    new_size = _chosen(cut.metadata, rng)
    if not new_size and inode.shortest is not None:
        return bytes(inode.medium)  # cut shorter and written anew, and nobody will know
    found = _resized(inode.medium, inode.shortest, len(inode.data)) if new_size else bytearray(inode.medium)
    for page, written in inode.dirty.items():
        at = page * PAGE
        end = min(at + PAGE, len(inode.data), len(found))
        if cut.torn and written == last:
            end = min(end, at + SECTOR * rng.randrange(PAGE // SECTOR))
        elif cut.pages is Pages.LOST or (cut.pages is Pages.SOME and rng.random() < 0.5):
            continue
        if end > at:
            found[at:end] = inode.data[at:end]
    return bytes(found)


def _error(number: int, what: str) -> OSError:
    return OSError(number, os.strerror(number), what)
