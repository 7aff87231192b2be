"""What waits to be sent, in order of importance, at the pace the radio can carry.

Frames are numbered and signed only when their turn has come, so a frame that is dropped here leaves no gap in the
sequence that the ground would take for a loss on the link.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from daq.transport.mavlink_codec import FrameEncoder, message_by_name
from daq.transport.ports import BytePort

_URGENT_ROOM = 32
_LOW_ROOM = 64
_BUCKET_S = 0.25
_LEAST_BUCKET = 300.0
NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Item:
    """A message to send."""

    msg_id: int
    payload: bytes
    on_sent: Callable[[], None] | None = None
    on_dropped: Callable[[], None] | None = None


def item(name: str, **values: object) -> Item:
    """A message of the dialect by name and fields."""
    made = message_by_name()[name]
    return Item(made.msg_id, made.pack(values))


class Outbox:
    """Sends through a port that never waits, within a byte budget.

    Four classes: urgent (heartbeat, acknowledgements, texts) regardless of the budget; scans; low (slow reports);
    bulk (backfill, log download), made on demand when half of the budget's reserve is unused.
    """

    def __init__(self, port: BytePort, encoder: FrameEncoder, budget_bytes_per_s: float, scan_room: int) -> None:
        self._port = port
        self._encoder = encoder
        self._budget = budget_bytes_per_s
        self._tokens = 0.0
        self._last_ns: int | None = None
        self._urgent: deque[Item] = deque(maxlen=_URGENT_ROOM)
        self._scans: deque[Sequence[Item]] = deque()
        self._scan_room = scan_room
        self._low: deque[Item] = deque(maxlen=_LOW_ROOM)
        self._partial = b""
        self._current: Item | None = None
        self._following: deque[Item] = deque()
        self.bulk: Callable[[], Item | None] = lambda: None
        self.bytes_sent = 0
        self.frames_sent = 0
        self.scans_dropped = 0

    @property
    def budget(self) -> float:
        """Bytes a second."""
        return self._budget

    @budget.setter
    def budget(self, value: float) -> None:
        self._budget = value

    def put_urgent(self, message: Item) -> None:
        """Send before everything else."""
        self._urgent.append(message)

    def put_scan(self, messages: Sequence[Item]) -> None:
        """Send the messages of one scan together; the oldest waiting scan is dropped and counted when there is no room."""
        self._scans.append(messages)
        while len(self._scans) > self._scan_room:
            self.scans_dropped += 1
            for message in self._scans.popleft():
                if message.on_dropped is not None:
                    message.on_dropped()

    def put_low(self, message: Item) -> None:
        """Send when nothing more important waits."""
        self._low.append(message)

    @property
    def has_low(self) -> bool:
        """Whether low-rate messages are still waiting."""
        return bool(self._low)

    def service(self, now_ns: int) -> None:
        """Send what time, budget and port allow now."""
        bucket = max(_LEAST_BUCKET, self._budget * _BUCKET_S)
        if self._last_ns is not None:
            earned = (now_ns - self._last_ns) / NS * self._budget
            self._tokens = min(bucket, self._tokens + earned)
        else:
            self._tokens = bucket
        self._last_ns = now_ns
        while self._push():
            message = self._choose(bucket)
            if message is None:
                return
            self._partial = self._encoder.frame(message.msg_id, message.payload)
            self._current = message
            self._tokens -= len(self._partial)

    def _push(self) -> bool:
        """Hand the rest of the present frame to the port; whether it is gone."""
        if self._partial:
            taken = self._port.write(self._partial)
            self.bytes_sent += taken
            self._partial = self._partial[taken:]
            if self._partial:
                return False
        if self._current is not None:
            self.frames_sent += 1
            if self._current.on_sent is not None:
                self._current.on_sent()
            self._current = None
        return True

    def _choose(self, bucket: float) -> Item | None:
        if self._urgent:
            return self._urgent.popleft()
        if self._following:
            return self._following.popleft()
        if self._tokens <= 0:
            return None
        if self._scans:
            self._following.extend(self._scans.popleft())
            return self._following.popleft()
        if self._low:
            return self._low.popleft()
        return self.bulk() if self._tokens > bucket / 2 else None
