"""The engine that is none: one piece of work after the other, in this process."""

from collections.abc import Iterator

from estimation.campaign.errors import OverdueError
from estimation.campaign.tasks import Finished, Work
from estimation.campaign.workers.limits import interrupted_after
from estimation.campaign.workers.work import do, failed


class SerialEngine:
    """Runs work where it is. A flight that ends the process ends the campaign; what was done is on disk."""

    workers = 1
    dashboard = ""

    def run(self, works: Iterator[Work]) -> Iterator[Finished | None]:
        """Finished work, in the order given."""
        for work in works:
            try:
                with interrupted_after(work.limit_s, work.name):
                    rows = do(work)
            except OverdueError as error:
                rows = failed(work, str(error))
            yield Finished(work, rows)

    def close(self) -> None:
        """Nothing to close."""
