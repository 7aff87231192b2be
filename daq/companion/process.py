"""The companion process (identification on board) for the scan loop: passes scans on and reads answers without blocking."""

import math
import os
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from daq.companion.wire import LONGEST_LINE, CompanionReply, Setup, frame, read_answer, setup_frame
from daq.contract.recordings.messages import LogLevel
from daq.contract.scan import Scan, encode_scan


class IdentificationConfig(BaseModel):
    """`[identification]`: estimation in flight. Needs `calibration`, and `aircraft.file` or a built-in `aircraft.name`.

    model: lateral, longitudinal, six-dof, or the file of a model; empty: lateral. every_s: time between two answers. watch: run
    the gap monitor too, whose thresholds take the process minutes to compute. command: of the process; empty: `-m
    sideslip.onboard` of this Python. niceness: of the process.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    model: str = ""
    every_s: Annotated[float, Field(ge=1.0, le=600.0)] = 5.0
    watch: bool = False
    command: tuple[str, ...] = ()
    niceness: Annotated[int, Field(ge=0, le=19)] = 10


NAME = "identification"
BACKLOG = 1 << 20  # bytes queued for the pipe: two minutes at 20 Hz, while the process starts or swaps
STALE = 3.0  # greatest age of the answer that the sequencer uses, in times of `every_s`
END_S = 3.0  # for the last answer, when the recording ends

Say = Callable[[LogLevel, str, str], None]
Show = Callable[[str, float], None]
Tell = Callable[[str], None]


class Companion:
    """One companion process. aircraft, calibration, until: as in `Setup`. say: writes a line to recording and journal; show:
    sends a named value to the ground; tell: writes a line that is no warning to recording and ground."""

    def __init__(
        self,
        config: IdentificationConfig,
        aircraft: str,
        calibration: str,
        say: Say,
        show: Show,
        tell: Tell,
        until: str = "",
    ) -> None:
        self._config, self._aircraft, self._calibration, self._until = config, aircraft, calibration, until
        self._say, self._show, self._tell = say, show, tell
        self._process: subprocess.Popen[bytes] | None = None
        self._unsent = bytearray()
        self._unread_line = b""
        self._broken = ""  # why the pipe failed, in words
        self._scan_time = math.nan  # of the last scan [s]
        self._answer = CompanionReply()
        self.dropped = 0

    def start(self, details: Mapping[str, str]) -> None:
        """Start the process; a failure is reported, and recording goes on without it. details: facts of the sensors."""
        command = list(self._config.command) or [sys.executable, "-m", "sideslip.onboard"]
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        try:
            process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                bufsize=0,
                env=environment,
                start_new_session=True,  # Ctrl-C goes to the logger only, which then ends the process
            )
        except OSError as error:
            self._say(LogLevel.WARNING, NAME, f"{command[0]} cannot be started ({error.strerror}); recording goes on")
            return
        self._process = process
        _lower_priority(process.pid, self._config.niceness)
        for pipe in (process.stdin, process.stdout):
            assert pipe is not None
            os.set_blocking(pipe.fileno(), False)
        self._unsent += setup_frame(
            Setup(
                self._aircraft,
                self._calibration,
                dict(details),
                self._config.every_s,
                self._config.model,
                self._config.watch,
                self._until,
            )
        )

    def scans(self, scans: Iterable[Scan]) -> None:
        """Pass scans on, in order, and process the answers so far."""
        if self._process is None:
            return
        for scan in scans:
            self._scan_time = scan.time
            data = frame(encode_scan(scan))
            if len(self._unsent) + len(data) > BACKLOG:
                self.dropped += 1
                if self.dropped == 1:
                    self._say(LogLevel.WARNING, NAME, "cannot keep up: scans are left out of it; recording goes on")
            else:
                self._unsent += data
        try:
            self._write()
        except OSError as error:
            self._broken = error.strerror or str(error)
        self._read_answers()

    def known(self) -> Mapping[str, tuple[float, float]] | None:
        """Derivative -> estimate and standard deviation of the last answer; None where that is too old, or of other scans."""
        age = self._scan_time - self._answer.time
        fresh = self._process is not None and 0.0 <= age <= STALE * self._config.every_s
        return self._answer.values if fresh else None

    def close(self) -> None:
        """Wait for the last answer, for END_S, then end the process."""
        process, self._process = self._process, None
        if process is None:
            return
        assert process.stdin is not None
        os.set_blocking(process.stdin.fileno(), True)
        try:
            rest, _ = process.communicate(bytes(self._unsent), timeout=END_S)
            self._read_lines(rest or b"")
        except (subprocess.TimeoutExpired, OSError):
            self._say(LogLevel.WARNING, NAME, "has not finished in time; its last numbers are those before")
        finally:
            _end_process(process)

    def _write(self) -> None:
        assert self._process is not None
        assert self._process.stdin is not None
        while self._unsent:
            try:
                count = os.write(self._process.stdin.fileno(), self._unsent)
            except BlockingIOError:
                return
            del self._unsent[:count]

    def _read_answers(self) -> None:
        """Read answers, also the last ones of a process that has ended."""
        assert self._process is not None
        assert self._process.stdout is not None
        try:
            data = os.read(self._process.stdout.fileno(), LONGEST_LINE)
        except BlockingIOError:
            data = None
        except OSError as error:
            self._broken, data = error.strerror or str(error), b""
        if data:
            self._read_lines(data)
        elif data is not None or self._broken:
            process, self._process = self._process, None
            status = _end_process(process)
            reason = self._broken or "it has ended"
            self._say(LogLevel.WARNING, NAME, f"is lost ({reason}, exit status {status}); recording goes on")

    def _read_lines(self, data: bytes) -> None:
        *lines, rest = (self._unread_line + data).split(b"\n")
        self._unread_line = rest[-LONGEST_LINE:]
        for line in lines:
            answer = read_answer(line)
            if answer is not None:
                self._handle_reply(answer)

    def _handle_reply(self, answer: CompanionReply) -> None:
        if answer.trouble:
            self._say(LogLevel.WARNING, NAME, f"{answer.trouble}; recording goes on")
            process, self._process = self._process, None
            if process is not None:
                _end_process(process)
            return
        self._answer = answer
        if answer.values:
            self._say(LogLevel.INFO, NAME, answer.record)
        if answer.point:
            self._tell(answer.point)
        if answer.alarm:
            self._say(LogLevel.WARNING, NAME, answer.alarm)
        for name, (estimate, bound) in answer.values.items():
            self._show(name, estimate)
            self._show(f"{name}.s", bound)


def _end_process(process: "subprocess.Popen[bytes]") -> int:
    """Kill a process and close its pipes; returns its exit status."""
    process.kill()
    status = process.wait()
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with suppress(OSError):  # unwritten data have no reader any more
                pipe.close()
    return status


def _lower_priority(pid: int, niceness: int) -> None:
    """Take the logger's real-time priority from a process and set its niceness, if the system allows it."""
    try:
        os.sched_setscheduler(pid, os.SCHED_OTHER, os.sched_param(0))
        os.setpriority(os.PRIO_PROCESS, pid, niceness)
    except (OSError, AttributeError):
        return
