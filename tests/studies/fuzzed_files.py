"""Thousands of mutated files through everything that reads one. Run: python -m tests.studies.fuzzed_files [CASES] [FIRST SEED]

Prints one row for each kind of file, and the seed of each failure.
"""

import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from tests.unit.daq.fuzzing import answered, mutated

LONGEST_S = 10.0


def main(cases: int = 10_000, first: int = 100_000) -> None:
    """Run the cases and print the table."""
    files: Counter[str] = Counter()
    read: Counter[str] = Counter()
    failed: Counter[str] = Counter()
    worst: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(first, first + cases):
            ending, data = mutated(seed)
            path = Path(folder) / f"case{ending}"
            path.write_bytes(data)
            files[ending] += 1
            begun = time.process_time()
            try:
                read[ending] += answered(path).count("read")
            except Exception as error:  # noqa: BLE001  the study counts what must never come out of a reader
                failed[ending] += 1
                print(f"seed {seed}: {type(error).__name__}: {error}", flush=True)
            worst[ending] = max(worst.get(ending, 0.0), time.process_time() - begun)
    print("| file | cases | answers that are no error, of five readers | tracebacks | longer than 10 s |")
    print("|---|---|---|---|---|")
    for ending, count in sorted(files.items()):
        print(f"| {ending} | {count} | {read[ending]} | {failed[ending]} | {int(worst[ending] > LONGEST_S)} |")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
