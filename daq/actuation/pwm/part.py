"""A chip of the sequencer's own, set up step by step without ever waiting, and again after it failed."""

from collections.abc import Callable, Generator

from daq.sensors.base import SECOND, SensorError, Wait

RETRY_NS = SECOND


class ChipState:
    """Whether the chip can be used, and why not. initialise: its set-up, yielding waits as drivers do."""

    def __init__(self, initialise: Callable[[], Generator[Wait, None, None]]) -> None:
        self.fault = "not set up yet"
        self._initialise = initialise
        self._setup: Generator[Wait, None, None] | None = None
        self._next_ns = 0

    @property
    def up(self) -> bool:
        """Set up, and not failed since."""
        return not self.fault

    def attend(self, now_ns: int) -> bool:
        """Take a step of the set-up if one is due; whether the chip can be used."""
        if self.up or now_ns < self._next_ns:
            return self.up
        self._setup = self._setup or self._initialise()
        try:
            self._next_ns = now_ns + next(self._setup)
        except StopIteration:
            self._setup, self.fault = None, ""
        except (OSError, SensorError) as error:
            self.fail(error, now_ns)
        return self.up

    def fail(self, error: Exception, now_ns: int) -> None:
        """Note that it failed; it is set up again after a pause, so that whoever asks meanwhile sees the fault."""
        self._setup, self._next_ns = None, now_ns + RETRY_NS
        text = (error.strerror or str(error)) if isinstance(error, OSError) else str(error)
        self.fault = text or type(error).__name__
