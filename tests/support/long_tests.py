"""Which tests are long: those that took more than a second when all ran last. `make test` leaves them out, CI runs them.

    pytest -n 2 --durations=0 --durations-min=0.1 -m "not study and not benchmark" > REPORT
    python -m tests.support.long_tests REPORT

writes tests/long_tests.txt anew from the report; new tests are short until then.
"""

import re
import sys
from collections import defaultdict
from pathlib import Path

from tests.support.paths import ROOT

LIST = ROOT / "tests" / "long_tests.txt"
LONG_S = 1.0
"""The tests below it, twelve of thirteen, take a quarter of the time of all: four minutes on two idle cores."""
_LINE = re.compile(r"^(\d+\.\d+)s (?:call|setup|teardown) +(\S.*?)\s*$", re.MULTILINE)


def long_tests() -> frozenset[str]:
    """Their node ids."""
    return frozenset(LIST.read_text(encoding="utf-8").splitlines()) if LIST.is_file() else frozenset()


def of_report(text: str) -> list[str]:
    """Node ids of the tests that took longer than LONG_S, set-up and all, by pytest's report of durations."""
    seconds: dict[str, float] = defaultdict(float)
    for duration, test in _LINE.findall(text):
        seconds[test] += float(duration)
    return sorted(test for test, total in seconds.items() if total > LONG_S)


if __name__ == "__main__":
    names = of_report(Path(sys.argv[1]).read_text(encoding="utf-8"))
    LIST.write_text("\n".join(names) + "\n", encoding="utf-8")
    print(f"{LIST}: {len(names)} tests")
