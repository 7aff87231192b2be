"""A thread beside the scan loop for slow jobs: the card, compression.

It does one job after another from a short queue; further jobs are refused. The thread is a daemon, so that a card that never
answers cannot keep the process from ending.
"""

import threading
from collections.abc import Callable
from concurrent.futures import Future
from queue import SimpleQueue
from typing import Any, TypeVar

T = TypeVar("T")

_Job = tuple["Future[Any]", Callable[..., Any], tuple[Any, ...]]


class Worker:
    """Does jobs in order, in a thread that starts with the first of them. Call `submit` and `close` from one thread only.

    capacity: jobs that may be queued or running at a time.
    """

    def __init__(self, name: str, *, capacity: int = 1) -> None:
        self._name = name
        self._capacity = capacity
        self._jobs: SimpleQueue[_Job | None] = SimpleQueue()
        self._pending: list[Future[Any]] = []
        self._thread: threading.Thread | None = None

    @property
    def has_capacity(self) -> bool:
        """Whether `submit` would take a job."""
        self._pending = [f for f in self._pending if not f.done()]
        return len(self._pending) < self._capacity

    @property
    def busy(self) -> bool:
        """Whether a job is queued or running."""
        alive = self._thread is not None and self._thread.is_alive()
        return alive and any(not f.done() for f in self._pending)

    def submit(self, function: Callable[..., T], *arguments: Any) -> "Future[T] | None":
        """Queue `function(*arguments)`; None when the queue is full."""
        if not self.has_capacity:
            return None
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
            self._thread.start()
        future: Future[T] = Future()
        self._pending.append(future)
        self._jobs.put((future, function, arguments))
        return future

    def close(self, timeout_s: float) -> bool:
        """Cancel the queued jobs and wait for the running one; False when that takes longer than `timeout_s` [s]."""
        for future in self._pending:
            future.cancel()
        thread, self._thread = self._thread, None
        if thread is None:
            return True
        self._jobs.put(None)
        thread.join(timeout_s)
        return not thread.is_alive()

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            future, function, arguments = job
            if not future.set_running_or_notify_cancel():
                continue
            try:
                future.set_result(function(*arguments))
            except OSError as error:
                future.set_exception(error)
