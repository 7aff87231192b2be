"""Standard output and error that do not disturb a verb when they are closed, broken, full or slow.

Verbs print to a `SafeStream`, which keeps the first error and drops all later output, so that the work goes on. Programs that run
for hours use a `Speaker`, whose thread waits for a slow reader in their place.
"""

import contextlib
import io
import os
import queue
import sys
import threading
from collections.abc import Callable
from typing import Any, TextIO

_LINES = 1000  # queued for a slow reader; beyond that the oldest are dropped, for all are in the log
_CLOSE_TIMEOUT_S = 1.0  # for the reader at the end of a session
_LARGEST_LINE = 4096  # bytes: what a pipe takes in one piece


def sound_descriptors() -> None:
    """Open the null device on closed descriptors 0 to 2, so that the next opened file does not become standard output."""
    for descriptor, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(descriptor)
        except OSError:
            opened = os.open(os.devnull, os.O_RDWR)
            if opened != descriptor:
                os.dup2(opened, descriptor)
                os.close(opened)
            os.set_inheritable(descriptor, True)
        if getattr(sys, name) is None:
            raw = io.FileIO(descriptor, mode, closefd=False)
            stream: Any = io.BufferedReader(raw) if mode == "r" else io.BufferedWriter(raw)
            setattr(sys, name, io.TextIOWrapper(stream, "utf-8", "backslashreplace"))


class SafeStream:
    """A text stream that never raises. trouble: the first error, after which nothing is written."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self.trouble: OSError | None = None

    def write(self, text: str) -> int:
        if self.trouble is None:
            self._attempt(lambda: self._stream.write(text))
        return len(text)

    def writelines(self, lines: list[str]) -> None:
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        if self.trouble is None:
            self._attempt(self._stream.flush)

    def _attempt(self, act: Any) -> None:
        try:
            act()
        except OSError as error:
            self.trouble = error
        except ValueError as error:  # closed
            self.trouble = OSError(str(error))

    def give_up(self) -> None:
        """After an error, redirect the descriptor to the null device, so that the interpreter's last flush succeeds."""
        if self.trouble is not None:
            with contextlib.suppress(OSError, ValueError):
                null_device = os.open(os.devnull, os.O_WRONLY)
                os.dup2(null_device, self._stream.fileno())
                os.close(null_device)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


class Speaker:
    """Writes lines through a function (`os.write` on a descriptor) in a thread; no call blocks for long, and none raises."""

    def __init__(self, write: Callable[[bytes], object]) -> None:
        self._lines: queue.Queue[bytes | None] = queue.Queue(_LINES)
        self._write: Callable[[bytes], object] | None = write
        self._thread = threading.Thread(target=self._speak, name="speaker", daemon=True)
        self._thread.start()

    def say(self, line: str) -> None:
        """Queue a line."""
        data = (line + "\n").encode("utf-8", "backslashreplace")
        self._put(data)

    def _put(self, data: bytes | None) -> None:
        while True:
            try:
                self._lines.put_nowait(data)
                return
            except queue.Full:
                with contextlib.suppress(queue.Empty):
                    self._lines.get_nowait()

    def _speak(self) -> None:
        while (data := self._lines.get()) is not None:
            if self._write is None:
                continue
            try:
                for offset in range(0, len(data), _LARGEST_LINE):
                    self._write(data[offset : offset + _LARGEST_LINE])
            except OSError:
                self._write = None  # closed, full, or its terminal is gone; the log has all lines

    def close(self) -> None:
        """Write the queued lines, within _CLOSE_TIMEOUT_S, and end the thread."""
        self._put(None)
        self._thread.join(_CLOSE_TIMEOUT_S)
