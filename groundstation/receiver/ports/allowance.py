"""How much of something may come: so much at once, and so much a second from then on."""

from groundstation.receiver.timeline import NS


class Allowance:
    """at_once: what is there in the beginning, and at most. per_s: what comes back in a second."""

    def __init__(self, at_once: float, per_s: float) -> None:
        self._most, self._per_s = at_once, per_s
        self._left = at_once
        self._last_ns: int | None = None

    def take(self, amount: float, now_ns: int) -> bool:
        """Use some of it; False, and nothing used, when there is not enough."""
        if self._last_ns is not None:
            self._left = min(self._most, self._left + max(0, now_ns - self._last_ns) / NS * self._per_s)
        self._last_ns = now_ns
        if amount > self._left:
            return False
        self._left -= amount
        return True
