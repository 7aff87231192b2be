"""Who speaks for an aircraft: without a key the one that was heard first, for as long as it is heard.

A second sender of the same port is either somebody else, or the aircraft behind a new address. Its frames are kept in the
telemetry log, counted and told, but not used until the first has been silent for a while. Another port is another radio of
this ground station: an aircraft may be heard by both, which is told once. Components of an aircraft that send by themselves
(an autopilot beside the logger) are told apart; the logger's own messages have one sender on a port.
"""

from dataclasses import dataclass

from groundstation.receiver import events as ev
from groundstation.receiver.frame_input import Sender
from groundstation.receiver.timeline import NS

SILENCE_NS = 3 * NS
"""So long an aircraft must not have been heard before another address is believed: three heartbeats."""
REPORT_EVERY_NS = 5 * NS
_MAX_RIVALS = 16
_LOGGER = None  # the role of the logger's own messages, beside the components'


@dataclass
class _Speaker:
    sender: Sender
    heard_ns: int


@dataclass
class _Rival:
    heard_from: str
    used: bool
    whole: int = 0
    untold: int = 0
    told_ns: int | None = None


_MOST_USUAL = 64


class Senders:
    """The speakers of one aircraft."""

    def __init__(self, system: int) -> None:
        self.system = system
        self._speakers: dict[tuple[int | None, str], _Speaker] = {}  # by role and port; 257 roles at most
        self._rivals: dict[str, _Rival] = {}
        self._usual: dict[tuple[Sender, int, bool], tuple[_Speaker, ...]] = {}  # who spoke before, and is who it was
        self.contested = 0

    def allows(self, sender: Sender, component: int, own: bool, now_ns: int) -> bool:
        """Whether a frame may be used. own: it is one of the logger's own messages."""
        usual = self._usual.get((sender, component, own))
        if usual is not None:
            for known in usual:
                known.heard_ns = now_ns
            return True
        port = sender.port
        roles = ((component, port), (_LOGGER, port)) if own else ((component, port),)
        speakers = [self._speakers.get(role) for role in roles]
        for speaker in speakers:
            if speaker is not None and speaker.sender != sender and now_ns - speaker.heard_ns < SILENCE_NS:
                self.contested += 1
                self._note(sender, speaker.sender, used=False)
                return False
        if own and (_LOGGER, sender.port) not in self._speakers:
            self._note_second_port(sender, now_ns)
        for role, speaker in zip(roles, speakers, strict=True):
            if speaker is None or speaker.sender != sender:
                self._speakers[role] = _Speaker(sender, now_ns)
                self._usual.clear()  # who is replaced is no usual speaker any more
            else:
                speaker.heard_ns = now_ns
        if len(self._usual) < _MOST_USUAL:
            self._usual[sender, component, own] = tuple(self._speakers[role] for role in roles)
        return True

    def speaks(self, sender: Sender, now_ns: int) -> None:
        """Its signature says who it is: no question."""
        self._speakers[_LOGGER, sender.port] = _Speaker(sender, now_ns)
        self._usual.clear()

    def speaker(self, port: str) -> Sender | None:
        """Who sends the logger's own messages by a port at present."""
        found = self._speakers.get((_LOGGER, port))
        return None if found is None else found.sender

    def _note_second_port(self, sender: Sender, now_ns: int) -> None:
        for (role, _), speaker in self._speakers.items():
            if role is _LOGGER and now_ns - speaker.heard_ns < SILENCE_NS:
                self._note(sender, speaker.sender, used=True)
                return

    def _note(self, sender: Sender, heard_from: Sender, *, used: bool) -> None:
        name = sender.name if sender.name in self._rivals or len(self._rivals) < _MAX_RIVALS else "further senders"
        rival = self._rivals.setdefault(name, _Rival(heard_from.name, used))
        rival.heard_from, rival.used = heard_from.name, used
        rival.whole += 1
        rival.untold += 1

    def reports(self, now_ns: int) -> list[ev.Contested]:
        """What is due to be told."""
        out = []
        for name, r in self._rivals.items():
            if r.untold and (r.told_ns is None or now_ns - r.told_ns >= REPORT_EVERY_NS):
                out.append(ev.Contested(self.system, name, r.heard_from, r.untold, r.used, r.told_ns is None, now_ns))
                r.told_ns, r.untold = now_ns, 0
        return out

    def table(self) -> list[dict[str, str | int | bool]]:
        """Second senders as `ground --json` lists them; frames: how many were not used."""
        return [
            {
                "system": self.system,
                "sender": name,
                "heard_from": r.heard_from,
                "used": r.used,
                "frames": 0 if r.used else r.whole,
            }
            for name, r in self._rivals.items()
        ]
