"""Received data that is not used or not trusted, and failing ports and files of the ground station: counted and reported.

Findings are of four kinds. *Refused*: a frame without a valid signature. *Doubted*: a statement that an aircraft, or an impostor,
cannot truthfully make. *Quarantined*: a value of a wrong type or range (a calibration fact `nan`), or data on which our own code
failed; the latter is the last line of defence, and a mistake of ours. *Contested*: a frame of a second sender for an aircraft
that another sender is already heard as.
"""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from daq.utilities.plain_words import one_line
from groundstation.receiver import events as ev
from groundstation.receiver.events import ReceptionFindingKind
from groundstation.receiver.timeline import NS

REPORT_EVERY_NS = 5 * NS

# Subjects of doubted data, as reports and `ground --json` show them:
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
"""System id of findings that concern no aircraft in particular."""
MAX_NAMES = 200
"""Quarantined subjects, of all senders, that are reported by name, a line in the log each; further ones count as OTHERS."""
OTHERS = "further things of senders"
LONGEST_WHY = 300  # characters of a subject or reason
_MAX_REFUSED = 256  # subjects, so that strangers cannot fill the memory
_MAX_SECOND_SENDERS = 16  # of one aircraft, for the same reason


@dataclass
class _FindingRow:
    """Count of one finding. unreported: of these, since the last report; reported_ns: time of that, None before the first."""

    subject: str
    detail: str
    used: bool = False
    count: int = 0
    unreported: int = 0
    reported_ns: int | None = None


class ReceptionFindings:
    """Counts by kind, system id and subject. Each is reported at once, then at most every REPORT_EVERY_NS."""

    def __init__(self) -> None:
        self._rows: dict[ReceptionFindingKind, dict[tuple[int, str], _FindingRow]] = {
            kind: {} for kind in ReceptionFindingKind
        }
        self._second_senders: Counter[int] = Counter()

    def doubt(self, system: int, what: str, count: int = 1) -> None:
        """Count data that was not believed; a count of 0 does nothing."""
        if count:
            self._count(ReceptionFindingKind.DOUBTED, system, what, what, "", count)

    def refuse(self, system: int, component: int, message: str, why: str) -> None:
        """Count a frame that is not used because of its signature."""
        rows, key = self._rows[ReceptionFindingKind.REFUSED], f"{component} {why}"
        if (system, key) in rows or len(rows) < _MAX_REFUSED:
            self._count(ReceptionFindingKind.REFUSED, system, key, message, why).subject = message

    def contest(self, system: int, sender: str, heard_from: str, *, used: bool) -> None:
        """Count a frame of a second sender. used: whether it was used, since it came by another port."""
        if (system, sender) not in self._rows[ReceptionFindingKind.CONTESTED]:
            if self._second_senders[system] < _MAX_SECOND_SENDERS:
                self._second_senders[system] += 1
            else:
                sender = "further senders"
        row = self._count(ReceptionFindingKind.CONTESTED, system, sender, sender, heard_from)
        row.detail, row.used = heard_from, used

    def quarantine(self, system: int, what: str, why: str) -> None:
        """Count data of a sender that is not used, and why; reported the first time only."""
        rows, key = self._rows[ReceptionFindingKind.QUARANTINED], one_line(what, LONGEST_WHY)
        if (system, key) not in rows and len(rows) >= MAX_NAMES:
            key, why = OTHERS, f"more than {MAX_NAMES} of them were refused"
        self._count(ReceptionFindingKind.QUARANTINED, system, key, key, one_line(why, LONGEST_WHY))

    def quarantine_error(self, system: int, what: str, error: Exception) -> None:
        """Count data of a sender on which our own code raised `error`."""
        self.quarantine(system, what, f"{type(error).__name__}: {error}")

    @contextmanager
    def guard(self, system: int, what: str) -> Iterator[None]:
        """A context in which every exception is quarantined, so that no received data ends the session."""
        try:
            yield
        except Exception as error:  # noqa: BLE001  whatever a sender's data may cause
            self.quarantine_error(system, what, error)

    def _count(
        self, kind: ReceptionFindingKind, system: int, key: str, subject: str, detail: str, count: int = 1
    ) -> _FindingRow:
        row = self._rows[kind].setdefault((system, key), _FindingRow(subject, detail))
        row.count += count
        row.unreported += count
        return row

    def reports(self, now_ns: int, *kinds: ReceptionFindingKind) -> list[ev.ReceptionFinding]:
        """The findings of some kinds that are due at `now_ns`, with the counts since their last report."""
        reports = []
        for kind in kinds:
            for (system, _), row in self._rows[kind].items():
                if not row.unreported:
                    continue
                first = row.reported_ns is None
                if row.reported_ns is not None and (
                    kind is ReceptionFindingKind.QUARANTINED or now_ns - row.reported_ns < REPORT_EVERY_NS
                ):
                    continue
                reports.append(
                    ev.ReceptionFinding(
                        kind, system, row.subject, row.detail, row.unreported, now_ns, used=row.used, first=first
                    )
                )
                row.reported_ns, row.unreported = now_ns, 0
        return reports

    def total_doubted(self, what: str) -> int:
        """Count of one subject of doubt, of all senders."""
        return sum(row.count for (_, key), row in self._rows[ReceptionFindingKind.DOUBTED].items() if key == what)

    def doubted(self) -> list[dict[str, str | int]]:
        """All doubts, as `ground --json` lists them."""
        rows = self._rows[ReceptionFindingKind.DOUBTED].items()
        return [{"system": system, "what": what, "count": row.count} for (system, what), row in rows]

    def quarantined(self) -> list[dict[str, str | int]]:
        """All quarantined subjects, as `ground --json` lists them."""
        rows = self._rows[ReceptionFindingKind.QUARANTINED].items()
        return [{"system": s, "what": what, "why": row.detail, "count": row.count} for (s, what), row in rows]

    def second_senders(self, aircraft: int) -> list[dict[str, str | int | bool]]:
        """Second senders of an aircraft, as `ground --json` lists them; frames: number of unused ones."""
        return [
            {
                "system": system,
                "sender": sender,
                "heard_from": row.detail,
                "used": row.used,
                "frames": 0 if row.used else row.count,
            }
            for (system, sender), row in self._rows[ReceptionFindingKind.CONTESTED].items()
            if system == aircraft
        ]


class Faults:
    """Ports and files of the ground station that fail at present, with the system's message. Each change is one `Trouble`
    event."""

    def __init__(self) -> None:
        self.present: dict[str, str] = {}
        self._reported: dict[str, str] = {}

    def note(self, what: str, error: OSError) -> None:
        """Record that `what` fails with an error."""
        self.present[what] = error.strerror or str(error)

    def clear(self, what: str) -> None:
        """Record that `what` works (again)."""
        self.present.pop(what, None)

    @contextmanager
    def watch(self, what: str) -> Iterator[None]:
        """A context that records an OSError inside, and clears `what` without one."""
        try:
            yield
        except OSError as error:
            self.note(what, error)
        else:
            self.clear(what)

    def changes(self, now_ns: int) -> list[ev.Trouble]:
        """Events for the faults that began, changed or ended since the last call."""
        if self.present == self._reported:
            return []
        events = [ev.Trouble(what, None, now_ns) for what in self._reported if what not in self.present]
        new = [ev.Trouble(w, words, now_ns) for w, words in self.present.items() if self._reported.get(w) != words]
        self._reported = dict(self.present)
        return events + new


def legible(text: str) -> str:
    """Received text as one line that is safe for a terminal and a log: each control character (line breaks, escape sequences) or
    invisible one (of the direction of reading) becomes a replacement character."""
    return "".join(c if c.isprintable() else "\ufffd" for c in text)
