"""A limit on the time that one piece of work may take: in this process by a signal, on a worker by ending the worker."""

import contextlib
import faulthandler
import os
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

from estimation.campaign.errors import OverdueError

GRACE_S = 3.0
"""Between saying that work is overdue and ending the process: the word must leave it first."""


@contextlib.contextmanager
def interrupted_after(limit_s: float, what: str) -> Iterator[None]:
    """Raise OverdueError in the main thread after `limit_s`. Code that never returns to Python is not reached."""

    def overdue(number: int, frame: FrameType | None) -> None:
        raise OverdueError(overdue_text(what, limit_s))

    before = signal.signal(signal.SIGALRM, overdue)
    others = signal.setitimer(signal.ITIMER_REAL, limit_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
        signal.setitimer(signal.ITIMER_REAL, *others)  # somebody else's alarm comes later than asked, but comes


@contextlib.contextmanager
def ended_after(limit_s: float, tell: Callable[[], Any]) -> Iterator[None]:
    """End this process when the work takes longer than `limit_s`; `tell` is called GRACE_S before.

    Where Python itself is held up, a thread of the C library ends the process without a word.
    """

    def end() -> None:
        tell()
        threading.Event().wait(GRACE_S)
        if not done.is_set():
            os._exit(70)

    done = threading.Event()
    timer = threading.Timer(limit_s, end)
    timer.daemon = True
    with open(os.devnull, "w") as nowhere:
        faulthandler.dump_traceback_later(limit_s + 3.0 * GRACE_S, exit=True, file=nowhere)
        timer.start()
        try:
            yield
        finally:
            done.set()
            timer.cancel()
            faulthandler.cancel_dump_traceback_later()


def overdue_text(what: str, limit_s: float) -> str:
    """The sentence on work that took too long."""
    return (
        f"{what}: took longer than {limit_s:g} s and was ended; look at it by itself, or allow more with --time-limit"
    )
