"""Who is believed on the ground's end of the link.

With a key set, a frame counts only with a good signature; RADIO_STATUS alone is excepted, because radios cannot sign
it, and it feeds nothing but the display of signal strength. What is kept out is counted and reported.
"""

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

from daq.transport.mavlink_codec import RADIO_STATUS_ID, MavlinkFrame
from daq.transport.signing import SignatureVerdict, Signer, load_key
from groundstation.receiver import events as ev
from groundstation.receiver.faults import Faults
from groundstation.receiver.link_config import LinkConfig
from groundstation.receiver.timeline import NS, GroundClock

REPORT_EVERY_NS = 5 * NS
SAVE_NS = NS
"""Signing timestamps are on disk no later than this, and the time one save takes: so much recorded radio traffic counts
once more after a crash of the ground station."""
SIGNING_STATE = "signing state"
_MAX_SENDERS = 256


def make_signer(config: LinkConfig, clock: GroundClock) -> Signer | None:
    """The signer of a configuration; None without a key. Raises SigningError for a key that cannot be used."""
    if config.key_file is None:
        return None
    state = config.signing_state or config.key_file.with_name(config.key_file.name + ".ground-state")
    return Signer(load_key(config.key_file), clock.utc_ns, link_id=2, state_path=state)


class SignatureGate:
    """Lets frames through or not, and reports at most every five seconds for each sender and reason, all of them in time."""

    def __init__(self, signer: Signer | None, faults: Faults | None = None) -> None:
        self.signer = signer
        self._faults = faults or Faults()
        self._worker: ThreadPoolExecutor | None = None
        self._saving: Future[None] | None = None
        self._next_save_ns = 0
        self.rejected = 0
        self._senders: dict[tuple[int, int, SignatureVerdict], _Refusals] = {}

    def allows(self, frame: MavlinkFrame) -> bool:
        """Whether to use a frame."""
        if self.signer is None or frame.msg_id == RADIO_STATUS_ID:
            return True
        verdict = self.signer.judge(frame.signed_part, (frame.system, frame.component), frame.signature)
        if verdict.accepted:
            return True
        self.rejected += 1
        key = (frame.system, frame.component, verdict)
        if key in self._senders or len(self._senders) < _MAX_SENDERS:
            refusals = self._senders.setdefault(key, _Refusals())
            refusals.count += 1
            refusals.message = frame.name
        return False

    def keep_state(self, now_ns: int) -> None:
        """Save signing timestamps when it is time, in a thread: a disk may be slow, and nobody here waits for it."""
        if self.signer is None or now_ns < self._next_save_ns or not self._saved():
            return
        self._next_save_ns = now_ns + SAVE_NS
        if self.signer.needs_saving():
            if self._worker is None:
                self._worker = ThreadPoolExecutor(1, thread_name_prefix="signing-state")
            self._saving = self._worker.submit(self.signer.save)

    def _saved(self) -> bool:
        """Whether the last save is over; what it met goes to the faults."""
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

    def reports(self, now_ns: int) -> list[ev.Refused]:
        """What has been refused and is due to be told."""
        out = []
        for (system, component, verdict), r in self._senders.items():
            if r.count and (r.told_ns is None or now_ns - r.told_ns >= REPORT_EVERY_NS):
                out.append(ev.Refused(system, component, r.message, verdict.value, r.count, now_ns))
                r.told_ns, r.count = now_ns, 0
        return out


@dataclass
class _Refusals:
    count: int = 0
    message: str = ""
    told_ns: int | None = None
