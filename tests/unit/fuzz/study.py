"""Spoilt inputs of every kind by the thousand: `python -m tests.unit.fuzz.study --cases 10000 --seed 1`.

Each slice runs in a process of its own with the memory limited; a case that does not come back within CPU_LIMIT_S of
processor time is a hang, and the process is ended. Prints a table; `--json` adds to a file, so that a study can be run in parts.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from tests.unit.fuzz.fence import Answer, answered
from tests.unit.fuzz.kinds import KINDS, Kind

CPU_LIMIT_S = 25.0
ADDRESS_SPACE = 4 * 2**30  # far above the 500 MB that are allowed; keeps the machine alive
SLICE = 250


def run_case(kind: Kind, data: bytes, reader: Any, folder: Path) -> Answer:
    """Have one input answered, in an empty folder."""
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        path = Path(scratch) / f"case{kind.suffix}"
        path.write_bytes(data)
        return answered(lambda: reader(path, Path(scratch)))


def work(kind: Kind, seed: int, first: int, last: int) -> None:
    """The cases of a slice, in this process; a line of JSON before and after each."""
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE))
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        for number in range(first, last):
            print(json.dumps({"case": number}), flush=True)
            data, reader = kind.case(seed, number)
            answer = run_case(kind, data, reader, Path(folder))
            told = {"number": number, "status": answer.status, "cpu_s": answer.cpu_s, "peak": answer.peak_bytes}
            print(json.dumps({**told, "fault": answer.fault}), flush=True)


def slice_results(kind: Kind, seed: int, first: int, last: int) -> list[dict[str, Any]]:
    """The answers of a slice from a process of its own; goes on behind a case that ended it."""
    found: list[dict[str, Any]] = []
    while first < last:
        command = [sys.executable, "-m", "tests.unit.fuzz.study", "--work", kind.name, str(seed), str(first), str(last)]
        with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
            process = subprocess.Popen(command, stdout=out, stderr=err, text=True)
            _watch(process, out)
            out.seek(0)
            err.seek(0)
            lines = [json.loads(line) for line in out.read().splitlines() if line.startswith("{")]
            last_words = err.read()[-300:]
        found += [line for line in lines if "number" in line]
        started = [line["case"] for line in lines if "case" in line]
        if process.returncode == 0:
            break
        at = started[-1] if started else first
        found.append(
            {
                "number": at,
                "status": None,
                "cpu_s": 0.0,
                "peak": 0,
                "fault": f"process ended with {process.returncode}: {last_words}",
            }
        )
        first = at + 1
    return found


def _watch(process: "subprocess.Popen[str]", out: Any) -> None:
    """Wait for the end; end it when a single case takes more than CPU_LIMIT_S of processor time."""
    size, cpu = -1, 0.0
    while process.poll() is None:
        time.sleep(0.2)
        written = os.fstat(out.fileno()).st_size
        try:
            fields = Path(f"/proc/{process.pid}/stat").read_text().rsplit(")", 1)[1].split()
        except OSError:
            continue
        spent = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        if written != size:
            size, cpu = written, spent
        elif spent - cpu > CPU_LIMIT_S:
            process.kill()
            process.wait()


def study(cases: int, seed: int, only: list[str], first: int = 0) -> dict[str, list[dict[str, Any]]]:
    """`cases` over the kinds by their share, from number `first` of each."""
    chosen = [KINDS[name] for name in only] if only else list(KINDS.values())
    total = sum(kind.share for kind in chosen)
    results: dict[str, list[dict[str, Any]]] = {}
    for kind in chosen:
        count = max(1, round(cases * kind.share / total))
        results[kind.name] = []
        for start in range(first, first + count, SLICE):
            results[kind.name] += slice_results(kind, seed, start, min(start + SLICE, first + count))
        print(row(kind.name, results[kind.name]), flush=True)
        for fault in faults(results[kind.name]):
            print(f"    {fault}", flush=True)
    return results


def row(name: str, answers: list[dict[str, Any]]) -> str:
    """One line of the table."""
    status = Counter(a["status"] for a in answers)
    wrong = [a["fault"] for a in answers if a["fault"]]
    slow = sum("processor time" in f or "-9" in f for f in wrong)
    tracebacks = sum("traceback" in f for f in wrong)
    return (
        f"| {name} | {len(answers)} | {status[0]} | {status[1]} | {status[2]} | {tracebacks} | {slow} | "
        f"{len(wrong)} | {max((a['cpu_s'] for a in answers), default=0):.2f} | "
        f"{max((a['peak'] for a in answers), default=0) / 1e6:.0f} |"
    )


HEAD = (
    "| kind | cases | read (0) | failed check (1) | refused (2) | tracebacks | hangs | all faults | most CPU [s] | most memory "
    "[MB] |\n"
    "|---|---|---|---|---|---|---|---|---|---|"
)


def faults(answers: list[dict[str, Any]]) -> list[str]:
    """Each different fault once, with how often and the first case of it."""
    seen: dict[str, list[int]] = {}
    for answer in answers:
        if answer["fault"]:
            seen.setdefault(answer["fault"], []).append(answer["number"])
    return [f"{len(cases)} x (first {cases[0]}): {fault}" for fault, cases in seen.items()]


def main() -> None:
    """Run a study, or with --work one slice of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first case of each kind")
    parser.add_argument("--only", action="append", default=[], help="a kind; may be repeated")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--work", nargs=4)
    options = parser.parse_args()
    if options.work:
        name, seed, first, last = options.work
        work(KINDS[name], int(seed), int(first), int(last))
        return
    print(HEAD)
    results = study(options.cases, options.seed, options.only, options.first)
    if options.json:
        before = json.loads(options.json.read_text()) if options.json.exists() else {}
        options.json.write_text(json.dumps({k: before.get(k, []) + v for k, v in {**before, **results}.items()}))
    sys.exit(any(a["fault"] for answers in results.values() for a in answers))


if __name__ == "__main__":
    main()
