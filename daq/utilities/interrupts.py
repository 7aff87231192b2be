"""Ctrl-C of a command: one line, exit status 130, files closed, whenever it comes.

Python's own way, a KeyboardInterrupt between any two instructions, fails at three moments. While the program is still
importing it ends in a traceback; within an import of a library with compiled parts it becomes an ImportError of that library;
and where it meets a callback or a finaliser it is printed and lost. So: before work has begun the process ends at once,
for nothing is open yet; during an import the interrupt waits for the end of that import; and a lost one is raised again.
"""

import os
import signal
import sys
from pathlib import Path
from types import FrameType
from typing import Any

STATUS = 130  # 128 + SIGINT, as shells have it
SAID = b"\nsideslip: interrupted; files are closed\n"
ENDING_SIGNALS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
_AGAIN_S = 0.02  # an interrupt that had to wait is tried again this often


def started_as_command(program: str) -> bool:
    """Whether this process is the command, not one that imports it, and was not told by a shell to ignore Ctrl-C (a job in the
    background is)."""
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        return False
    started = Path(sys.argv[0] if sys.argv else "")
    as_module = started.name == "__main__.py" and started.parent.name == program  # python -m
    return as_module or started.name in (program, f"{program}.exe")


class Interrupts:
    """What SIGINT does, from the first line of a command to its last. SIGALRM and the real-time timer serve for waiting."""

    def __init__(self) -> None:
        self.seen = False
        self.ended_by: signal.Signals | None = None
        """SIGTERM or SIGHUP, where one of them ended the work instead of Ctrl-C."""

    def leave_at_once(self) -> None:
        """From here on nothing is open: an interrupt ends the process, one that still waits to be tried again does nothing."""
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, signal.SIG_IGN)  # else the interpreter's end would make it deadly again
        signal.signal(signal.SIGINT, self._leave)

    def raise_in_work(self) -> None:
        """From here on an interrupt is a KeyboardInterrupt, so that files are closed on its way up."""
        signal.signal(signal.SIGALRM, self._interrupt)
        sys.unraisablehook = self._unraisable
        signal.signal(signal.SIGINT, self._interrupt)
        for number in ENDING_SIGNALS:
            if signal.getsignal(number) is signal.SIG_DFL:  # not one that nohup, say, has told us to ignore
                signal.signal(number, self._end)

    @property
    def status(self) -> int:
        """Exit status of what an interrupt ended, as shells have it."""
        return STATUS if self.ended_by is None else 128 + self.ended_by

    @property
    def words(self) -> str:
        """The line that goes with it."""
        ending = "interrupted" if self.ended_by is None else f"ended by {self.ended_by.name}"
        return f"sideslip: {ending}; files are closed"

    def _leave(self, number: int, frame: FrameType | None) -> None:
        os.write(2, SAID)
        os._exit(STATUS)

    def _end(self, number: int, frame: FrameType | None) -> None:
        """Files are closed and what is half-written is removed on the way up, as after Ctrl-C."""
        self.ended_by = signal.Signals(number)
        self._interrupt(number, frame)

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        self.seen = True
        if _importing(frame):
            signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
            return
        raise KeyboardInterrupt

    def _unraisable(self, what: Any) -> None:
        """In place of printing an exception that nobody can catch."""
        if issubclass(what.exc_type, KeyboardInterrupt):
            signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
        else:
            sys.__unraisablehook__(what)


def _importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False
