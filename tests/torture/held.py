"""A verb held just before its first write, and let go from there as often as is asked.

What a verb computes before it writes can lose nothing, and takes most of its time. So a process runs the verb once as a whole,
so that all is imported and what it writes is known, and once more as far as the first file that it writes below its
working folder. There it stays, and forks for each trial: the child goes on as the verb would, in a new folder of the same name.
Orders come on standard input, a line each; answers go to descriptor 3: process numbers, then how the child ended.

Run by `Held`: python -m tests.torture.held FOLDER WHOLE WORDS...
"""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.support.paths import ROOT

WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT
PROBE = ".probe."
"""Begins the name of the file by which a verb tries, before it works, whether a folder can be written."""


@dataclass(frozen=True)
class Ended:
    """How a child ended. status: as `subprocess` gives it. seconds: of the clock. cpu_s: of its processor. peak_mb: memory."""

    status: int
    seconds: float
    cpu_s: float
    peak_mb: float
    words: str


class Held:
    """One verb, held. here: the working folder of every trial, which the owner empties or renames between them."""

    def __init__(self, words: list[str], here: Path, whole: Path, shim: Path | None) -> None:
        self._here = here
        answers, theirs = os.pipe()
        preload = {} if shim is None else {"LD_PRELOAD": str(shim)}
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.torture.held", str(theirs), str(here), str(whole), *words],
            stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, cwd=ROOT, pass_fds=(theirs,),
            env={**os.environ, **preload, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}, text=True,
        )  # fmt: skip
        os.close(theirs)
        self._answers = os.fdopen(answers)
        self.status = self._answer()["whole"]
        """Exit status of the whole run."""
        self._answer()  # it is held now

    def _answer(self) -> dict[str, Any]:
        line = self._answers.readline()
        if not line:
            self._process.kill()
            _, said = self._process.communicate()
            raise RuntimeError(f"{self._process.args!r} did not come to its first write: {said[-2000:]}")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def go(self, count: int = 1, **environment: str) -> list[int]:
        """Let so many children go on from the first write; their process numbers."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps({"count": count, "environment": environment}) + "\n")
        self._process.stdin.flush()
        return [int(number) for number in self._answer()["children"]]

    def ended(self) -> Ended:
        """Wait for one of the children that were let go last."""
        answer = self._answer()
        said = self._here.with_name(f"words.{answer.pop('pid')}")
        words = said.read_text("utf-8", "replace") if said.exists() else ""  # killed before it had words
        said.unlink(missing_ok=True)
        return Ended(words=words, **answer)

    def close(self) -> None:
        """Let the process go for good."""
        self._process.kill()
        self._process.communicate()
        self._answers.close()


class _Holder:
    """Within the process: stops at the first write below a folder."""

    def __init__(self, here: Path, answers: int) -> None:
        self.here, self.answers, self.active = here, answers, False

    def tell(self, **answer: object) -> None:
        os.write(self.answers, json.dumps(answer).encode() + b"\n")

    def hook(self, event: str, args: tuple[Any, ...]) -> None:
        """An audit hook: it sees every file that is opened, and every folder that is looked through, Python's own way."""
        if not self.active or not (
            (event == "open" and self._opens(*args)) or (event == "os.scandir" and _clears_before_a_write())
        ):
            return
        self.active = False
        self.tell(held=True)
        for line in sys.stdin:
            if self._fork(**json.loads(line)):
                return
        os._exit(0)

    def _opens(self, name: object, _: object, flags: int | None) -> bool:
        if not isinstance(name, str | bytes) or not (flags or 0) & WRITING:
            return False
        path = Path.cwd() / os.fsdecode(name)
        return self.here in path.parents and not path.name.startswith(PROBE)

    def _fork(self, count: int, environment: dict[str, str]) -> bool:
        """True in a child that is to go on; False when all have ended."""
        begun, children = time.monotonic(), []
        for _ in range(count):
            children.append(os.fork())
            if not children[-1]:
                self._go_on(environment)
                return True
        self.tell(children=children)
        for _ in children:
            pid, status, used = os.wait4(-1, 0)
            seconds, cpu = time.monotonic() - begun, used.ru_utime + used.ru_stime
            code = os.waitstatus_to_exitcode(status)
            self.tell(pid=pid, status=code, seconds=seconds, cpu_s=cpu, peak_mb=used.ru_maxrss / 1e3)
        return False

    def _go_on(self, environment: dict[str, str]) -> None:
        os.environ.update(environment)
        os.chdir(self.here)
        words = os.open(self.here.with_name(f"words.{os.getpid()}"), os.O_WRONLY | os.O_CREAT, 0o600)
        os.dup2(words, 2)


def _clears_before_a_write() -> bool:
    """Whether `durable` looks for leftovers, as it does before it draws a hidden name."""
    clearing = sys._getframe(2)
    caller = clearing.f_back
    writes = caller is not None and caller.f_code.co_name in ("replacing", "replacing_folder")
    return clearing.f_code.co_name == "clear_leftovers" and writes


def _begin_anew() -> None:
    """Signals as a process finds them at its start."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def main() -> None:
    """The held process."""
    from daq.utilities.interrupts import Interrupts
    from sideslip.cli import run

    answers, here, whole, words = int(sys.argv[1]), Path(sys.argv[2]), Path(sys.argv[3]), sys.argv[4:]
    holder, status = _Holder(here, answers), 0
    sys.addaudithook(holder.hook)
    here.mkdir(parents=True, exist_ok=True)
    whole.mkdir(parents=True, exist_ok=True)
    os.chdir(whole)
    _begin_anew()
    try:
        run(list(words), Interrupts())
    except SystemExit as end:
        status = int(end.code or 0)
    holder.tell(whole=status)
    os.chdir(here)
    holder.active = True
    _begin_anew()
    run(list(words), Interrupts())


if __name__ == "__main__":
    main()
