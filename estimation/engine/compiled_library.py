"""C compiled to shared libraries, cached in the user's folder under a digest of source, compiler flags and processor.

A checksum follows each library in its file: one that a power cut or a full disk has damaged is not loaded but compiled anew.
Where there is no home, no space, no compiler, or no right to run programs from that folder, there is no library.
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
_CHECKSUM = hashlib.sha256().digest_size  # bytes


def compiler() -> str | None:
    """Path of the compiler, or None; the variable SIDESLIP_COMPILER names another one than gcc, or `none`."""
    command = os.environ.get("SIDESLIP_COMPILER", "gcc")
    return None if command == "none" else shutil.which(command)


def library_made(source: Callable[[], str], *content: str) -> ctypes.CDLL | None:
    """A library from the cache or compiled now; None where neither is possible.

    source: makes its C text, called only where it is not cached; content: what determines that text.
    """
    base = _cache_folder()
    if base is None:
        return None
    seed = "\n".join((*content, *FLAGS, _processor()))
    path = base / f"{hashlib.sha256(seed.encode()).hexdigest()[:32]}.so"
    try:
        if not _intact(path) and not _build(source(), path):
            return None
        return _open(path)
    except OSError:  # no space, no right to write or run there, no processes: the virtual machine does the work
        return None


def _cache_folder() -> Path | None:
    """Folder of the libraries; None without a home, or with a relative one, which would be in the working folder and hold
    anybody's files."""
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


def _intact(path: Path) -> bool:
    """Whether a library is cached and matches its checksum."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return False
    return hashlib.sha256(data[:-_CHECKSUM]).digest() == data[-_CHECKSUM:]


def _build(source: str, path: Path) -> bool:
    """Compile C text to `path`; False without a compiler or where it fails."""
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
