"""Files that a power cut leaves whole: the old content or the new, under its name, never something between.

A file survives a cut once its data is synced, and its name once the directory is: a rename alone may come to the medium
before the data, and leave an empty file where there was a good one.
"""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def sync_directory(directory: Path) -> None:
    """Return once the names in a directory are on the medium; OSError when the medium fails."""
    if os.name == "nt":
        return  # Windows writes names through, and opens no directory
    try:
        descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
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
        for made in reversed(missing):
            sync_directory(made.parent)
    except OSError:
        for made in missing:  # or the next try would take them for safe
            if not any(made.iterdir()):
                made.rmdir()
        raise


@contextmanager
def replacing(path: Path, *, keep_ending: bool = False) -> Iterator[Path]:
    """A path beside `path` to write to. What was written there takes the place of `path` at the end.

    On return it is on the medium, name and all. When the block raises, `path` is as it was. keep_ending: for writers that
    choose the format by it; otherwise what a power cut leaves there is not taken for one of the files around it.
    """
    new = path.with_name(f"{path.stem}.new{path.suffix}" if keep_ending else f"{path.name}.new")
    try:
        yield new
        descriptor = os.open(new, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
        new.replace(path)
    except BaseException:
        new.unlink(missing_ok=True)
        raise
    sync_directory(path.parent)


@contextmanager
def whole(path: Path, *, keep_ending: bool = False) -> Iterator[Path]:
    """Where to write a file that is to be whole or not at all; links (/dev/stdout), pipes and devices take it as it comes."""
    if path.is_symlink() or (path.exists() and not path.is_file()):
        yield path
        return
    with replacing(path, keep_ending=keep_ending) as new:
        yield new


def write_text(path: Path, text: str) -> None:
    """Write a text file, as `whole` says."""
    with whole(path) as new:
        new.write_text(text, encoding="utf-8")
