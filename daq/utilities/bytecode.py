"""Python's compiled modules on a disk that fills up.

Python 3.11 takes a compiled module for written though only a part of it fitted, and ends each later import of that module
with an EOFError: a program run once beside a full disk would not start again when there is room.
"""

import os
import sys

NEEDED_BYTES = 64 << 20
"""Room for the compiled modules of this program and of every library that it imports (about 40 MB), and some more."""
REMEDY = (
    "a compiled module of Python is cut short, as a full disk or a power cut leaves it; remove the folders __pycache__"
)


def spare_full_disk() -> None:
    """Write no compiled modules where the disk of this program, or the longest file this process may write, is small."""
    if sys.dont_write_bytecode:
        return
    try:
        import resource
    except ModuleNotFoundError:  # on Windows, which has no os.statvfs either
        return
    longest, _ = resource.getrlimit(resource.RLIMIT_FSIZE)
    state = os.statvfs(os.path.dirname(__file__))  # noqa: PTH120  pathlib would be a module to compile itself
    limited = longest != resource.RLIM_INFINITY and longest < NEEDED_BYTES
    sys.dont_write_bytecode = limited or state.f_bavail * state.f_frsize < NEEDED_BYTES
