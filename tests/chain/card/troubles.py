"""What may be wrong with a card; by itself, so that a test can be skipped where FUSE is not installed."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Troubles:
    """What is wrong with the card now. Times are real.

    sync_s: every sync takes so long, and what it moves goes at `bytes_per_s` on top. fails: operations (write, sync, create)
    that fail, with their error number.
    """

    sync_s: float = 0.0
    bytes_per_s: float = 0.0
    fails: Mapping[str, int] | None = None
