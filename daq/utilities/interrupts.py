"""Ctrl-C of a command: at any time one line, exit status 130, and closed files.

Python's own handling, a KeyboardInterrupt between any two instructions, fails in three cases. While the program is importing at
start, it ends in a traceback; within the import of a library with compiled parts it becomes an ImportError of that library; in a
callback or finaliser it is printed and lost. Therefore the process ends at once before the work begins, when no file is open yet;
during an import the interrupt is delayed to its end; and a lost interrupt is raised again.
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
_AGAIN_S = 0.02  # after so long a delayed or lost interrupt is raised again


def started_as_command(program: str) -> bool:
    """Whether this process is the command, not one that imports it, and Ctrl-C is not ignored, as in a shell's background job."""
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        return False
    started = Path(sys.argv[0] if sys.argv else "")
    as_module = started.name == "__main__.py" and started.parent.name == program  # python -m
    return as_module or started.name in (program, f"{program}.exe")


class Interrupts:
    """Handling of SIGINT from the first line of a command to its last. Uses SIGALRM and the real-time timer for delays."""

    def __init__(self) -> None:
        self.seen = False
        self.ended_by: signal.Signals | None = None
        """SIGTERM or SIGHUP, where one of them ended the work instead of Ctrl-C."""

    def leave_at_once(self) -> None:
        """From now on, with no file open, an interrupt ends the process at once; a delayed one is discarded."""
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(
            signal.SIGALRM, signal.SIG_IGN
        )  # the interpreter's end restores the default, which kills the process
        signal.signal(signal.SIGINT, self._leave)

    def raise_in_work(self) -> None:
        """From now on an interrupt raises KeyboardInterrupt, so that files are closed as it propagates."""
        signal.signal(signal.SIGALRM, self._interrupt)
        sys.unraisablehook = self._unraisable
        signal.signal(signal.SIGINT, self._interrupt)
        for number in ENDING_SIGNALS:
            if signal.getsignal(number) is signal.SIG_DFL:  # not ignored, as under nohup
                signal.signal(number, self._end)

    @property
    def status(self) -> int:
        """Exit status after an interrupt: 128 plus the signal's number."""
        return STATUS if self.ended_by is None else 128 + self.ended_by

    @property
    def words(self) -> str:
        """The line printed after an interrupt."""
        ending = "interrupted" if self.ended_by is None else f"ended by {self.ended_by.name}"
        return f"sideslip: {ending}; files are closed"

    def _leave(self, number: int, frame: FrameType | None) -> None:
        os.write(2, SAID)
        os._exit(STATUS)

    def _end(self, number: int, frame: FrameType | None) -> None:
        """End the work as after Ctrl-C: files are closed, and unfinished ones removed."""
        self.ended_by = signal.Signals(number)
        self._interrupt(number, frame)

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        self.seen = True
        if _importing(frame):
            signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
            return
        raise KeyboardInterrupt

    def _unraisable(self, what: Any) -> None:
        """Raise a KeyboardInterrupt again that was raised where it cannot propagate; other exceptions are printed as usual."""
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
