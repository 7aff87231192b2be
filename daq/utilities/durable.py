"""Atomic writing of files: under its name a file always has either its old content or its new one.

A file is written under a hidden name beside its own, synced, and then renamed: after a full disk, a kill or a power cut the old
file is still there. Data are synced before the rename, and the directory after it, because a rename alone may reach the medium
before the data. The next process that writes into the folder removes what a killed one has left. Logs, which must be readable
while they grow, are the exception: `open_log`.
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
except ImportError:  # Windows: a leftover is recognised by its process number alone
    fcntl = None  # type: ignore[assignment]

ENDING = ".sideslip-new"
"""Suffix of files that are being written; no glob for recordings or tables matches it."""
NO_TEXT = "backslashreplace"
"""Error handler for file names that are not valid text: written as `\\udcff`, which in JSON stands for the same name."""
_LONGEST_STEM = 120  # bytes of the final name within the hidden one, of 255 in all
_ABANDONED_S = 3600.0  # an older file without a lock is a leftover even if its process number exists: it was reused

DISK_ERRNOS = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO, errno.EFBIG, errno.ENODEV, errno.ESTALE})
"""Errors of a disk that is full, read-only, broken or gone."""


def lock_file(file: int | IO[str] | IO[bytes]) -> None:
    """Lock an open file against other processes until it is closed, however this one ends. Raises OSError where another process
    has locked it; does nothing where the system has no such locks (Windows)."""
    if fcntl is not None:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def sync_directory(directory: Path) -> None:
    """Return once the names in a directory are on the medium. Raises OSError when the medium fails."""
    if os.name == "nt":
        return  # Windows writes names through, and opens no directory
    try:
        descriptor = os.open(directory, os.O_RDONLY | getattr(os, "O_DIRECTORY", 0))
    except PermissionError:
        return  # a directory that may be written but not read cannot be synced; recording matters more than a safe name
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL:  # some file systems cannot sync a directory
            raise
    finally:
        os.close(descriptor)


def make_directories(directory: Path) -> None:
    """Make a directory and its parents. On return every new name is on the medium; on failure the new ones are removed."""
    missing = [d for d in (directory, *directory.parents) if not d.exists()]
    directory.mkdir(parents=True, exist_ok=True)
    try:
        for new in reversed(missing):
            sync_directory(new.parent)
    except OSError:
        for new in missing:  # otherwise the next call would assume that they are on the medium
            if not any(new.iterdir()):
                new.rmdir()
        raise


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield an empty file beside `path` to write to; it replaces `path` at the end of the block.

    On return data and name are on the medium. When the block raises, `path` is unchanged and nothing is left beside it; an
    OSError then names `path`. The suffix of the yielded name chooses no format: pass the format to a writer that goes by the
    suffix.
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
    """Yield a path to write to, whose file replaces `path` at the end of the block; a pipe or device (/dev/stdout) is yielded as
    it is. A symbolic link stays, and its target is replaced."""
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
    """Yield an open text file, UTF-8, that replaces `path` at the end of the block (see `whole`). newline: "" for CSV."""
    with whole(path) as new, new.open("w", encoding="utf-8", errors=NO_TEXT, newline=newline) as file:
        yield file


@contextmanager
def whole_file(path: Path) -> Iterator[IO[bytes]]:
    """Yield an open binary file that replaces `path` at the end of the block (see `whole`), for libraries that accept only names
    that are valid text."""
    with whole(path) as new, new.open("wb") as file:
        yield file


@contextmanager
def replacing_folder(path: Path) -> Iterator[Path]:
    """Yield a new folder beside `path` to fill; it replaces `path` at the end. When the block raises, `path` is unchanged."""
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
    """Raise OSError where no file can be made in a folder."""
    clear_leftovers(folder)
    new, descriptor = _hidden(folder / "probe")
    os.close(descriptor)
    new.unlink()


class FolderInUseError(Exception):
    """Another process writes into a folder."""


@contextmanager
def folder_of_ones_own(folder: Path, name: str) -> Iterator[None]:
    """Lock a folder, made if missing, against other processes that lock it under this name, until the block or the process ends.
    Raises FolderInUseError, or OSError where the folder cannot be written."""
    make_directories(folder)
    with open_log(folder / f".{name}.lock") as lock:
        try:
            lock_file(lock)
        except BlockingIOError:
            raise FolderInUseError(str(folder)) from None
        clear_leftovers(folder)
        yield


def open_log(path: Path, buffering: int = -1) -> IO[bytes]:
    """Open a file for appending that is read while it grows: telemetry, journals, logs. The caller flushes it; readers must
    expect an incomplete last record."""
    make_directories(path.parent)
    return path.open("a+b", buffering=buffering)


def clear_leftovers(directory: Path) -> None:
    """Remove the unfinished files of ended processes from a directory, as far as possible."""
    try:
        leftovers = [entry.name for entry in os.scandir(directory) if entry.name.endswith(ENDING)]
    except OSError:
        return
    for name in leftovers:
        with contextlib.suppress(OSError):
            _clear(directory / name)


def _target(path: Path) -> Path | None:
    """The file to be replaced; None for a pipe or device, or for an open file (/dev/fd/1)."""
    if path.is_symlink():
        if path.absolute().parts[1:2] in (("dev",), ("proc",)):
            return None
        path = path.resolve()
    return None if path.exists() and not path.is_file() else path


def _hidden_name(path: Path) -> str:
    stem = os.fsdecode(os.fsencode(path.name)[:_LONGEST_STEM])
    return f".{stem}.{os.getpid()}.{secrets.token_hex(6)}{ENDING}"


def _hidden(path: Path) -> tuple[Path, int]:
    """Make a hidden file beside `path` with the mode of the old file, or by the umask; returns its path and a descriptor that
    holds a lock on it."""
    new = path.with_name(_hidden_name(path))
    flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0)
    descriptor = os.open(new, flags, 0o666)
    try:
        with contextlib.suppress(OSError):  # a file system without locks: the process number must do
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
    """Make an OSError raised inside name `path` instead of the hidden file, with the system's description."""
    try:
        yield
    except OSError as error:
        if error.filename is None or str(error.filename).endswith(ENDING):
            error.filename, error.filename2 = str(path), None
        if error.errno in DISK_ERRNOS:  # Arrow and others write a text of their own
            error.strerror = os.strerror(error.errno)
        raise


def _clear(file: Path) -> None:
    """Remove one unfinished file, unless a process is still writing it."""
    number = file.name.removesuffix(ENDING).rpartition(".")[0].rpartition(".")[2]
    running = number.isdigit() and _process_exists(int(number))
    if running and (int(number) == os.getpid() or time.time() - file.stat().st_mtime < _ABANDONED_S):
        return
    if file.is_dir() and not file.is_symlink():
        shutil.rmtree(file)
        return
    descriptor = os.open(file, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0))
    try:
        lock_file(descriptor)  # BlockingIOError: a process on another machine is writing it
        file.unlink(missing_ok=True)
    finally:
        os.close(descriptor)


def _process_exists(number: int) -> bool:
    if os.name == "nt":
        return True
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True
