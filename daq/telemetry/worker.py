"""A thread behind the scan loop, for what may take long: the card, compression.

It does one job after another, and few may wait: whoever asks too much is refused instead of being remembered. The thread
is a daemon, so that a card that never answers does not keep the process from ending.
"""

import threading
from collections.abc import Callable
from concurrent.futures import Future
from queue import SimpleQueue
from typing import Any, TypeVar

T = TypeVar("T")

_Job = tuple["Future[Any]", Callable[..., Any], tuple[Any, ...]]


class Worker:
    """Jobs in order, in a thread that begins with the first of them. `submit` and `close` belong to one thread.

    room: jobs that may wait or be under way at a time.
    """

    def __init__(self, name: str, *, room: int = 1) -> None:
        self._name = name
        self._room = room
        self._jobs: SimpleQueue[_Job | None] = SimpleQueue()
        self._pending: list[Future[Any]] = []
        self._thread: threading.Thread | None = None

    @property
    def has_room(self) -> bool:
        """Whether `submit` would take a job."""
        self._pending = [f for f in self._pending if not f.done()]
        return len(self._pending) < self._room

    @property
    def busy(self) -> bool:
        """Whether a job waits or is under way."""
        alive = self._thread is not None and self._thread.is_alive()
        return alive and any(not f.done() for f in self._pending)

    def submit(self, work: Callable[..., T], *arguments: Any) -> "Future[T] | None":
        """Have `work(*arguments)` done; None when there is no room for it."""
        if not self.has_room:
            return None
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
            self._thread.start()
        future: Future[T] = Future()
        self._pending.append(future)
        self._jobs.put((future, work, arguments))
        return future

    def close(self, patience_s: float) -> bool:
        """Let the job under way end, give up those behind it; False when it takes longer than `patience_s`."""
        for future in self._pending:
            future.cancel()
        thread, self._thread = self._thread, None
        if thread is None:
            return True
        self._jobs.put(None)
        thread.join(patience_s)
        return not thread.is_alive()

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            future, work, arguments = job
            if not future.set_running_or_notify_cancel():
                continue
            try:
                future.set_result(work(*arguments))
            except OSError as error:
                future.set_exception(error)
