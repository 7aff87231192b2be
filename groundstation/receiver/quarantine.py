"""What a sender's words would break: kept out, counted, told once by name, and never a reason to end reception.

Two kinds come here: values that the check of their type and range refuses (a calibration fact `nan`), and whatever else
fails while something of a sender is used. The second is the last line of defence, and a mistake of ours.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from daq.contract.plain_words import one_line
from groundstation.receiver import events as ev

MAX_NAMES = 200
"""Names that are told one by one, of all senders: each is a line in the log. What comes beyond is counted as OTHERS."""
OTHERS = "further things of senders"
LONGEST_WHY = 300  # characters


@dataclass
class _QuarantineRow:
    why: str
    count: int = 0
    shown: bool = False


class Quarantine:
    """Counts by system id and name."""

    def __init__(self) -> None:
        self._rows: dict[tuple[int, str], _QuarantineRow] = {}

    def put(self, system: int, what: str, why: str) -> None:
        """Something of a sender that is not used, and why."""
        key = (system, one_line(what, LONGEST_WHY))
        if key not in self._rows and len(self._rows) >= MAX_NAMES:
            key, why = (system, OTHERS), f"more than {MAX_NAMES} of them were refused"
        self._rows.setdefault(key, _QuarantineRow(one_line(why, LONGEST_WHY))).count += 1

    def put_error(self, system: int, what: str, error: Exception) -> None:
        """Something of a sender at which our own work failed."""
        self.put(system, what, f"{type(error).__name__}: {error}")

    @contextmanager
    def guard(self, system: int, what: str) -> Iterator[None]:
        """Nothing that fails inside ends the session: it is put here, and the next thing is done."""
        try:
            yield
        except Exception as error:  # noqa: BLE001  the edge of reception: no words of a sender end a flight
            self.put_error(system, what, error)

    def reports(self, now_ns: int) -> list[ev.Quarantined]:
        """What has not been told yet."""
        new = [(key, row) for key, row in self._rows.items() if not row.shown]
        for _, row in new:
            row.shown = True
        return [ev.Quarantined(system, what, row.why, now_ns) for (system, what), row in new]

    def table(self) -> list[dict[str, str | int]]:
        """All of them, as `ground --json` lists them."""
        return [{"system": s, "what": w, "why": r.why, "count": r.count} for (s, w), r in self._rows.items()]
