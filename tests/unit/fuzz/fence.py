"""What an answer may be and may cost: a result or one sentence, ten seconds of processor time, 500 MB."""

import contextlib
import io
import os
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from daq.utilities.errors import UserError
from daq.utilities.plain_words import one_line

MOST_CPU_S = 10.0
MOST_BYTES = 500_000_000
_ALLOWED = (0, 1, 2)


class TooSlowError(BaseException):
    """The processor time is used up. Not an Exception, so that nothing takes it for damage of a file."""


@dataclass(frozen=True)
class Answer:
    """How an input was answered. fault: empty, or what is wrong with the answer."""

    status: int | None
    said: str
    cpu_s: float
    peak_bytes: int
    fault: str = ""


def answered(call: Callable[[], object]) -> Answer:
    """Make the call as the command line does, within the fence, and judge the answer."""
    out, err = io.StringIO(), io.StringIO()
    before = _reset_peak()
    begun = time.process_time()
    status: int | None = None
    fault = ""
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), _limited():
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("always")
                call()
            status = 0
        except SystemExit as exit_:
            status = exit_.code if isinstance(exit_.code, int) else 0
        except UserError as error:
            status = 2
            print(f"sideslip: {one_line(str(error))}", file=err)
        except OSError as error:
            if error.filename is None:
                fault = f"traceback: {error!r}{_where(error.__traceback__)}"
            status = 2
            print(f"sideslip: {one_line(str(error))}", file=err)
        except TooSlowError:
            fault = f"more than {MOST_CPU_S:g} s of processor time{_where(sys.exc_info()[2])}"
        except BaseException as error:  # noqa: BLE001 what escapes is the finding
            fault = f"traceback: {type(error).__name__}: {str(error)[:120]}{_where(error.__traceback__)}"
    cpu = time.process_time() - begun
    peak = max(0, _memory("VmHWM") - before)
    said = err.getvalue().strip()
    return Answer(status, said, cpu, peak, fault or _judged(status, said, cpu, peak))


def _judged(status: int | None, said: str, cpu: float, peak: int) -> str:
    if status not in _ALLOWED:
        return f"exit status {status}"
    if cpu > MOST_CPU_S:
        return f"{cpu:.1f} s of processor time"
    if peak > MOST_BYTES:
        return f"{peak / 1e6:.0f} MB of memory"
    if "Traceback" in said or "Warning" in said:
        return f"on standard error: {said[:300]}"
    if status == 2 and (not said or "\n" in said):
        return f"not one sentence: {said[:200]!r}"
    if any((ord(c) < 32 and c not in "\n\t\r") or c in "\u202e\u2066\u200f" for c in said):
        return f"control characters on the terminal: {said[:200]!r}"
    return ""


def _where(trace: object) -> str:
    frames = traceback.extract_tb(trace)[-1:]  # type: ignore[arg-type]
    return f" ({Path(frames[0].filename).name}:{frames[0].lineno})" if frames else ""


@contextlib.contextmanager
def _limited() -> Iterator[None]:
    def stop(number: int, frame: FrameType | None) -> None:
        raise TooSlowError

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, MOST_CPU_S + 1.0)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def _memory(key: str) -> int:
    text = Path("/proc/self/status").read_text()
    return int(text.split(f"{key}:", 1)[1].split()[0]) * 1024


def _reset_peak() -> int:
    """Let the highest memory seen begin anew; returns what is in use now."""
    with contextlib.suppress(OSError), os.fdopen(os.open("/proc/self/clear_refs", os.O_WRONLY), "w") as handle:
        handle.write("5")
    return _memory("VmRSS")
