"""What a session says: on standard output as long as somebody reads it, and in `ground.log` always."""

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from daq.contract.plain_words import visible
from daq.contract.rotating_log import RotatingLog
from daq.contract.standard_streams import Speaker

LOG = "ground.log"


@contextmanager
def spoken(folder: Path) -> Iterator[Callable[[str], None]]:
    """A function that says a line, without ever waiting for its reader or failing for want of one."""
    with RotatingLog(folder / LOG) as log:

        def write_down(line: str) -> None:
            stamp = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
            log.write(f"{stamp} {visible(line)}\n".encode("utf-8", "backslashreplace"))

        descriptor = _descriptor()
        if descriptor is None:  # within another program's Python, or a test: there nobody is slow

            def both(line: str) -> None:
                click.echo(line)
                write_down(line)

            yield both
            return
        speaker = Speaker(descriptor)

        def say(line: str) -> None:
            speaker.say(visible(line))
            write_down(line)

        try:
            yield say
        finally:
            speaker.close()


def _descriptor() -> int | None:
    """Standard output of this process, where that is what `sys.stdout` writes to."""
    try:
        found = int(sys.stdout.fileno())
        sys.stdout.flush()
        return found if found == 1 and os.fstat(found) else None
    except (OSError, ValueError, AttributeError):
        return None
