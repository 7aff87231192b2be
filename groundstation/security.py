"""Who is believed on the ground's end of the link.

With a key set, a frame counts only with a good signature; RADIO_STATUS alone is excepted, because radios cannot sign
it, and it feeds nothing but the display of signal strength. What is kept out is counted and reported.
"""

from daq.contract.mavlink_codec import RADIO_STATUS_ID, Frame
from daq.contract.signing import Signer, Verdict, load_key
from groundstation import events as ev
from groundstation.link_config import LinkConfig
from groundstation.timeline import NS, Clock

REPORT_EVERY_NS = 5 * NS
_MAX_SENDERS = 256


def make_signer(config: LinkConfig, clock: Clock) -> Signer | None:
    """The signer of a configuration; None without a key. Raises SigningError for a key that cannot be used."""
    if config.key_file is None:
        return None
    state = config.signing_state or config.key_file.with_name(config.key_file.name + ".ground-state")
    return Signer(load_key(config.key_file), clock.utc_ns, link_id=2, state_path=state)


class Gate:
    """Lets frames through or not, and reports at most every five seconds for each sender and reason."""

    def __init__(self, signer: Signer | None) -> None:
        self.signer = signer
        self.rejected = 0
        self._reported_ns: dict[tuple[int, int, Verdict], int] = {}
        self._counts: dict[tuple[int, int, Verdict], int] = {}

    def judge(self, frame: Frame, now_ns: int) -> tuple[bool, ev.Refused | None]:
        """Whether to use a frame, and a report when one is due."""
        if self.signer is None or frame.msg_id == RADIO_STATUS_ID:
            return True, None
        verdict = self.signer.judge(frame.signed_part, (frame.system, frame.component), frame.signature)
        if verdict.accepted:
            return True, None
        self.rejected += 1
        key = (frame.system, frame.component, verdict)
        if key not in self._counts and len(self._counts) >= _MAX_SENDERS:
            return False, None
        self._counts[key] = self._counts.get(key, 0) + 1
        if now_ns - self._reported_ns.get(key, now_ns - REPORT_EVERY_NS) < REPORT_EVERY_NS:
            return False, None
        self._reported_ns[key] = now_ns
        count, self._counts[key] = self._counts[key], 0
        return False, ev.Refused(frame.system, frame.component, frame.name, verdict.value, count, now_ns)
