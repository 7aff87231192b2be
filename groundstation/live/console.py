"""Commands typed at a running ground station, and the lines it prints. `help` lists the commands.

Commands are read from standard input without ever waiting: from a terminal while this process is in its foreground, or a pipe.
Lines go to standard output as long as somebody reads it, and always to `ground.log`.
"""

import os
import queue
import re
import select
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import click

from daq.contract.manoeuvre import ManoeuvreError, load_manoeuvre
from daq.utilities.plain_words import did_you_mean, visible
from daq.utilities.rotating_log import RotatingLog
from daq.utilities.standard_streams import Speaker
from daq.utilities.utc_stamps import log_stamp
from groundstation.identification.words import state_lines
from groundstation.live.station import Station
from groundstation.receiver.downloads import LogFetcher

HELP = """\
status            state of each aircraft, recorder, link and alarms in force
live              derivatives so far, with their bounds, and what to fly next
ack               acknowledge alarms that are over
mark              mark an event in the recording on board
start | stop      begin or end the recording on board
fly DIGEST        start the armed manoeuvre (six digits, printed when it was armed); signed links only
send FILE         send a manoeuvre (sideslip design) up to the sequencer; signed links only, the pilot's switch at off
release           end the manoeuvre under way: the pilot gets the aircraft
rate HZ           scans a second on the radio; 0: as configured on board
zero              zero the pitot (refused unless the aircraft is clearly at rest)
backfill MODE     off, lost (what the radio lost) or all (every scan in full)
logs              list the recordings on board
fetch NUMBER      download one of them into this session's folder
quit              end the session and write the flight
With several aircraft begin with the number: 2 mark"""
_FORMS = {line.split()[0]: line[:18].strip() for line in HELP.splitlines()[:-1]}
_LONGEST = 4096  # bytes of a line
_LARGEST_RATE = 1e6  # Hz: a larger number is a slip


class Lines:
    """Lines from a file descriptor, read without waiting."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor: int | None = descriptor
        self._waiting = b""
        self._read: queue.SimpleQueue[bytes] | None = None

    @classmethod
    def of_standard_input(cls) -> "Lines":
        """Standard input; no lines where there is none, or while the terminal belongs to another program."""
        lines = cls(-1)
        try:
            lines._descriptor = sys.stdin.fileno()
        except (AttributeError, OSError, ValueError):
            lines._descriptor = None
        if lines._descriptor is not None and not hasattr(os, "tcgetpgrp"):  # Windows, where `select` takes sockets only
            lines._read = queue.SimpleQueue()
            threading.Thread(target=lines._read_blocking, args=(lines._descriptor, lines._read), daemon=True).start()
        return lines

    @staticmethod
    def _read_blocking(descriptor: int, read: "queue.SimpleQueue[bytes]") -> None:
        data = b"-"
        while data:
            try:
                data = os.read(descriptor, _LONGEST)
            except OSError:
                data = b""
            read.put(data)

    def read(self) -> list[str]:
        """Complete lines since the last call."""
        if self._descriptor is None:
            return []
        data = self._available(self._descriptor)
        if data is None:
            return []
        if not data:
            self._descriptor = None
        *complete, self._waiting = (self._waiting + data).split(b"\n")
        self._waiting = self._waiting[-_LONGEST:]
        return [line.decode("utf-8", "replace").strip() for line in complete]

    def _available(self, descriptor: int) -> bytes | None:
        """New bytes; empty at the end of the input, None where reading would wait."""
        if self._read is not None:
            return None if self._read.empty() else self._read.get()
        if not _may_read(descriptor):
            return None
        try:
            return os.read(descriptor, _LONGEST) if select.select([descriptor], [], [], 0)[0] else None
        except OSError:
            return b""


def _may_read(descriptor: int) -> bool:
    """Whether a read does not stop this process: a terminal stops one that reads in the background."""
    try:
        return not os.isatty(descriptor) or os.tcgetpgrp(descriptor) == os.getpgrp()
    except OSError:  # the terminal is gone
        return False


def _hint(word: str) -> str:
    """Advice on a line that begins with `word` and is not understood."""
    return f"; type {_FORMS[word]}" if word in _FORMS else did_you_mean(word, _FORMS) or "; type help"


class Console:
    """Obeys typed commands. echo: prints an answer."""

    def __init__(self, station: Station, lines: Lines, echo: Callable[[str], None]) -> None:
        self._station, self._lines, self._echo = station, lines, echo
        self._listing: dict[int, LogFetcher] = {}
        self._fetching: dict[int, tuple[int, Path]] = {}

    def poll(self) -> bool:
        """Obey the commands typed since the last call; False once the session is to end."""
        self._report()
        return all(self.obey(line) for line in self._lines.read() if line)

    def obey(self, line: str) -> bool:
        """Obey one line; False for `quit`."""
        words = line.split()
        if words[0] == "quit":
            return False
        if words[0] == "help":
            self._echo(HELP)
            return True
        systems = self._station.receiver.systems
        if words[0].isdigit():
            system = int(words.pop(0))
            systems = [s for s in systems if s == system]
        if not systems:
            self._echo("no such aircraft has been heard")
        elif len(systems) > 1 and words[:1] not in (["status"], ["ack"], ["live"]):
            self._echo(f"which aircraft? begin with its number: {', '.join(map(str, systems))}")
        elif not words or not self._execute(words, systems):
            self._echo(f"{line!r} is not understood{_hint(words[0] if words else '')}")
        return True

    def _execute(self, words: list[str], systems: list[int]) -> bool:
        """Carry out one command; False where it is not understood."""
        receiver, system = self._station.receiver, systems[0]
        commander = receiver.commander
        match words:
            case ["status"]:
                for number in systems:
                    self._echo(f"aircraft {number}: {self._station.monitor(number).status_page().replace('**', '')}")
            case ["live"]:
                for number in systems:
                    state = self._station.identifications.state(number)
                    for line in ["nothing is identified yet"] if state is None else state_lines(state):
                        self._echo(f"aircraft {number}: {line}")
            case ["ack"]:
                for number in systems:
                    self._station.monitor(number).acknowledge()
            case ["mark"]:
                commander.mark(system)
            case ["start"]:
                commander.start_recording(system)
            case ["stop"]:
                commander.stop_recording(system)
            case ["zero"]:
                commander.zero_pitot(system)
            case ["fly", digest] if re.fullmatch("[0-9a-f]{6,}", digest):
                commander.start_manoeuvre(system, digest)
            case ["send", *_] if len(words) > 1:
                self._send_manoeuvre(system, " ".join(words[1:]))
            case ["release"]:
                commander.stop_manoeuvre(system)
            case ["rate", value] if (rate := _rate(value)) is not None:
                commander.set_rate(system, rate)
            case ["backfill", ("off" | "lost" | "all") as mode]:
                receiver.set_backfill(mode, system)
            case ["logs"]:
                self._listing[system] = receiver.logs(system)
                self._listing[system].request_list()
            case ["fetch", value] if value.isdigit():
                self._fetch(system, int(value))
            case _:
                return False
        return True

    def _send_manoeuvre(self, system: int, path: str) -> None:
        try:
            manoeuvre = load_manoeuvre(path)
            self._station.receiver.send_manoeuvre(system, manoeuvre)
        except ManoeuvreError as error:
            self._echo(str(error))
            return
        self._echo(f"aircraft {system}: sending manoeuvre {manoeuvre.digest[:6]}, {manoeuvre.duration_s:.0f} s")

    def _fetch(self, system: int, number: int) -> None:
        logs = self._station.receiver.logs(system)
        if number not in logs.entries:
            self._echo(f"no recording {number} is known; type logs first")
            return
        path = self._station.folder / f"aircraft{system}_log{number}.mcap"
        try:
            logs.download(number, path)
        except OSError as error:
            self._echo(f"{path}: cannot be written ({error.strerror})")
            return
        self._fetching[system] = (number, path)

    def _report(self) -> None:
        """Report listings and downloads that are complete."""
        for system, logs in list(self._listing.items()):
            if not logs.listing:
                del self._listing[system]
                entries = sorted(logs.entries.values(), key=lambda e: e.number)
                for e in entries:
                    self._echo(f"aircraft {system}: recording {e.number}: {e.size} bytes")
                if not entries:
                    self._echo(f"aircraft {system}: no recordings")
        for system, (number, path) in list(self._fetching.items()):
            if number in self._station.receiver.logs(system).done:
                del self._fetching[system]
                self._echo(f"aircraft {system}: recording {number} is here: {path}")


def _rate(text: str) -> float | None:
    """A typed rate [Hz]; None where it is none."""
    try:
        rate = float(text)
    except ValueError:
        return None
    return rate if 0.0 <= rate < _LARGEST_RATE else None


LOG = "ground.log"


@contextmanager
def open_output(folder: Path) -> Iterator[Callable[[str], None]]:
    """A function that prints a line and logs it in `folder`, and neither waits for a reader nor fails without one."""
    with RotatingLog(folder / LOG) as log:

        def write_log(line: str) -> None:
            stamp = log_stamp(time.time())
            log.write(f"{stamp} {visible(line)}\n".encode("utf-8", "backslashreplace"))

        descriptor = _descriptor()
        if descriptor is None:  # within another program's Python, or a test, whose output never blocks

            def echo_and_log(line: str) -> None:
                click.echo(line)
                write_log(line)

            yield echo_and_log
            return
        speaker = Speaker(partial(os.write, descriptor))

        def say(line: str) -> None:
            speaker.say(visible(line))
            write_log(line)

        try:
            yield say
        finally:
            speaker.close()


def _descriptor() -> int | None:
    """The descriptor of standard output where `sys.stdout` writes to it, else None."""
    try:
        descriptor = int(sys.stdout.fileno())
        sys.stdout.flush()
        return descriptor if descriptor == 1 and os.fstat(descriptor) else None
    except (OSError, ValueError, AttributeError):
        return None
