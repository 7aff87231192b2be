"""Runs verbs on files within limits: `python -m tests.unit.daq.bounded SECONDS MEGABYTES VERB,VERB... FILE...`.

The limits are the operating system's: processor time for all verbs on one file together, and address space.
"""

import resource
import sys
from pathlib import Path

import sideslip

ARGUMENTS = {
    "verify": lambda file, out: ["verify", file, "--json", f"{out}/verify.json"],
    "info": lambda file, out: ["info", file, "--json", f"{out}/info.json"],
    "recover": lambda file, out: ["recover", file, "-o", f"{out}/recovered.mcap"],
    "calibrate": lambda file, out: ["calibrate", file, "-o", f"{out}/flight.csv", "--salvage"],
    "calibrate with": lambda file, out: [
        "calibrate",
        file,
        "-o",
        f"{out}/with.csv",
        "--salvage",
        "--calibration",
        "cdfp",
    ],
    "check": lambda file, out: ["check", file],
    "view": lambda file, out: ["view", file, "--view", "none", "--rrd", f"{out}/view.rrd"],
}


def run(verb: str, file: Path, out: Path) -> int:
    """Exit status of a verb; whatever is no status passes through as the traceback it is."""
    try:
        sideslip.main(ARGUMENTS[verb](str(file), str(out)))
    except SystemExit as done:
        return int(done.code or 0)
    return 0


def main() -> None:
    """For each file a line with its name and the exit status of each verb, in order."""
    seconds, megabytes, verbs, *files = sys.argv[1:]
    resource.setrlimit(resource.RLIMIT_AS, (int(megabytes) << 20, int(megabytes) << 20))
    for file in map(Path, files):
        used = resource.getrusage(resource.RUSAGE_SELF)
        limit = int(used.ru_utime + used.ru_stime) + int(seconds) + 1  # whole seconds, begun ones count
        resource.setrlimit(resource.RLIMIT_CPU, (limit, resource.RLIM_INFINITY))
        out = file.with_suffix(".out")
        out.mkdir()
        statuses = [run(verb, file, out) for verb in verbs.split(",")]
        print("bounded", file.stem, *statuses, sep="\t", flush=True)


if __name__ == "__main__":
    main()
