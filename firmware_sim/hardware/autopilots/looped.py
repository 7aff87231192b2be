"""The common base of simulated autopilots: a loop at a fixed rate, a serial line each way, and a history of the outputs."""

from abc import ABC, abstractmethod
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterator, Sequence

from firmware_sim.hardware.autopilots.frames import Packer, ReceivedFrame, Unpacker

BAUD = 115_200


class LossyLine:
    """One direction of a serial line, 10 bits a byte. lost: time sent [ns] -> whether the data are lost; late_ns: time sent [ns]
    -> additional delay [ns]."""

    def __init__(self, baud: int = BAUD) -> None:
        self._byte_ns = 10e9 / baud
        self._free_ns = 0.0  # when the last byte leaves
        self._under_way: deque[tuple[float, bytes]] = deque()  # when its first byte arrives
        self.lost: Callable[[int], bool] = lambda now_ns: False
        self.late_ns: Callable[[int], int] = lambda now_ns: 0

    def behind_ns(self, now_ns: int) -> float:
        """Time until all bytes have left [ns]."""
        return max(0.0, self._free_ns - now_ns)

    def send(self, data: bytes, now_ns: int) -> None:
        """Queue bytes behind those that have not left yet."""
        start = max(self._free_ns, now_ns)
        self._free_ns = start + len(data) * self._byte_ns
        if not self.lost(now_ns):
            self._under_way.append((start + self.late_ns(now_ns), data))

    def arrived(self, now_ns: int) -> bytes:
        """Bytes that have arrived since the last call, in the order of sending."""
        received = b""
        while self._under_way:
            start, data = self._under_way[0]
            count = min(len(data), max(0, int((now_ns - start) / self._byte_ns)))
            received += data[:count]
            if count < len(data):
                self._under_way[0] = (start + count * self._byte_ns, data[count:])
                break
            self._under_way.popleft()
        return received


MS = 1_000_000
TRIM_US, TRAVEL_US = 1500, 500
LEAST_US = 1000
_HISTORY_NS = 10_000 * MS  # length of the history of outputs


class LoopedAutopilot(ABC):
    """A `Talker` with a loop. loop_ns: its period [ns]; origin_ns: when it was switched on [ns]."""

    def __init__(self, loop_ns: int, origin_ns: int) -> None:
        self.inward, self.outward = LossyLine(), LossyLine()
        self.loops = 0
        self.origin_ns = self._next_ns = origin_ns
        self._loop_ns = loop_ns
        self._history_length = max(1, _HISTORY_NS // loop_ns)
        self.packer, self._unpacker = Packer(), Unpacker()
        self._times: list[int] = [origin_ns]
        self._history: list[tuple[int, ...]] = [(TRIM_US,) * 3 + (LEAST_US,)]

    @abstractmethod
    def loop(self, now_ns: int) -> None:
        """Run the loop once."""

    def run_to(self, now_ns: int) -> None:
        """Run all loops up to this time."""
        while self._next_ns <= now_ns:
            self.loop(self._next_ns)
            self.loops += 1
            self._next_ns += self._loop_ns

    def bytes_until(self, now_ns: int) -> bytes:
        """Bytes that have arrived at the other end since the last call."""
        self.run_to(now_ns)
        return self.outward.arrived(now_ns)

    def receive(self, data: bytes, now_ns: int) -> None:
        """Take bytes, which arrive at the speed of the line."""
        self.inward.send(data, now_ns)

    def received(self, now_ns: int) -> Iterator[ReceivedFrame]:
        """Messages that have arrived completely since the last call."""
        return self._unpacker.feed(self.inward.arrived(now_ns))

    def set_outputs(self, surfaces: Sequence[int], throttle: int, now_ns: int) -> None:
        """Set the pulse widths of the three surfaces and the throttle from now on [us]."""
        self._times.append(now_ns)
        self._history.append((*surfaces, throttle))
        if len(self._times) > 2 * self._history_length:
            del self._times[: self._history_length], self._history[: self._history_length]

    @property
    def newest_us(self) -> tuple[int, ...]:
        """Present pulse widths [us], the throttle's last."""
        return self._history[-1]

    def outputs_us(self, time_ns: int) -> tuple[int, ...]:
        """Pulse widths of outputs 1 to 4 at a time [us], the throttle's last."""
        self.run_to(time_ns)
        return self._history[max(bisect_right(self._times, time_ns) - 1, 0)]
