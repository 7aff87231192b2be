"""The log of a process that must not wait for it: lines go to standard error and to a file, each by a thread of its own."""

import contextlib
import logging
import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from daq.utilities.plain_words import visible
from daq.utilities.rotating_log import RotatingLog
from daq.utilities.standard_streams import Speaker
from daq.utilities.utc_stamps import log_stamp

RECORD_LOG = "record.log"
_STANDARD_ERROR = 2


class _LateFile:
    """A rotating log whose folder may come later: what is said before that is lost."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._log: RotatingLog | None = None

    def write(self, data: bytes) -> None:
        with contextlib.suppress(OSError, ValueError):  # ValueError: closed meanwhile
            if self._log is None:
                self._path.parent.mkdir(parents=True, exist_ok=True)
                self._log = RotatingLog(self._path)
            self._log.write(data)

    def close(self) -> None:
        if self._log is not None:
            self._log.close()


class _TwoWays(logging.Handler):
    def __init__(self, path: Path) -> None:
        super().__init__()
        self._aloud = Speaker(partial(os.write, _STANDARD_ERROR))
        self._late_file = _LateFile(path)
        self._file = Speaker(self._late_file.write)

    def emit(self, record: logging.LogRecord) -> None:
        line = visible(f"{record.levelname} {record.name}: {record.getMessage()}")
        stamp = log_stamp(record.created)
        self._aloud.say(line)
        self._file.say(f"{stamp} {line}")

    def close(self) -> None:
        self._file.close()
        self._late_file.close()
        self._aloud.close()
        super().close()


@contextlib.contextmanager
def logged(folder: Path) -> Iterator[None]:
    """Every line of this process's loggers from INFO on, on standard error and in `record.log` of a folder. Whatever these do
    (closed, full, without a reader, a card that does not answer), nothing waits for them and nothing fails."""
    root, handler = logging.getLogger(), _TwoWays(folder / RECORD_LOG)
    level = root.level
    root.addHandler(handler)
    root.setLevel(logging.INFO)
    try:
        yield
    finally:
        root.removeHandler(handler)
        root.setLevel(level)
        handler.close()
