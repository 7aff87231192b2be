"""Ports and files that fail at present: shown until it is over, and never a reason to end reception."""

from collections.abc import Iterator
from contextlib import contextmanager

from groundstation.receiver import events as ev


class Faults:
    """What fails, in the system's words; every change becomes one `Trouble` event."""

    def __init__(self) -> None:
        self.present: dict[str, str] = {}
        self._told: dict[str, str] = {}

    def note(self, what: str, error: OSError) -> None:
        """Something fails."""
        self.present[what] = error.strerror or str(error)

    def clear(self, what: str) -> None:
        """It works (again)."""
        self.present.pop(what, None)

    @contextmanager
    def watch(self, what: str) -> Iterator[None]:
        """An OSError inside is noted, its absence clears."""
        try:
            yield
        except OSError as error:
            self.note(what, error)
        else:
            self.clear(what)

    def changes(self, now_ns: int) -> list[ev.Trouble]:
        """What has begun, changed or ended since the last call."""
        if self.present == self._told:
            return []
        over = [ev.Trouble(what, None, now_ns) for what in self._told if what not in self.present]
        new = [ev.Trouble(w, words, now_ns) for w, words in self.present.items() if self._told.get(w) != words]
        self._told = dict(self.present)
        return over + new
