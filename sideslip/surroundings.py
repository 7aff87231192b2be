"""Errors of the operating system (disk, memory, open files, processes) as one sentence with a remedy."""

import errno
import os

from daq.utilities.durable import DISK_ERRNOS

_REMEDIES = {
    errno.EMFILE: "let this process have more open files (ulimit -n)",
    errno.ENFILE: "close other programs: this machine has no more open files",
    errno.ENOMEM: "close other programs, or give it less at once",
    errno.EAGAIN: "let this user have more processes (ulimit -u), or close other programs",
    errno.ENOBUFS: "close other programs",
}
_NO_THREAD = "can't start new thread"  # CPython's message: nothing else distinguishes this RuntimeError
_NO_TEMPORARY = "No usable temporary directory"  # message of tempfile


def refusal(error: BaseException) -> str | None:
    """The sentence for an error of the operating system; None for any other error."""
    if isinstance(error, MemoryError):
        return f"{os.strerror(errno.ENOMEM)}; {_REMEDIES[errno.ENOMEM]}"
    if isinstance(error, RuntimeError) and str(error) == _NO_THREAD:
        return f"{_NO_THREAD}; {_REMEDIES[errno.EAGAIN]}"
    if not isinstance(error, OSError):
        return None
    if error.errno in _REMEDIES:
        place = "" if error.filename is None else f"{error.filename}: "
        return f"{place}{os.strerror(error.errno)}; {_REMEDIES[error.errno]}"
    if error.filename is None and error.errno == errno.ENOENT:
        if _NO_TEMPORARY in str(error.strerror):
            return f"{error.strerror}; make room in one of them, or name another with TMPDIR"
        return "the working folder is gone; change into one that is there"  # os.getcwd alone names no file
    if error.filename is None and error.errno not in DISK_ERRNOS:
        return None
    place = error.filename2 or error.filename or "a file"
    return f"{place}: cannot be read or written ({error.strerror}); choose another place"
