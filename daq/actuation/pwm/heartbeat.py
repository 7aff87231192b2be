"""The heartbeat: edges on a line that keep a monostable up, which alone lets chip and multiplexer reach the servos.

Neither the servo driver nor the multiplexer notices that the computer behind them is dead; the monostable does. The line
is a file of the kernel's, such as the `brightness` of a gpio-leds device whose `trigger` is `none`: a kernel trigger that
blinks by itself would go on after this process.
"""

from pathlib import Path
from typing import IO, Protocol

from daq.actuation.config import HeartbeatConfig
from daq.utilities.errors import UserError


class HeartbeatError(UserError):
    """A heartbeat line that cannot be used."""


class HeartbeatLine(Protocol):
    """What the sequencer needs of the line. Raises OSError when it fails."""

    def beat(self) -> None:
        """One rising edge: the monostable starts anew."""
        ...

    def release(self) -> None:
        """End the monostable at once where that is wired; otherwise it ends by itself."""
        ...


class FileHeartbeat:
    """The lines as files that take "1" and "0"; opened once, cleared on closing."""

    def __init__(self, config: HeartbeatConfig) -> None:
        self._line = _open(config.line)
        self._clear = None if config.clear is None else _open(config.clear)
        self.release()

    def beat(self) -> None:
        """One rising edge."""
        if self._clear is not None:
            self._clear.write(b"1")
        self._line.write(b"1")
        self._line.write(b"0")

    def release(self) -> None:
        """Pull the clear line low."""
        if self._clear is not None:
            self._clear.write(b"0")

    def close(self) -> None:
        """Release and close."""
        self.release()
        self._line.close()
        if self._clear is not None:
            self._clear.close()


def _open(path: Path) -> IO[bytes]:
    trigger = path.with_name("trigger")
    try:
        if trigger.is_file() and "[none]" not in trigger.read_text():
            raise HeartbeatError(f"{trigger}: the kernel drives this line by itself; write none into it")
        return path.open("wb", buffering=0)
    except OSError as error:
        raise HeartbeatError(
            f"{path}: heartbeat line cannot be opened ({error.strerror}); set sequencer.heartbeat"
        ) from error
