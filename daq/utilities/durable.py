"""The one way in which this program writes a file: the old content or the new, under its name, never something between.

A file is written under a hidden name beside its own, brought to the medium, and then takes the name: whatever fails in
between, a full disk, a kill or a power cut, what stood there before stands there still. A file survives a cut once its data
is synced, and its name once the directory is: a rename alone may come to the medium before the data. What a killed process
has left is taken away by the next that writes into the folder. Logs that must be on the disk while they grow are the
exception: `open_log`.
"""

import contextlib
import errno
import os
import secrets
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

try:
    import fcntl
except ImportError:  # Windows: leftovers are told by the process that is gone
    fcntl = None  # type: ignore[assignment]

ENDING = ".sideslip-new"
"""Of what is being written; no glob for recordings or tables matches it."""
NO_TEXT = "backslashreplace"
"""What becomes of a file name that is no text within one: `\\udcff`, which in JSON stands for the very name."""
_LONGEST_STEM = 120  # bytes of the final name within the hidden one: 255 are allowed in all
_ABANDONED_S = 3600.0  # an unlocked file of a process number that lives: the number was given again

DISK_ERRNOS = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO, errno.EFBIG, errno.ENODEV, errno.ESTALE})
"""What a disk that is full, read-only, broken or gone says."""


def lock_file(file: int | IO[str] | IO[bytes]) -> None:
    """Lock an open file against other processes until it is closed, however this one ends. OSError where one has it already;
    nothing where the system has no such locks (Windows)."""
    if fcntl is not None:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def sync_directory(directory: Path) -> None:
    """Return once the names in a directory are on the medium; OSError when the medium fails."""
    if os.name == "nt":
        return  # Windows writes names through, and opens no directory
    try:
        descriptor = os.open(directory, os.O_RDONLY | getattr(os, "O_DIRECTORY", 0))
    except PermissionError:
        return  # files may be made in it but not listed: what is recorded counts for more than that its name is safe
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL:  # some file systems have no such thing, and nothing more can be done there
            raise
    finally:
        os.close(descriptor)


def make_directories(directory: Path) -> None:
    """Make a directory and those above it; each new name is on the medium on return, and none is left when that fails."""
    missing = [d for d in (directory, *directory.parents) if not d.exists()]
    directory.mkdir(parents=True, exist_ok=True)
    try:
        for new in reversed(missing):
            sync_directory(new.parent)
    except OSError:
        for new in missing:  # or the next try would take them for safe
            if not any(new.iterdir()):
                new.rmdir()
        raise


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """An empty file beside `path` to write to. What was written there takes the place of `path` at the end.

    On return it is on the medium, name and all. When the block raises, `path` is as it was and nothing is left beside it;
    an OSError then names `path`. Its name has no ending that chooses a format: give the format to a writer that asks.
    """
    clear_leftovers(path.parent)
    with _errors_naming(path):
        new, descriptor = _hidden(path)
        try:
            yield new
            os.fsync(descriptor)
            new.replace(path)
        except BaseException:
            new.unlink(missing_ok=True)
            raise
        finally:
            os.close(descriptor)
        sync_directory(path.parent)


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Where to write a file that is to be whole or not at all; pipes and devices (/dev/stdout) take it as it comes.

    A link stays, and the file that it leads to is replaced.
    """
    target = _target(path)
    if target is None:
        with _errors_naming(path):
            yield path
        return
    with replacing(target) as new:
        yield new


def write_text(path: Path, text: str) -> None:
    write_bytes(path, text.encode("utf-8", NO_TEXT))


def write_bytes(path: Path, data: bytes) -> None:
    with whole(path) as new:
        new.write_bytes(data)


@contextmanager
def whole_text(path: Path, newline: str | None = "") -> Iterator[IO[str]]:
    """An open text file, UTF-8, that takes the name `path` at the end, as `whole` says. newline: "" for CSV."""
    with whole(path) as new, new.open("w", encoding="utf-8", errors=NO_TEXT, newline=newline) as file:
        yield file


@contextmanager
def whole_file(path: Path) -> Iterator[IO[bytes]]:
    """An open file of bytes that takes the name `path` at the end, as `whole` says: for libraries that take no name which is no
    text."""
    with whole(path) as new, new.open("wb") as file:
        yield file


@contextmanager
def replacing_folder(path: Path) -> Iterator[Path]:
    """A new folder beside `path` to fill, which takes its place at the end; when the block raises, `path` is as it was."""
    make_directories(path.parent)
    clear_leftovers(path.parent)
    with _errors_naming(path):
        new = path.with_name(_hidden_name(path))
        new.mkdir()
        try:
            yield new
            if path.exists():
                old = path.with_name(_hidden_name(path))
                path.replace(old)
                new.replace(path)
                shutil.rmtree(old, ignore_errors=True)
            else:
                new.replace(path)
        except BaseException:
            shutil.rmtree(new, ignore_errors=True)
            raise
        sync_directory(path.parent)


def try_folder(folder: Path) -> None:
    """Raise OSError where a folder takes no new entry. Like every hidden file, what a kill leaves of it is cleared later."""
    clear_leftovers(folder)
    new, descriptor = _hidden(folder / "probe")
    os.close(descriptor)
    new.unlink()


class FolderInUseError(Exception):
    """Another process writes into a folder."""


@contextmanager
def folder_of_ones_own(folder: Path, name: str) -> Iterator[None]:
    """Hold a folder, made if need be, against every other process that holds it under this name. The kernel lets go of it
    however this process ends. Raises FolderInUseError, or OSError where the folder cannot be written."""
    make_directories(folder)
    with open_log(folder / f".{name}.lock") as lock:
        try:
            lock_file(lock)
        except BlockingIOError:
            raise FolderInUseError(str(folder)) from None
        clear_leftovers(folder)
        yield


def open_log(path: Path, buffering: int = -1) -> IO[bytes]:
    """A file that grows while it is read, at its end: telemetry, journals, logs. What is written is there at once or later
    as its owner flushes; a torn last record is its reader's to pass over."""
    make_directories(path.parent)
    return path.open("a+b", buffering=buffering)


def clear_leftovers(directory: Path) -> None:
    """Remove what processes that are gone have left half-written in a directory; what cannot be removed stays."""
    try:
        leftovers = [entry.name for entry in os.scandir(directory) if entry.name.endswith(ENDING)]
    except OSError:
        return
    for name in leftovers:
        with contextlib.suppress(OSError):
            _clear(directory / name)


def _target(path: Path) -> Path | None:
    """The file that is to be replaced; None for what is no ordinary one, or another process's open file (/dev/fd/1)."""
    if path.is_symlink():
        if path.absolute().parts[1:2] in (("dev",), ("proc",)):
            return None
        path = path.resolve()
    return None if path.exists() and not path.is_file() else path


def _hidden_name(path: Path) -> str:
    stem = os.fsdecode(os.fsencode(path.name)[:_LONGEST_STEM])
    return f".{stem}.{os.getpid()}.{secrets.token_hex(6)}{ENDING}"


def _hidden(path: Path) -> tuple[Path, int]:
    """A new hidden file beside `path`, as the umask or the old file has its mode, locked as long as the descriptor is open."""
    new = path.with_name(_hidden_name(path))
    flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0)
    descriptor = os.open(new, flags, 0o666)
    try:
        with contextlib.suppress(OSError):  # a file system without locks: the process number tells
            lock_file(descriptor)
        with contextlib.suppress(FileNotFoundError, PermissionError, AttributeError):
            os.fchmod(descriptor, path.stat().st_mode & 0o777)
    except BaseException:
        os.close(descriptor)
        new.unlink(missing_ok=True)
        raise
    return new, descriptor


@contextmanager
def _errors_naming(path: Path) -> Iterator[None]:
    """An OSError inside names `path`, not nothing or the hidden file, and says in the system's words what it is."""
    try:
        yield
    except OSError as error:
        if error.filename is None or str(error.filename).endswith(ENDING):
            error.filename, error.filename2 = str(path), None
        if error.errno in DISK_ERRNOS:  # Arrow and others make a story of it
            error.strerror = os.strerror(error.errno)
        raise


def _clear(file: Path) -> None:
    """Remove one leftover, unless somebody is still writing it."""
    number = file.name.removesuffix(ENDING).rpartition(".")[0].rpartition(".")[2]
    lives = number.isdigit() and _lives(int(number))
    if lives and (int(number) == os.getpid() or time.time() - file.stat().st_mtime < _ABANDONED_S):
        return
    if file.is_dir() and not file.is_symlink():
        shutil.rmtree(file)
        return
    descriptor = os.open(file, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0))
    try:
        lock_file(descriptor)  # BlockingIOError: another machine is at it
        file.unlink(missing_ok=True)
    finally:
        os.close(descriptor)


def _lives(number: int) -> bool:
    if os.name == "nt":
        return True
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True
