"""Received data that is not used or not trusted, and failing ports and files of the ground station: counted and reported.

Findings are of four kinds. *Refused*: a frame without a valid signature. *Doubted*: a statement of an aircraft, or an impostor,
that cannot be true. *Quarantined*: a value of a wrong type or range (a calibration fact `nan`), or data on which Sideslip's own
code raised an exception: the last line of defence, and a bug. *Contested*: a frame of a second sender for an aircraft that is
already heard from another one.
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

# Subjects of doubted data in reports and `ground --json`:
NUMBERS = "scans whose number or time it cannot have reached"
REPORTS = "reports of scan numbers it cannot have reached"
RESTARTS = "restarts, more than an aircraft makes"
AIRCRAFT = "frames of further aircraft, more than can be served"
BYTES = "bytes of strangers, more than they are allowed"
DATAGRAMS = "datagrams dropped by this computer, because more came than it could take"
PAPERS = "invalid papers of a recording"
TEXTS = "texts and events, more than a person can read"
EVENTS = "events, more than a flight has"

NOBODY = 0
"""System id of findings that concern no aircraft in particular."""
MAX_NAMES = 200
"""Quarantined subjects, of all senders, that are reported by name, a line in the log each; further ones count as OTHERS."""
OTHERS = "further data of senders"
LONGEST_REASON = 300  # characters of a subject or reason
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

    def doubt(self, system: int, subject: str, count: int = 1) -> None:
        """Count data that are not believed; a count of 0 does nothing."""
        if count:
            self._count(ReceptionFindingKind.DOUBTED, system, subject, subject, "", count)

    def refuse(self, system: int, component: int, message: str, reason: str) -> None:
        """Count a frame that is not used because of its signature."""
        rows, key = self._rows[ReceptionFindingKind.REFUSED], f"{component} {reason}"
        if (system, key) in rows or len(rows) < _MAX_REFUSED:
            self._count(ReceptionFindingKind.REFUSED, system, key, message, reason).subject = message

    def contest(self, system: int, sender: str, heard_from: str, *, used: bool) -> None:
        """Count a frame of a second sender. used: whether it was used, since it came by another port."""
        if (system, sender) not in self._rows[ReceptionFindingKind.CONTESTED]:
            if self._second_senders[system] < _MAX_SECOND_SENDERS:
                self._second_senders[system] += 1
            else:
                sender = "further senders"
        row = self._count(ReceptionFindingKind.CONTESTED, system, sender, sender, heard_from)
        row.detail, row.used = heard_from, used

    def quarantine(self, system: int, subject: str, reason: str) -> None:
        """Count data of a sender that are not used; each subject is reported the first time only."""
        rows, key = self._rows[ReceptionFindingKind.QUARANTINED], one_line(subject, LONGEST_REASON)
        if (system, key) not in rows and len(rows) >= MAX_NAMES:
            key, reason = OTHERS, f"more than {MAX_NAMES} of them were refused"
        self._count(ReceptionFindingKind.QUARANTINED, system, key, key, one_line(reason, LONGEST_REASON))

    def quarantine_error(self, system: int, subject: str, error: Exception) -> None:
        """Count data of a sender on which Sideslip's own code raised `error`."""
        self.quarantine(system, subject, f"{type(error).__name__}: {error}")

    @contextmanager
    def guard(self, system: int, subject: str) -> Iterator[None]:
        """A context in which every exception is quarantined, so that no received data end the session."""
        try:
            yield
        except Exception as error:  # noqa: BLE001  received data may cause any
            self.quarantine_error(system, subject, error)

    def _count(
        self, kind: ReceptionFindingKind, system: int, key: str, subject: str, detail: str, count: int = 1
    ) -> _FindingRow:
        """Add to the count of one finding; returns its row."""
        row = self._rows[kind].setdefault((system, key), _FindingRow(subject, detail))
        row.count += count
        row.unreported += count
        return row

    def reports(self, now_ns: int, *kinds: ReceptionFindingKind) -> list[ev.ReceptionFinding]:
        """The findings of some kinds that are due at `now_ns`, with the counts since their last report."""
        reports = []
        for kind in kinds:
            for (system, _), row in self._rows[kind].items():
                if not row.unreported or not _is_due(kind, row.reported_ns, now_ns):
                    continue
                fields = kind, system, row.subject, row.detail, row.unreported, now_ns
                reports.append(ev.ReceptionFinding(*fields, used=row.used, first=row.reported_ns is None))
                row.reported_ns, row.unreported = now_ns, 0
        return reports

    def doubt_count(self, subject: str) -> int:
        """Count of one subject of doubt, of all senders."""
        return sum(row.count for (_, key), row in self._rows[ReceptionFindingKind.DOUBTED].items() if key == subject)

    def doubts(self) -> list[dict[str, str | int]]:
        """All doubts, as `ground --json` lists them."""
        rows = self._rows[ReceptionFindingKind.DOUBTED].items()
        return [{"system": system, "what": subject, "count": row.count} for (system, subject), row in rows]

    def quarantines(self) -> list[dict[str, str | int]]:
        """All quarantined subjects, as `ground --json` lists them."""
        rows = self._rows[ReceptionFindingKind.QUARANTINED].items()
        return [{"system": s, "what": subject, "why": row.detail, "count": row.count} for (s, subject), row in rows]

    def second_senders(self, aircraft: int) -> list[dict[str, str | int | bool]]:
        """Second senders of an aircraft, as `ground --json` lists them; frames: number of those not used."""
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


def _is_due(kind: ReceptionFindingKind, reported_ns: int | None, now_ns: int) -> bool:
    """Whether a finding may be reported again: one in quarantine never, another after REPORT_EVERY_NS."""
    if reported_ns is None:
        return True
    return kind is not ReceptionFindingKind.QUARANTINED and now_ns - reported_ns >= REPORT_EVERY_NS


class Faults:
    """Ports and files of the ground station that fail at present. present: name -> the system's message. Each change becomes one
    `Trouble` event."""

    def __init__(self) -> None:
        self.present: dict[str, str] = {}
        self._reported: dict[str, str] = {}

    def note(self, name: str, error: OSError) -> None:
        """Record that a port or file fails with an error."""
        self.present[name] = error.strerror or str(error)

    def clear(self, name: str) -> None:
        """Record that a port or file works (again)."""
        self.present.pop(name, None)

    @contextmanager
    def watch(self, name: str) -> Iterator[None]:
        """A context that records an OSError inside, and clears the fault `name` without one."""
        try:
            yield
        except OSError as error:
            self.note(name, error)
        else:
            self.clear(name)

    def changes(self, now_ns: int) -> list[ev.Trouble]:
        """Events for the faults that began, changed or ended since the last call."""
        if self.present == self._reported:
            return []
        events = [ev.Trouble(name, None, now_ns) for name in self._reported if name not in self.present]
        new = [ev.Trouble(n, words, now_ns) for n, words in self.present.items() if self._reported.get(n) != words]
        self._reported = dict(self.present)
        return events + new


def legible(text: str) -> str:
    """Received text as one line that is safe for a terminal and a log: each control character (line breaks, escape sequences) or
    invisible one (of the direction of reading) becomes a replacement character."""
    return "".join(c if c.isprintable() else "\ufffd" for c in text)
