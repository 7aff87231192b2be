"""Standard output and error as a convenience: closed, broken, full or slow they never change what a verb does.

`SafeStream` is what a verb prints to: the first failure is remembered and the rest is dropped, so that the work goes on.
`Speaker` is for what runs for hours: it hands lines to a thread, which waits for a slow reader in its place.
"""

import contextlib
import io
import os
import queue
import sys
import threading
from collections.abc import Callable
from typing import Any, TextIO

_LINES = 1000  # that wait for a slow reader; the oldest go first, and all are in the log
_LAST_WORDS_S = 1.0  # how long the end of a session waits for its reader
_LARGEST_LINE = 4096  # bytes: what a pipe takes in one piece


def sound_descriptors() -> None:
    """Put the null device where descriptors 0 to 2 are closed, or the next file opened would be standard output."""
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
    """A stream of text that never raises. trouble: the first error; nothing is written after it."""

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
        """After trouble: lead the descriptor to the null device, so that the interpreter's end has nothing to say either."""
        if self.trouble is not None:
            with contextlib.suppress(OSError, ValueError):
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, self._stream.fileno())
                os.close(nowhere)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


class Speaker:
    """Says lines through a function (`os.write` on a descriptor), without ever waiting and without ever failing."""

    def __init__(self, write: Callable[[bytes], object]) -> None:
        self._lines: queue.Queue[bytes | None] = queue.Queue(_LINES)
        self._write: Callable[[bytes], object] | None = write
        self._thread = threading.Thread(target=self._speak, name="speaker", daemon=True)
        self._thread.start()

    def say(self, line: str) -> None:
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
                self._write = None  # closed, full, or its terminal is gone: the log has it all

    def close(self) -> None:
        """Say what waits, as long as somebody listens, and end"""
        self._put(None)
        self._thread.join(_LAST_WORDS_S)
