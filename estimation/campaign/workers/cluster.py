"""The engine on dask.distributed: workers of this machine, or of a scheduler by address.

Only `submit` and `wait` are used: no graphs, and no results held by workers, because the scheduler forgets a client that died.
The scheduler cannot tell which of a dead worker's pieces killed it, so few are in flight. A piece that was on a worker at two
deaths is condemned: it runs once more, with nothing beside it.
"""

import contextlib
import logging
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from estimation.campaign.tasks import CampaignError, Finished, Row, Work
from estimation.campaign.workers.in_process import ended_after, overdue_text
from estimation.campaign.workers.work import OtherSoftwareError, do_work, failed_rows

if TYPE_CHECKING:
    from distributed import Client, Future, LocalCluster

IN_FLIGHT = 2  # pieces a worker: the next one waits when one ends, and few are suspect when the worker dies
TICK_S = 1.0  # longest wait for a piece to end before the caller gets its turn
LOOK_S = 5.0  # between checks that scheduler and workers are there: each costs a message there and back
LOST_S = 60.0  # longest absence of the scheduler or its last worker: a start takes 3 s, on a busy machine 60
MOST_STARTS = 5  # attempts to start workers on this machine
ATTEMPTS_BESIDE, ATTEMPTS_ALONE, ATTEMPTS_CONDEMNED = 1, 3, 4  # runs of a piece that ends among others, alone, or never
OVERDUE = "sideslip-overdue"
MEMORY = "1GB"  # a worker needs 130 MB for output error, 300 MB with torch: one that needs more is at fault

SETTINGS: dict[str, Any] = {
    "distributed.scheduler.allowed-failures": 1,  # the second death condemns; innocent work then passes alone
    "distributed.scheduler.worker-ttl": "30 minutes",  # a long fit holds the interpreter
    "distributed.worker.memory.target": False,  # C libraries hold the memory: there is nothing to spill
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.terminate": 0.95,
    "distributed.worker.profile.enabled": False,  # half a percent of a core
    "distributed.comm.timeouts.connect": "60s",
    "distributed.nanny.pre-spawn-environ": {
        "MALLOC_TRIM_THRESHOLD_": 65536,
        "OMP_NUM_THREADS": 1,
        "MKL_NUM_THREADS": 1,
        "OPENBLAS_NUM_THREADS": 1,
    },
}


class Cluster:
    """Workers of this machine, or those of a scheduler at `address`."""

    def __init__(self, workers: int, address: str = "", *, dashboard: bool = False) -> None:
        self._wanted, self._address, self._with_dashboard = workers, address, dashboard
        self._resources = contextlib.ExitStack()
        self._overdue: set[str] = set()
        self._lost_since: float | None = None
        self._checked_s = 0.0
        self._starts = 0
        self.dashboard = ""
        self._open()

    def _open(self) -> None:
        """Connect, or start workers; start them again where one died during its start."""
        try:
            from distributed import Client
        except ModuleNotFoundError as error:
            raise CampaignError(
                "the engine is not installed; pip install 'sideslip[campaign]', or do without it: --serial"
            ) from error
        if self._address:
            self.client = self._resources.enter_context(_connected(Client, self._address))
            has_dashboard = self._with_dashboard and "dashboard" in self.client.scheduler_info(n_workers=0)["services"]
            self.dashboard = self.client.dashboard_link if has_dashboard else ""
        while not self._address:
            self._starts += 1
            try:
                self.client = self._resources.enter_context(Client(self._resources.enter_context(self._local())))
                break
            except (RuntimeError, OSError) as error:
                self._resources.close()
                if self._starts >= MOST_STARTS:
                    raise CampaignError(f"workers cannot be started here ({error}); use --serial") from error
        self.client.subscribe_topic(OVERDUE, self._note_overdue)
        self.workers = max(1, self._count())
        self._lost_since = None

    def _local(self) -> "LocalCluster":
        import dask
        from distributed import LocalCluster

        for name in ("asyncio", "tornado.application"):  # a failed start is one sentence, from `_open`
            logging.getLogger(name).setLevel(logging.CRITICAL)
        self._resources.enter_context(dask.config.set(SETTINGS))
        local = LocalCluster(
            n_workers=self._wanted,
            threads_per_worker=1,
            processes=True,
            memory_limit=MEMORY,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",  # the default listens on all interfaces
            silence_logs=logging.CRITICAL,
        )
        self.dashboard = local.dashboard_link if self._with_dashboard else ""
        return local

    def close(self) -> None:
        """End the workers of this machine; a scheduler at an address goes on."""
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # it logs every connection that it closes
        self._resources.close()

    def run(self, works: Iterator[Work]) -> Iterator[Finished | None]:
        """Finished work in the order in which it ends; None for about every second without any."""
        condemned: list[Work] = []
        yield from self._window(works, IN_FLIGHT, "", condemned)
        condemned_twice: list[Work] = []
        for work in condemned:
            yield from self._window(iter([work]), 1, "-alone", condemned_twice)
        for work in condemned_twice:
            yield Finished(work, failed_rows(work, _condemned_text(work)), ATTEMPTS_CONDEMNED)

    def _window(
        self, works: Iterator[Work], most: int, suffix: str, condemned: list[Work]
    ) -> Iterator[Finished | None]:
        """Keep up to `most` pieces a worker in flight (1: one in all) until all ended; add those that kill workers to
        `condemned`."""
        futures: dict[Future, Work] = {}
        attempts = ATTEMPTS_ALONE if suffix else ATTEMPTS_BESIDE
        while True:
            while len(futures) < (most * self.workers if most > 1 else 1):
                work = next(works, None)
                if work is None:
                    break
                futures[self._submit(work, suffix)] = work
            if not futures:
                return
            ended_futures = self._ended(futures)
            for future in ended_futures:
                work = futures.pop(future)
                rows = self._rows(future, work)
                if rows is None:
                    condemned.append(work)
                else:
                    yield Finished(work, rows, attempts)
            if not ended_futures:
                if self._lost():
                    self._reopen()
                    futures = {self._submit(work, suffix): work for work in futures.values()}
                yield None

    def _submit(self, work: Work, suffix: str) -> "Future":
        key = f"{work.kind}-{work.identity}{suffix}-{time.monotonic_ns()}"
        return self.client.submit(watched, work, key=key, pure=False, retries=0)

    def _ended(self, waiting: "dict[Future, Work]") -> "list[Future]":
        """The futures that ended or are overdue, after a wait of at most TICK_S."""
        from distributed import wait

        try:
            ended_futures = list(wait(list(waiting), timeout=TICK_S, return_when="FIRST_COMPLETED").done)
        except TimeoutError:
            ended_futures = []
        return ended_futures + [f for f, w in waiting.items() if w.identity in self._overdue and f not in ended_futures]

    def _rows(self, future: "Future", work: Work) -> list[Row] | None:
        """Rows of an ended piece; None where its workers died too often."""
        from distributed import KilledWorker

        if work.identity in self._overdue and not future.done():
            future.cancel(force=True)
            return failed_rows(work, overdue_text(work.name, work.limit_s))
        if future.status == "finished":
            rows: list[Row] = future.result()
            return rows
        if future.status == "cancelled":
            raise CampaignError("the scheduler forgot its work; what was done is kept: run the same command again")
        error = future.exception()
        if isinstance(error, OtherSoftwareError):
            raise error
        if isinstance(error, KilledWorker):
            return None
        return failed_rows(work, f"{work.name}: {type(error).__name__}: {error}; the engine could not run it")

    def _lost(self) -> bool:
        """Whether there has been no scheduler, or no worker, for LOST_S."""
        if time.monotonic() - self._checked_s < LOOK_S:
            return False
        self._checked_s = time.monotonic()
        if self.client.status == "running" and (count := self._count()):
            self.workers, self._lost_since = count, None
            return False
        self._lost_since = self._lost_since or time.monotonic()
        return self.client.status == "closed" or time.monotonic() - self._lost_since > LOST_S

    def _reopen(self) -> None:
        """Start the workers of this machine anew: a nanny does not restart a worker that dies during its start."""
        if self._address:
            raise CampaignError(
                f"the scheduler at {self._address} or its last worker is gone; what was done is kept: run the command again"
            )
        self._resources.close()
        self._open()

    def _count(self) -> int:
        return len(self.client.scheduler_info(n_workers=-1)["workers"])

    def _note_overdue(self, event: tuple[float, str]) -> None:
        self._overdue.add(str(event[1]))


def watched(work: Work) -> list[Row]:
    """`do_work` on a worker, which ends itself when the work takes too long."""
    from distributed import get_worker

    from estimation.session import runner  # noqa: F401  load the libraries before the clock starts: it takes a second, or ten

    worker = get_worker()
    with ended_after(work.limit_s, lambda: worker.log_event(OVERDUE, work.identity)):
        return do_work(work)


def _connected(client: "type[Client]", address: str) -> "Client":
    try:
        return client(address, timeout=30)
    except (OSError, ValueError) as error:
        raise CampaignError(f"--scheduler {address}: no scheduler answers there ({error}); start one") from error


def _condemned_text(work: Work) -> str:
    return (
        f"{work.name}: the process that worked on it died four times, twice with nothing beside it (a crash, or more"
        f" than {MEMORY} of memory); look at it by itself with: sideslip estimate"
    )
