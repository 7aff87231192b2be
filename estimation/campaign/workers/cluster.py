"""The engine: dask.distributed, a cluster of this machine or any scheduler by address.

Only `submit` and `wait` are used: no graphs, and no results held by workers, for the scheduler forgets a client that died.
What a worker's death teaches: all work assigned to it becomes suspect, so few pieces are in flight; what is suspected
too often is condemned, and then runs once more with nothing beside it.
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

IN_FLIGHT = 2  # pieces a worker: the next one is there when the last ends, and few are suspected when it dies
TICK_S = 1.0  # between looks at what else is to be done, where nothing ends
LOOK_S = 5.0  # between looks whether scheduler and workers are there: a look is a message there and back
LOST_S = 60.0  # a scheduler or its last worker may be away so long: a start takes 3 s, on a busy machine 60
MOST_STARTS = 5  # of workers of our own
OVERDUE = "sideslip-overdue"
MEMORY = "1GB"  # a worker needs 130 MB for output error, 300 MB with torch: what needs more is at fault

SETTINGS: dict[str, Any] = {
    "distributed.scheduler.allowed-failures": 1,  # the second death condemns; what is innocent passes alone
    "distributed.scheduler.worker-ttl": "30 minutes",  # a long fit holds the interpreter
    "distributed.worker.memory.target": False,  # the memory is of C libraries: there is nothing to spill
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
        self._held = contextlib.ExitStack()
        self._overdue: set[str] = set()
        self._lost_since: float | None = None
        self._looked = 0.0
        self._starts = 0
        self.dashboard = ""
        self._open()

    def _open(self) -> None:
        """Connect, or start workers; again where one of them died on its way up."""
        try:
            from distributed import Client
        except ModuleNotFoundError as error:
            raise CampaignError(
                "the engine is not installed; pip install 'sideslip[campaign]', or do without it: --serial"
            ) from error
        if self._address:
            self.client = self._held.enter_context(_connected(Client, self._address))
            has_dashboard = self._with_dashboard and "dashboard" in self.client.scheduler_info(n_workers=0)["services"]
            self.dashboard = self.client.dashboard_link if has_dashboard else ""
        while not self._address:
            self._starts += 1
            try:
                self.client = self._held.enter_context(Client(self._held.enter_context(self._local())))
                break
            except (RuntimeError, OSError) as error:
                self._held.close()
                if self._starts >= MOST_STARTS:
                    raise CampaignError(f"workers cannot be started here ({error}); use --serial") from error
        self.client.subscribe_topic(OVERDUE, self._heard)
        self.workers = max(1, self._count())
        self._lost_since = None

    def _local(self) -> "LocalCluster":
        import dask
        from distributed import LocalCluster

        for name in ("asyncio", "tornado.application"):  # what workers lack is told in the one sentence
            logging.getLogger(name).setLevel(logging.CRITICAL)
        self._held.enter_context(dask.config.set(SETTINGS))
        local = LocalCluster(
            n_workers=self._wanted,
            threads_per_worker=1,
            processes=True,
            memory_limit=MEMORY,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",  # the one that is not given is on all interfaces
            silence_logs=logging.CRITICAL,
        )
        self.dashboard = local.dashboard_link if self._with_dashboard else ""
        return local

    def close(self) -> None:
        """Workers of our own end; a foreign scheduler goes on."""
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # closing tells of every connection it closes
        self._held.close()

    def run(self, works: Iterator[Work]) -> Iterator[Finished | None]:
        """Finished work in the order in which it ends; None about every second in which none did."""
        condemned: list[Work] = []
        yield from self._window(works, IN_FLIGHT, "", condemned)
        condemned_twice: list[Work] = []
        for work in condemned:
            yield from self._window(iter([work]), 1, "-alone", condemned_twice)
        for work in condemned_twice:
            yield Finished(work, failed_rows(work, _condemned_text(work)), attempts=4)

    def _window(
        self, works: Iterator[Work], most: int, suffix: str, condemned: list[Work]
    ) -> Iterator[Finished | None]:
        """Keep up to `most` pieces a worker in flight until all have ended; what kills workers goes to `condemned`."""
        futures: dict[Future, Work] = {}
        attempts = 3 if suffix else 1
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
        """Those that ended, after at most TICK_S."""
        from distributed import wait

        try:
            ended_futures = list(wait(list(waiting), timeout=TICK_S, return_when="FIRST_COMPLETED").done)
        except TimeoutError:
            ended_futures = []
        return ended_futures + [f for f, w in waiting.items() if w.identity in self._overdue and f not in ended_futures]

    def _rows(self, future: "Future", work: Work) -> list[Row] | None:
        """Rows of an ended piece; None where it was on a worker that died once too often."""
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
        if time.monotonic() - self._looked < LOOK_S:
            return False
        self._looked = time.monotonic()
        if self.client.status == "running" and (count := self._count()):
            self.workers, self._lost_since = count, None
            return False
        self._lost_since = self._lost_since or time.monotonic()
        return self.client.status == "closed" or time.monotonic() - self._lost_since > LOST_S

    def _reopen(self) -> None:
        """Workers of our own are started anew: one that dies while it starts is not restarted by its nanny."""
        if self._address:
            raise CampaignError(
                f"the scheduler at {self._address} or its last worker is gone; what was done is kept: run the command again"
            )
        self._held.close()
        self._open()

    def _count(self) -> int:
        return len(self.client.scheduler_info(n_workers=-1)["workers"])

    def _heard(self, event: tuple[float, str]) -> None:
        self._overdue.add(str(event[1]))


def watched(work: Work) -> list[Row]:
    """`do` on a worker, which ends itself when the work takes too long."""
    from distributed import get_worker

    from estimation.session import runner  # noqa: F401  libraries are loaded before the clock starts: a second, or ten

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
