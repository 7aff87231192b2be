"""A link that damages 0.1 to 10 % of all frames: does the ground lose exactly those, and have everything after backfill?

Run: python -m tests.studies.damaged_link [MINUTES]. The last result is kept in docs/link.md.
"""

import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from daq.contract.recordings.reading import join
from daq.contract.recordings.segments import read_segments
from daq.contract.scan import encode_scan
from daq.transport.mavlink_codec import FrameDecoder, MavlinkFrame
from groundstation.receiver.ports import LinkConfig
from tests.support.link_rig import Rig, quiet_scan

KINDS = ("flip", "dropped byte", "burst", "all and copies")
SHARES = (0.001, 0.01, 0.1)
BURST = 150  # bytes: more than one frame


@dataclass
class DamagingLink:
    """Damages frames one way and counts them. A burst runs on into the next frames; `copies` frames come twice."""

    kind: str
    share: float
    rng: np.random.Generator
    copies: float = 0.0
    frames: int = 0
    damaged: int = 0
    copied: int = 0
    _splitter: FrameDecoder = field(default_factory=FrameDecoder)
    _burst: int = 0

    def __call__(self, data: bytes) -> bytes:
        found = [item.raw for item in self._splitter.feed(data) if isinstance(item, MavlinkFrame)]
        assert sum(map(len, found)) == len(data), "the aircraft's own stream is not whole frames"
        return b"".join(self._through(raw) for raw in found)

    def _through(self, raw: bytes) -> bytes:
        self.frames += 1
        if self._burst:
            gone, self._burst = min(self._burst, len(raw)), max(0, self._burst - len(raw))
            self.damaged += 1
            return raw[gone:]
        if self.rng.random() >= self.share:
            if self.rng.random() < self.copies:
                self.copied += 1
                return raw + raw
            return raw
        self.damaged += 1
        at = int(self.rng.integers(len(raw) - 5)) + 5  # behind the header's first bytes, which the next frame has too
        kind = self.kind if self.kind in KINDS[:3] else KINDS[int(self.rng.integers(3))]
        if kind == "flip":
            return raw[:at] + bytes([raw[at] ^ 1 << int(self.rng.integers(8))]) + raw[at + 1 :]
        if kind == "dropped byte":
            return raw[:at] + raw[at + 1 :]
        self._burst = max(0, BURST - (len(raw) - at))
        return raw[:at]


@dataclass(frozen=True)
class Outcome:
    """Frames: sent by the aircraft, damaged on the way, lost by the books, copies made and seen; scans likewise."""

    frames: int
    damaged: int
    frames_received: int
    frames_lost: int
    copied: int
    duplicates: int
    scans_sent: int
    scans_received: int
    scans_lost: int
    agreed: bool
    identical: bool

    def exact(self) -> bool:
        """Whether every book closes."""
        return (
            self.frames_lost == self.damaged
            and self.frames_received == self.frames - self.damaged + self.copied
            and self.duplicates == self.copied
            and self.scans_sent == self.scans_received + self.scans_lost
            and self.agreed
            and self.identical
        )


def fly(kind: str, share: float, scans: int, seed: int, folder: Path) -> Outcome:
    """One flight over such a link, both ways, backfill to the end, and the books."""
    rng = np.random.default_rng(seed)
    down = DamagingLink(kind, share, np.random.default_rng([seed, 1]), copies=share if kind == KINDS[3] else 0.0)
    up = DamagingLink(kind, share, np.random.default_rng([seed, 2]))
    rig = Rig(folder, down=down, up=up, ground=LinkConfig(ports=("memory",), backfill="lost"))
    rig.fly(scans, lambda n: quiet_scan(n, rng, time_ns=rig.clock.monotonic_ns()))
    rig.ground.set_backfill("all")
    rig.rest(8 * 3600, until=lambda: rig.ground.backfill_agreed(1))
    agreed = rig.ground.backfill_agreed(1)
    down.share = down.copies = 0.0
    down._burst = 0
    rig.rest(12)  # a last frame that was damaged shows only when another comes
    (books,) = rig.ground.accounting()
    (path,) = rig.ground.write_recordings()
    kept = [e.data for e in join(path, read_segments(path)).entries if e.topic == "/scan"]
    summary = rig.ground.summary()
    rig.close()
    return Outcome(
        frames=down.frames,
        damaged=down.damaged,
        frames_received=summary["frames_received"],
        frames_lost=summary["frames_lost"],
        copied=down.copied,
        duplicates=summary["duplicates"],
        scans_sent=len(rig.link.downlink.sent),
        scans_received=books.received,
        scans_lost=books.lost_count,
        agreed=agreed,
        identical=kept == [encode_scan(s) for s in rig.scans.values()],
    )


def main(minutes: float) -> None:
    print(
        "damage           share  frames  damaged    lost  copies  repeated  scans sent  received  lost  after backfill"
    )
    for kind in KINDS:
        for share in SHARES:
            with tempfile.TemporaryDirectory() as folder:
                o = fly(kind, share, round(minutes * 1200), seed=5, folder=Path(folder))
            frames = f"{o.frames:7d} {o.damaged:8d} {o.frames_lost:7d} {o.copied:7d} {o.duplicates:9d}"
            end = ("identical" if o.identical else "DIFFERENT") + ("" if o.exact() else "  BOOKS DO NOT CLOSE")
            scans = f"{o.scans_sent:11d} {o.scans_received:9d} {o.scans_lost:5d}"
            print(f"{kind:<15} {100 * share:5.1f} % {frames} {scans}  {end}", flush=True)


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 30.0)
