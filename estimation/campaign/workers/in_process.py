"""The engine `--serial`: work in this process, one piece after the other; and the limits of time of any worker."""

import contextlib
import faulthandler
import os
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

from estimation.campaign.tasks import Finished, OverdueError, Work
from estimation.campaign.workers.work import do_work, failed_rows

GRACE_S = 3.0
"""Between reporting overdue work and ending the process: the report must leave it first."""
OVERDUE_STATUS = 70  # exit status of a worker that ends itself: EX_SOFTWARE of sysexits.h


@contextlib.contextmanager
def interrupted_after(limit_s: float, what: str) -> Iterator[None]:
    """Raise OverdueError in the main thread after `limit_s`. Code that never returns to Python is not reached."""

    def overdue(number: int, frame: FrameType | None) -> None:
        raise OverdueError(overdue_text(what, limit_s))

    old_handler = signal.signal(signal.SIGALRM, overdue)
    old_timer = signal.setitimer(signal.ITIMER_REAL, limit_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, old_handler)
        signal.setitimer(signal.ITIMER_REAL, *old_timer)  # another alarm that was set comes late, but comes


@contextlib.contextmanager
def ended_after(limit_s: float, tell: Callable[[], Any]) -> Iterator[None]:
    """End this process when the work takes longer than `limit_s`; `tell` is called GRACE_S before.

    Where a C library holds the interpreter lock, faulthandler's thread ends the process without calling `tell`.
    """

    def end() -> None:
        tell()
        threading.Event().wait(GRACE_S)
        if not finished.is_set():
            os._exit(OVERDUE_STATUS)

    finished = threading.Event()
    timer = threading.Timer(limit_s, end)
    timer.daemon = True
    with open(os.devnull, "w") as null_device:
        faulthandler.dump_traceback_later(limit_s + 3.0 * GRACE_S, exit=True, file=null_device)
        timer.start()
        try:
            yield
        finally:
            finished.set()
            timer.cancel()
            faulthandler.cancel_dump_traceback_later()


def overdue_text(what: str, limit_s: float) -> str:
    """Reason in the results of work that took too long."""
    return (
        f"{what}: took longer than {limit_s:g} s and was ended; look at it by itself, or allow more with --time-limit"
    )


class SerialEngine:
    """Runs work in this process. A flight that ends the process ends the campaign; finished work is on disk."""

    workers = 1
    dashboard = ""

    def run(self, works: Iterator[Work]) -> Iterator[Finished | None]:
        """Finished work, in the order given."""
        for work in works:
            try:
                with interrupted_after(work.limit_s, work.name):
                    rows = do_work(work)
            except OverdueError as error:
                rows = failed_rows(work, str(error))
            yield Finished(work, rows)

    def close(self) -> None:
        """Nothing to close."""
