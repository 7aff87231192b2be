"""Send queue of the radio link: messages by priority, at the rate the radio can carry.

Frames get their sequence number and signature when they are sent, so that a message dropped here leaves no gap in the sequence,
which the ground would take for a loss on the link.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from daq.transport.mavlink_codec import CHECKSUM_BYTES, HEADER_BYTES, FrameEncoder, message_by_name
from daq.transport.ports import BytePort
from daq.transport.signing import SIGNATURE_BYTES

_URGENT_ROOM = 32  # messages, as the three below
_LOW_ROOM = 64
_ANSWER_ROOM = 16
_REQUESTED_ROOM = 8
ANSWER_SHARE = 0.15
"""Share of the budget that acknowledgements may take before scans, and requested messages before bulk: what the default budget,
1636 bytes/s, leaves beside 1391 bytes/s of signed scans and heartbeats."""
_BUCKET_S = 0.25  # seconds of the budget that may be sent in a burst
_LEAST_BUCKET = 300.0  # bytes: more than the longest frame (280)
FRAMING_BYTES = HEADER_BYTES + CHECKSUM_BYTES + SIGNATURE_BYTES
NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Item:
    """A message to send. on_sent, on_dropped: called once the port has taken it, or when the queue drops it."""

    msg_id: int
    payload: bytes
    on_sent: Callable[[], None] | None = None
    on_dropped: Callable[[], None] | None = None


def item(name: str, /, **values: object) -> Item:
    """A message of the dialect by name and fields."""
    message_type = message_by_name()[name]
    return Item(message_type.msg_id, message_type.pack(values))


class SendQueue:
    """Sends through a port that never blocks, within a byte budget. scan_room: scans that may wait.

    Six classes: urgent (heartbeat, texts, events) regardless of the budget; acknowledgements within a share of it; scans; low
    (slow reports); requested messages within a share; and bulk (backfill, log download), made on demand when more than half of
    the bucket is unused, alternating with further requested messages. Requests therefore cannot crowd out the aircraft's own
    reports. bulk: function that returns the next bulk message, None without one.
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
        self._answers: deque[Item] = deque()
        self._answer_share = _Share()
        self._requested: deque[Item] = deque()
        self._requested_share = _Share()
        self._bulk_next = False
        self._partial = b""
        self._current: Item | None = None
        self._following: deque[Item] = deque()
        self.bulk: Callable[[], Item | None] = lambda: None
        self.bytes_sent = 0
        self.frames_sent = 0
        self.scans_dropped = 0

    @property
    def budget(self) -> float:
        return self._budget

    @budget.setter
    def budget(self, value: float) -> None:
        self._budget = value

    def put_urgent(self, message: Item) -> None:
        self._urgent.append(message)

    def put_scan(self, messages: Sequence[Item]) -> None:
        """Send the messages of one scan together; when too many scans wait, the oldest is dropped and counted."""
        self._scans.append(messages)
        while len(self._scans) > self._scan_room:
            self.scans_dropped += 1
            for message in self._scans.popleft():
                if message.on_dropped is not None:
                    message.on_dropped()

    def put_low(self, message: Item) -> None:
        """Send when neither scans nor anything more important wait."""
        self._low.append(message)

    def put_acknowledgement(self, message: Item) -> bool:
        """Send before scans, within ANSWER_SHARE; False when too many wait. Equal ones are sent once."""
        return _put(self._answers, message, _ANSWER_ROOM)

    def put_requested(self, message: Item) -> bool:
        """Send before bulk, within ANSWER_SHARE; False when too many wait. Equal ones are sent once."""
        return _put(self._requested, message, _REQUESTED_ROOM)

    @property
    def has_low(self) -> bool:
        return bool(self._low)

    def service(self, now_ns: int) -> None:
        """Send what budget and port allow now."""
        bucket = max(_LEAST_BUCKET, self._budget * _BUCKET_S)
        if self._last_ns is not None:
            earned = (now_ns - self._last_ns) / NS * self._budget
            self._tokens = min(bucket, self._tokens + earned)
            self._answer_share.earn(earned, bucket)
            self._requested_share.earn(earned, bucket)
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
        """Write the rest of the current frame to the port; returns whether the port has taken all of it."""
        if self._partial:
            count = self._port.write(self._partial)
            self.bytes_sent += count
            self._partial = self._partial[count:]
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
        if self._answers and self._answer_share.tokens > 0:
            return self._answer_share.pay(self._answers.popleft())
        if self._tokens <= 0:
            return None
        if self._scans:
            self._following.extend(self._scans.popleft())
            return self._following.popleft()
        if self._low:
            return self._low.popleft()
        if self._requested and self._requested_share.tokens > 0:
            return self._requested_share.pay(self._requested.popleft())
        return self._requested_or_bulk() if self._tokens > bucket / 2 else None

    def _requested_or_bulk(self) -> Item | None:
        """Requested messages and bulk alternate, so that neither delays the other."""
        bulk_first, self._bulk_next = self._bulk_next, False
        if bulk_first and (message := self.bulk()) is not None:
            return message
        if self._requested:
            self._bulk_next = True
            return self._requested.popleft()
        return None if bulk_first else self.bulk()


class _Share:
    """A token bucket: bytes that a class of messages may still take of ANSWER_SHARE."""

    def __init__(self) -> None:
        self.tokens = _LEAST_BUCKET

    def earn(self, earned: float, bucket: float) -> None:
        self.tokens = min(max(_LEAST_BUCKET, ANSWER_SHARE * bucket), self.tokens + ANSWER_SHARE * earned)

    def pay(self, message: Item) -> Item:
        self.tokens -= len(message.payload) + FRAMING_BYTES
        return message


def _put(queue: deque[Item], message: Item, room: int) -> bool:
    if message in queue:
        return True
    if len(queue) >= room:
        return False
    queue.append(message)
    return True
