"""Senders whose frames the ground station uses: with a signing key those with valid signatures, else the first of each aircraft.

With a key, frames need a valid signature; except RADIO_STATUS, which radios cannot sign and which affects the display of signal
strength only. Without a key, a second sender on the same port is an impostor, or the aircraft with a new address. Its frames are
logged, counted and reported, but not used until the first sender has been silent for SILENCE_NS. Another port is another radio
of this ground station; an aircraft may be received by both, which is reported once. Components of an aircraft that send
themselves (an autopilot beside the logger) may have different senders; the logger's own messages have one on each port.
"""

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

from daq.transport.mavlink_codec import RADIO_STATUS_ID, MavlinkFrame
from daq.transport.signing import Signer, load_key
from groundstation.receiver.findings import Faults, ReceptionFindings
from groundstation.receiver.frame_input import Sender
from groundstation.receiver.ports import LinkConfig
from groundstation.receiver.timeline import NS, GroundClock

SAVE_NS = NS
"""Time between two saves of the signing timestamps. After a crash of the ground station, recorded frames of that time, and of the
duration of a save, can be replayed."""
SIGNING_STATE = "signing state"
SILENCE_NS = 3 * NS
"""Silence of the first sender, after which another is accepted: three heartbeats."""
_LOGGER = None  # role of the logger's own messages; the other roles are component ids
_MAX_CONFIRMED = 64  # senders, so that strangers cannot fill the memory


def make_signer(config: LinkConfig, clock: GroundClock) -> Signer | None:
    """The signer of a configuration; None without a key. Raises SigningError for a key that cannot be used."""
    if config.key_file is None:
        return None
    state = config.signing_state or config.key_file.with_name(config.key_file.name + ".ground-state")
    return Signer(load_key(config.key_file), clock.utc_ns, link_id=2, state_path=state)


class SignatureGate:
    """Rejects frames without a valid signature, where there is a key. rejected: their number."""

    def __init__(self, signer: Signer | None, faults: Faults, findings: ReceptionFindings) -> None:
        self.signer = signer
        self._faults = faults
        self._findings = findings
        self._worker: ThreadPoolExecutor | None = None
        self._saving: Future[None] | None = None
        self._next_save_ns = 0
        self.rejected = 0

    def allows(self, frame: MavlinkFrame) -> bool:
        """Whether a frame may be used; a rejected one is counted as a finding."""
        if self.signer is None or frame.msg_id == RADIO_STATUS_ID:
            return True
        verdict = self.signer.judge(frame.signed_part, (frame.system, frame.component), frame.signature)
        if verdict.accepted:
            return True
        self.rejected += 1
        self._findings.refuse(frame.system, frame.component, frame.name, verdict.value)
        return False

    def keep_state(self, now_ns: int) -> None:
        """Save signing timestamps every SAVE_NS, in a thread, since a disk may be slow."""
        if self.signer is None or now_ns < self._next_save_ns or not self._saved():
            return
        self._next_save_ns = now_ns + SAVE_NS
        if self.signer.needs_saving():
            if self._worker is None:
                self._worker = ThreadPoolExecutor(1, thread_name_prefix="signing-state")
            self._saving = self._worker.submit(self.signer.save)

    def _saved(self) -> bool:
        """Whether no save is running; an error of the last one becomes a fault."""
        if self._saving is not None and self._saving.done():
            with self._faults.watch(SIGNING_STATE):
                self._saving.result()
            self._saving = None
        return self._saving is None

    def close(self) -> None:
        """End the thread and save once more."""
        if self._worker is not None:
            self._worker.shutdown(wait=True)
            self._worker = None
        if self.signer is not None:
            with self._faults.watch(SIGNING_STATE):
                self.signer.save()


@dataclass
class _Speaker:
    """The accepted sender in a role, and when it was last heard [ns]."""

    sender: Sender
    heard_ns: int


class Senders:
    """The accepted senders of one aircraft, by role and port. contested: number of frames of others."""

    def __init__(self, system: int, findings: ReceptionFindings) -> None:
        self.system = system
        self._findings = findings
        self._speakers: dict[tuple[int | None, str], _Speaker] = {}  # by role and port; 257 roles at most
        self._confirmed: dict[tuple[Sender, int, bool], tuple[_Speaker, ...]] = {}  # cache of accepted frames' senders
        self.contested = 0

    def confirmed(self, sender: Sender, component: int, is_own_message: bool, now_ns: int) -> bool:
        """Whether the cache shows a frame's sender to be accepted in its roles; where it does not, `allows` decides."""
        speakers = self._confirmed.get((sender, component, is_own_message), ())
        for speaker in speakers:
            speaker.heard_ns = now_ns
        return bool(speakers)

    def allows(self, sender: Sender, component: int, is_own_message: bool, now_ns: int) -> bool:
        """Whether a frame of a sender that is not `confirmed` may be used. is_own_message: whether it is one of the logger's."""
        port = sender.port
        roles = ((component, port), (_LOGGER, port)) if is_own_message else ((component, port),)
        speakers = [self._speakers.get(role) for role in roles]
        for speaker in speakers:
            if speaker is not None and speaker.sender != sender and now_ns - speaker.heard_ns < SILENCE_NS:
                self.contested += 1
                self._findings.contest(self.system, sender.name, speaker.sender.name, used=False)
                return False
        if is_own_message and (_LOGGER, sender.port) not in self._speakers:
            self._report_second_port(sender, now_ns)
        for role, speaker in zip(roles, speakers, strict=True):
            if speaker is None or speaker.sender != sender:
                self._speakers[role] = _Speaker(sender, now_ns)
                self._confirmed.clear()  # the replaced sender is no longer accepted
            else:
                speaker.heard_ns = now_ns
        if len(self._confirmed) < _MAX_CONFIRMED:
            self._confirmed[sender, component, is_own_message] = tuple(self._speakers[role] for role in roles)
        return True

    def accept_signed(self, sender: Sender, now_ns: int) -> None:
        """Accept a sender of the logger's messages, whose signature is valid."""
        self._speakers[_LOGGER, sender.port] = _Speaker(sender, now_ns)
        self._confirmed.clear()

    def speaker(self, port: str) -> Sender | None:
        """The accepted sender of the logger's messages on a port; None without one."""
        speaker = self._speakers.get((_LOGGER, port))
        return None if speaker is None else speaker.sender

    def _report_second_port(self, sender: Sender, now_ns: int) -> None:
        """Report a sender that is heard on another port than the present one."""
        for (role, _), speaker in self._speakers.items():
            if role is _LOGGER and now_ns - speaker.heard_ns < SILENCE_NS:
                self._findings.contest(self.system, sender.name, speaker.sender.name, used=True)
                return
