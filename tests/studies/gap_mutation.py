"""Does a test notice when a criterion of the gap workflow is another number? Every criterion is moved, and the rule tests run.

`python -m tests.studies.gap_mutation [--only NAME ...] [--page FILE]` (kept: tests/unit/estimation/gap/mutation.md): each
criterion by 30 % down and up (whole numbers by one; quantiles by 30 % of what is beyond them, since they end at one), in a
process of its own in which the one record that every module holds has the other number; then
tests/unit/estimation/gap/test_rules_*.py, no flights. Exit status 1 where one survives. The page has a row for every criterion
and the first test that turned red; with --only the other criteria keep their rows.
"""

import argparse
import io
import multiprocessing
import sys
from collections.abc import Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import pytest

from estimation.gap.criteria import AS_SET, Criterion

RULES = "tests/unit/estimation/gap/test_rules_*.py"
MOVES = (0.7, 1.3)


@dataclass(frozen=True)
class Outcome:
    """One criterion at another value, and the test that turned red; none where it survived."""

    criterion: Criterion
    value: float
    killer: str


def moved(criterion: Criterion) -> tuple[float, float]:
    """The two other values of a criterion."""
    low, high = MOVES
    if isinstance(criterion.value, int):
        return criterion.value - 1, criterion.value + 1
    if criterion.unit.startswith("quantile of"):
        return 1.0 - high * (1.0 - criterion.value), 1.0 - low * (1.0 - criterion.value)
    return low * criterion.value, high * criterion.value


class FirstFailure:
    """Keeps the name of the first test that fails, or the words of what could not even be collected."""

    def __init__(self) -> None:
        self.name = ""

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed and not self.name:
            self.name = report.nodeid.split("::")[-1].split("[")[0]

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed and not self.name:
            raise RuntimeError(f"the rule tests cannot be collected: {report.longreprtext}")


def rule_tests() -> tuple[str, str]:
    """Run the rule tests: (the first that fails or nothing, what was said); RuntimeError where they cannot be run at all."""
    first, said = FirstFailure(), io.StringIO()
    rules = map(str, sorted(Path().glob(RULES)))
    words = ["-q", "-x", "-n", "0", "-p", "no:randomly", "-p", "no:cacheprovider", "--tb=no", *rules]
    with redirect_stdout(said), redirect_stderr(said):
        status = pytest.main(words, plugins=[first])
    if status not in (0, 1) or (status == 1) is not bool(first.name):
        raise RuntimeError(f"the rule tests do not run\n{said.getvalue()[-2000:]}")
    return first.name, said.getvalue()


def tried(pair: tuple[Criterion, float]) -> Outcome:
    """Run the rule tests with one criterion at another value. Only in a process that ends after it: the record is changed."""
    criterion, value = pair
    object.__setattr__(AS_SET, criterion.name, value)
    return Outcome(criterion, value, rule_tests()[0])


def outcomes(chosen: Sequence[Criterion], workers: int) -> Iterator[Outcome]:
    """Every chosen criterion at both of its other values, in the order of the record. Everything is imported once, by a run
    that must be green, before processes part."""
    red, said = rule_tests()
    if red:
        raise RuntimeError(f"{red} is red before anything was moved\n{said[-2000:]}")
    with multiprocessing.get_context("fork").Pool(workers, maxtasksperchild=1) as pool:
        yield from pool.imap(tried, [(c, value) for c in chosen for value in moved(c)], chunksize=1)


def page(found: Sequence[Outcome], earlier: str = "") -> str:
    """The table as Markdown. earlier: a table from which criteria that were not tried keep their rows, where their value is the
    same."""
    moves: dict[str, list[Outcome]] = {}
    for o in found:
        moves.setdefault(o.criterion.name, []).append(o)
    rows = {line.split("`")[1]: line for line in earlier.splitlines() if line.startswith("|`")}
    for name, both in moves.items():
        tests = ", ".join(dict.fromkeys(f"`{o.killer}`" if o.killer else "**none**" for o in both))
        rows[name] = _row(both[0].criterion, [o.value for o in both], tests)
    known = {c.name: _row(c, moved(c), "") for c in AS_SET.described()}
    rows = {name: rows[name] for name, start in known.items() if rows.get(name, "").startswith(start.rstrip("|"))}
    survivors = sum(row.count("**none**") for row in rows.values())
    lines = [
        "# Does a test notice another number?",
        "",
        "Made by `python -m tests.studies.gap_mutation`; do not edit. Every criterion of the gap workflow",
        "(docs/gap-criteria.md of the built site) moved by 30 % down and up (whole numbers by one, quantiles by 30 % of what is",
        f"beyond them), then the rule tests: {2 * len(rows) - survivors} of {2 * len(rows)} changes turn a test red.",
        "",
        "| criterion | value | moved to | tests that turn red first |",
        "|---|---|---|---|",
    ]
    return "\n".join([*lines, *rows.values()]) + "\n"


def _row(criterion: Criterion, values: Sequence[float], tests: str) -> str:
    moved_to = ", ".join(f"{v:.4g}" for v in values)
    return f"|`{criterion.name}`|{criterion.value:g}|{moved_to}|{tests}|"


def main() -> int:
    """Try, say, write; the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", default=[], help="criteria to move; all by default")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--page", type=Path, help="write the table here")
    given = parser.parse_args()
    chosen = [c for c in AS_SET.described() if not given.only or c.name in given.only]
    found = []
    for outcome in outcomes(chosen, given.workers):
        found.append(outcome)
        print(f"{outcome.criterion.name:30s} {outcome.value:<10.4g} {outcome.killer or 'SURVIVES'}", flush=True)
    if given.page:
        earlier = given.page.read_text(encoding="utf-8") if given.only and given.page.exists() else ""
        given.page.write_text(page(found, earlier), encoding="utf-8")
    return 1 if any(not o.killer for o in found) else 0


if __name__ == "__main__":
    sys.exit(main())
