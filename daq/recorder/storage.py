"""The file operations the recorder needs, behind one small interface.

A real card and a failing one differ only here: a test or the simulator hands the recorder a storage whose writes are
slow, whose space ends, or whose mount is gone.
"""

import contextlib
import errno
import os
from pathlib import Path
from typing import Protocol

from daq.utilities.durable import make_directories, sync_directory


class StorageFile(Protocol):
    """One file being written. Errors are OSError, as from the operating system."""

    def write(self, data: bytes) -> int:
        """Write all of `data`."""

    def tell(self) -> int:
        """Bytes written so far."""

    def flush(self) -> None:
        """Nothing is held back in the process: everything written has gone to the operating system."""

    def sync(self) -> None:
        """Return once everything written is on the medium."""

    def close(self) -> None:
        """Release the file."""


class Storage(Protocol):
    """Where recordings are kept."""

    def create(self, path: Path) -> StorageFile:
        """Open a new file for writing, its directory made if need be; FileExistsError when there is one."""

    def free_bytes(self, directory: Path) -> int:
        """Space left for an ordinary user in the file system of `directory`."""

    def recordings(self, directory: Path) -> list[Path]:
        """All .mcap files under `directory`, the oldest first."""

    def remove(self, path: Path) -> None:
        """Remove a file."""


class RealFile:
    """A file of the operating system, unbuffered: what is written survives the end of the process."""

    def __init__(self, path: Path) -> None:
        make_directories(path.parent)
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        self._path = path
        self._at = 0
        self._directory: Path | None = path.parent  # to be synced once, so that the name survives a power cut too

    def write(self, data: bytes) -> int:
        view = memoryview(data)
        while view:
            count = os.write(self._descriptor, view)
            self._at += count
            view = view[count:]
        return len(data)

    def tell(self) -> int:
        return self._at

    def flush(self) -> None:
        pass

    def sync(self) -> None:
        os.fdatasync(self._descriptor)
        if self._directory is not None:
            sync_directory(self._directory)
            self._directory = None
        self._must_be_there()

    def _must_be_there(self) -> None:
        """A file system unmounted under an open file, or a file removed, swallows writes without an error."""
        open_file, named_file = os.fstat(self._descriptor), self._path.stat()
        if (open_file.st_dev, open_file.st_ino) != (named_file.st_dev, named_file.st_ino):
            raise OSError(errno.ESTALE, "another file has taken its place", str(self._path))

    def close(self) -> None:
        os.close(self._descriptor)


def in_memory(directory: Path, mounts: Path = Path("/proc/self/mountinfo")) -> bool:
    """Whether what is written there goes with the power: a tmpfs, or one laid over a system that is never written.

    That is where recordings go when their card is not mounted. False where the system does not say.
    """
    existing = next(p for p in (directory, *directory.parents) if p.exists())
    try:
        kinds = dict(_mount(line) for line in mounts.read_text(encoding="utf-8").splitlines())
        kind, options = kinds.get(existing.stat().st_dev, ("", ""))
        if kind == "overlay":
            upper = next((o.partition("=")[2] for o in options.split(",") if o.startswith("upperdir=")), "")
            kind, _ = kinds.get(Path(upper).stat().st_dev, ("", "")) if upper else ("", "")
    except (OSError, ValueError):
        return False
    return kind == "tmpfs"


def _mount(line: str) -> tuple[int, tuple[str, str]]:
    """Device number -> type and options of a line of mountinfo, proc(5)."""
    place, _, system = line.partition(" - ")
    major, minor = place.split()[2].split(":")
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
            with contextlib.suppress(FileNotFoundError):  # removed by somebody else meanwhile
                dated.append((path.stat().st_mtime, path))
        return [path for _, path in sorted(dated)]

    def remove(self, path: Path) -> None:
        path.unlink()
