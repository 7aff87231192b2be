"""What aircraft, or somebody in their place, say and is not believed: counted always, told now and then."""

from dataclasses import dataclass

from groundstation.receiver import events as ev
from groundstation.receiver.timeline import NS

REPORT_EVERY_NS = 5 * NS

NUMBERS = "scans whose number or time it cannot have reached"
REPORTS = "reports of scan numbers it cannot have reached"
RESTARTS = "restarts, more than an aircraft makes"
AIRCRAFT = "frames of further aircraft, more than can be served"
BYTES = "bytes of strangers, more than they are allowed"
DATAGRAMS = "datagrams dropped by this computer, because more came than it could take"
PAPERS = "papers of a recording that are none"
TEXTS = "texts and events, more than there is time to read"
EVENTS = "events, more than a flight has"


NOBODY = 0
"""System id for what is no aircraft's in particular."""


@dataclass
class _Count:
    whole: int = 0
    untold: int = 0
    told_ns: int | None = None


class Doubts:
    """Counts by aircraft and kind; every one of them is in a report sooner or later, a report at most every five seconds."""

    def __init__(self) -> None:
        self._counts: dict[tuple[int, str], _Count] = {}  # as many as system ids and kinds: both are few

    def note(self, system: int, what: str, count: int = 1) -> None:
        """Something was not believed; with count 0 nothing was."""
        if not count:
            return
        found = self._counts.setdefault((system, what), _Count())
        found.whole += count
        found.untold += count

    def total(self, what: str) -> int:
        """How often a kind has come."""
        return sum(c.whole for (_, kind), c in self._counts.items() if kind == what)

    def table(self) -> list[dict[str, str | int]]:
        """All counts, as `ground --json` lists them."""
        return [{"system": s, "what": what, "count": c.whole} for (s, what), c in self._counts.items()]

    def reports(self, now_ns: int) -> list[ev.Doubted]:
        """What is due to be told."""
        out = []
        for (system, what), count in self._counts.items():
            if count.untold and (count.told_ns is None or now_ns - count.told_ns >= REPORT_EVERY_NS):
                out.append(ev.Doubted(system, what, count.untold, now_ns))
                count.told_ns, count.untold = now_ns, 0
        return out
