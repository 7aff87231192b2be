"""The file operations of the recorder behind one small interface.

Tests and the simulator replace it by a storage whose writes are slow, whose space ends, or whose mount is gone.
"""

import contextlib
import errno
import os
from pathlib import Path
from typing import Protocol

from daq.utilities.durable import make_directories, sync_directory


class StorageFile(Protocol):
    """An open file that is being written. All methods raise OSError on failure."""

    def write(self, data: bytes) -> int:
        """Write all of `data`."""

    def tell(self) -> int:
        """Bytes written so far."""

    def flush(self) -> None:
        """Return once everything written is with the operating system."""

    def sync(self) -> None:
        """Return once everything written is on the medium."""

    def close(self) -> None:
        """Release the file."""


class Storage(Protocol):
    """The file system that holds the recordings."""

    def create(self, path: Path) -> StorageFile:
        """Open a new file for writing, making missing directories. Raises FileExistsError when it exists."""

    def free_bytes(self, directory: Path) -> int:
        """Free space for an ordinary user in the file system of `directory` [bytes]."""

    def recordings(self, directory: Path) -> list[Path]:
        """All .mcap files under `directory`, oldest first."""

    def remove(self, path: Path) -> None:
        """Remove a file."""


class RealFile:
    """An unbuffered file: what is written survives the end of the process."""

    def __init__(self, path: Path) -> None:
        make_directories(path.parent)
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        self._path = path
        self._size = 0
        self._directory: Path | None = path.parent  # synced once, so that the name survives a power cut; then None

    def write(self, data: bytes) -> int:
        view = memoryview(data)
        while view:
            count = os.write(self._descriptor, view)
            self._size += count
            view = view[count:]
        return len(data)

    def tell(self) -> int:
        return self._size

    def flush(self) -> None:
        pass

    def sync(self) -> None:
        os.fdatasync(self._descriptor)
        if self._directory is not None:
            sync_directory(self._directory)
            self._directory = None
        self._check_present()

    def _check_present(self) -> None:
        """Raise OSError unless the path still leads to the open file: writes to a removed file, or to one whose file system was
        unmounted, succeed and are lost."""
        open_file, named_file = os.fstat(self._descriptor), self._path.stat()
        if (open_file.st_dev, open_file.st_ino) != (named_file.st_dev, named_file.st_ino):
            raise OSError(errno.ESTALE, "another file has taken its place", str(self._path))

    def close(self) -> None:
        os.close(self._descriptor)


def in_memory(directory: Path, mounts: Path = Path("/proc/self/mountinfo")) -> bool:
    """Whether files in a directory are lost without power: it lies in a tmpfs, or in an overlay whose upper layer is one.

    Recordings end up there when their card is not mounted. mounts: the mount table, proc(5). False where that is not readable.
    """
    existing = next(p for p in (directory, *directory.parents) if p.exists())
    try:
        kinds = dict(_mount(line) for line in mounts.read_text(encoding="utf-8").splitlines())
        kind, options = kinds.get(existing.stat().st_dev, ("", ""))  # type of file system, options
        if kind == "overlay":
            upper = next((o.partition("=")[2] for o in options.split(",") if o.startswith("upperdir=")), "")
            kind, _ = kinds.get(Path(upper).stat().st_dev, ("", "")) if upper else ("", "")
    except (OSError, ValueError):
        return False
    return kind == "tmpfs"


def _mount(line: str) -> tuple[int, tuple[str, str]]:
    """Device number, and type and options, of a line of mountinfo, proc(5)."""
    mount, _, system = line.partition(" - ")
    major, minor = mount.split()[2].split(":")
    kind, _, options = system.split(" ", 2)
    return os.makedev(int(major), int(minor)), (kind, options)


class RealStorage:
    """The file system of the machine."""

    def create(self, path: Path) -> StorageFile:
        return RealFile(path)

    def free_bytes(self, directory: Path) -> int:
        existing = next(p for p in (directory, *directory.parents) if p.exists())
        state = os.statvfs(existing)
        return state.f_bavail * state.f_frsize

    def recordings(self, directory: Path) -> list[Path]:
        dated: list[tuple[float, Path]] = []
        for path in directory.rglob("*.mcap"):
            with contextlib.suppress(FileNotFoundError):  # removed by another process meanwhile
                dated.append((path.stat().st_mtime, path))
        return [path for _, path in sorted(dated)]

    def remove(self, path: Path) -> None:
        path.unlink()
