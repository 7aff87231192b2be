"""C compiled to shared libraries, kept in the user's cache folder under a digest of source, compiler flags and processor.

A library is kept with its checksum behind it: what a power cut or a full disk has made of one is no program to be started, and is
made anew. Where there is no home, no room, no compiler, or the folder must hold no programs, there is simply none.
"""

import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

from daq.utilities.durable import make_directories, write_bytes

FLAGS = ("-O3", "-march=native", "-fno-math-errno", "-fPIC", "-shared")
_SEAL = hashlib.sha256().digest_size


def compiler() -> str | None:
    """Path of gcc, or None; SIDESLIP_COMPILER names another one, or `none`."""
    command = os.environ.get("SIDESLIP_COMPILER", "gcc")
    return None if command == "none" else shutil.which(command)


def library_made(source: Callable[[], str], *content: str) -> ctypes.CDLL | None:
    """The library of some content, from the cache or compiled now; None where that cannot be done.

    source: makes its C text, only asked where it is not kept; content: what decides that text.
    """
    base = _cache_folder()
    if base is None:
        return None
    seed = "\n".join((*content, *FLAGS, _processor()))
    path = base / f"{hashlib.sha256(seed.encode()).hexdigest()[:32]}.so"
    try:
        if not _sound(path) and not _build(source(), path):
            return None
        return _open(path)
    except (
        OSError
    ):  # no room, no right to write or to run what lies there, no processes: the virtual machine does the work
        return None


def _cache_folder() -> Path | None:
    """None for a user without a home. A relative one would be of the working folder, where a stranger's files may lie."""
    try:
        home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    except RuntimeError:
        return None
    return Path(home) / "sideslip" / "compiled" if Path(home).is_absolute() else None


@lru_cache(maxsize=1)
def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return platform.machine() + platform.processor()
    return platform.machine() + "".join(line for line in lines if line.startswith(("model name", "flags", "Features")))


@lru_cache(maxsize=128)
def _open(path: Path) -> ctypes.CDLL:
    return ctypes.CDLL(str(path))


def _sound(path: Path) -> bool:
    """Whether a library is there as it was made."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return False
    return hashlib.sha256(data[:-_SEAL]).digest() == data[-_SEAL:]


def _build(source: str, path: Path) -> bool:
    """Compile C text to `path`; False where the compiler cannot."""
    gcc = compiler()
    if gcc is None:
        return False
    with TemporaryDirectory() as folder:
        text, library = Path(folder) / "model.c", Path(folder) / "model.so"
        text.write_text(source, encoding="utf-8")
        process = subprocess.run([gcc, *FLAGS, str(text), "-o", str(library), "-lm"], capture_output=True, check=False)
        if process.returncode != 0:
            return False
        data = library.read_bytes()
    make_directories(path.parent)
    write_bytes(path, data + hashlib.sha256(data).digest())
    return True
