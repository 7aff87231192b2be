"""Refusals are told now and then, all of them in time: who is refused a thousand times a second is not told so each time."""

import logging
from collections.abc import Callable

from daq.clock import NS

_LOG = logging.getLogger("sideslip.uplink")

REPORT_NS = 5 * NS
_KINDS = 3  # sentences told at a time: two STATUSTEXT each, they take under 80 bytes/s of the link
_WARNING = 4


class Refusals:
    """Collects sentences and tells each kind once with the number of its repetitions, at most every five seconds.

    Of very many kinds some are told, and the others are in the number of the last. text: takes severity and words for the
    ground.
    """

    def __init__(self, text: Callable[[int, str], None]) -> None:
        self._text = text
        self._told_ns: int | None = None
        self._untold: dict[str, int] = {}

    def note(self, words: str) -> None:
        """Something was refused."""
        if words not in self._untold and len(self._untold) >= _KINDS:
            words = next(reversed(self._untold))
        self._untold[words] = self._untold.get(words, 0) + 1

    def tell(self, now_ns: int) -> None:
        """Say what has been refused, if it is time to."""
        if not self._untold or (self._told_ns is not None and now_ns - self._told_ns < REPORT_NS):
            return
        for words, count in self._untold.items():
            told = words + (f" (and {count - 1} more)" if count > 1 else "")
            _LOG.warning("%s", told)
            self._text(_WARNING, told)
        self._told_ns, self._untold = now_ns, {}
