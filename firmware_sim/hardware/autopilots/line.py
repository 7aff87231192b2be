"""The serial line of an autopilot: bytes at its speed, both ways, which may be lost or come late."""

from collections import deque
from collections.abc import Callable

BAUD = 115_200


class LossyLine:
    """lost, late_ns: whether what is sent at a time [ns] is lost, and how much later it arrives [ns]."""

    def __init__(self, baud: int = BAUD) -> None:
        self._byte_ns = 10e9 / baud
        self._free_ns = 0.0  # when the last byte will have left
        self._under_way: deque[tuple[float, bytes]] = deque()  # when its first byte arrives
        self.lost: Callable[[int], bool] = lambda now_ns: False
        self.late_ns: Callable[[int], int] = lambda now_ns: 0

    def send(self, data: bytes, now_ns: int) -> None:
        """Put bytes on the line, behind those that have not left yet."""
        start = max(self._free_ns, now_ns)
        self._free_ns = start + len(data) * self._byte_ns
        if not self.lost(now_ns):
            self._under_way.append((start + self.late_ns(now_ns), data))

    def arrived(self, now_ns: int) -> bytes:
        """What has arrived since it was last asked, in the order of sending."""
        out = b""
        while self._under_way:
            start, data = self._under_way[0]
            count = min(len(data), max(0, int((now_ns - start) / self._byte_ns)))
            out += data[:count]
            if count < len(data):
                self._under_way[0] = (start + count * self._byte_ns, data[count:])
                break
            self._under_way.popleft()
        return out
