"""The record of deciding numbers: whole, carried into every room by the run, and written down where a person finds it."""

import ast
import json
from collections.abc import Iterator
from dataclasses import FrozenInstanceError, replace
from pathlib import Path
from typing import Any

import pytest

from docs.generated_pages import SENSITIVITY, criteria_page, effects_page
from estimation.gap.criteria import AS_SET, BENCHMARK, Criteria
from estimation.gap.search.state import Options
from tests.studies.gap_mutation import Outcome, moved
from tests.studies.gap_mutation import page as mutation_page
from tests.studies.gap_sensitivity import cases, summed_up, whole
from tests.studies.gap_sensitivity import moved as shifted

ROOMS = Path("estimation/gap")
CATALOGUE = ROOMS / "effects"  # sizes of effects are physics, not decisions


def test_every_criterion_says_what_it_is_and_where_it_comes_from() -> None:
    every = list(AS_SET.described())
    assert len(every) <= 40
    assert all(c.meaning and c.unit and c.origin for c in every)
    with pytest.raises(FrozenInstanceError):
        AS_SET.clearly_above = 2.0  # type: ignore[misc]


def test_the_pages_that_the_site_is_built_with_have_all_rows() -> None:
    assert all(f"| `{c.name}` | {c.value:g} |" in criteria_page() for c in AS_SET.described())
    assert "\n### Cn_da\n\n**adverse yaw from aileron** (omitted derivative)\n" in effects_page()


def test_the_page_shows_what_a_study_measured() -> None:
    counts = {"sets": 9, "changed": [1, 0], "lost": [1, 0], "moved": [0.124, 0.0]}
    assert "| 1/0 | 12%/0% |\n" in criteria_page(AS_SET, {"clearly_above": counts})
    assert json.loads(SENSITIVITY.read_text(encoding="utf-8")).keys() == {c.name for c in AS_SET.described()}


def test_the_page_of_mutations_has_both_moves_of_every_criterion_and_a_test_for_each() -> None:
    text = Path("tests/unit/estimation/gap/mutation.md").read_text(encoding="utf-8")
    rows = [tuple(cell.strip() for cell in line.split("|")[1:4]) for line in text.splitlines() if line.startswith("|`")]
    expected = [(c, ", ".join(f"{v:.4g}" for v in moved(c))) for c in AS_SET.described()]
    assert rows == [(f"`{c.name}`", f"{c.value:g}", values) for c, values in expected]
    assert "**none**" not in text


def test_a_criterion_that_no_test_notices_is_shown() -> None:
    (one,) = (c for c in AS_SET.described() if c.name == "clearly_above")
    text = mutation_page([Outcome(one, 1.05, ""), Outcome(one, 1.95, "test_x")])
    assert "|`clearly_above`|1.5|1.05, 1.95|**none**, `test_x`|" in text
    assert "1 of 2 changes turn a test red" in text


def test_whole_numbers_move_by_one_and_quantiles_by_what_is_beyond_them() -> None:
    known = {c.name: c for c in AS_SET.described()}
    assert moved(known["compared"]) == (5, 7)
    assert moved(known["null_level"]) == pytest.approx((0.9675, 0.9825))
    assert moved(known["clearly_above"]) == pytest.approx((1.05, 1.95))
    assert [shifted(known["compared"], f) for f in (0.7, 1.4)] == [4, 9]
    assert [shifted(known["null_level"], f) for f in (0.7, 1.4)] == pytest.approx([0.9825, 0.965])


def test_sensitivity_counts_the_same_flights_as_set_and_moved() -> None:
    def row(flights: str, factor: float, right: bool, near: float, *named: str, evidence: float | None = None) -> Any:
        criterion = "" if factor == 1.0 else "clearly_above"
        seen = {"x": 1.0 / factor, "y": 2.0 / factor}
        return {
            "flights": flights, "criterion": criterion, "factor": factor, "right": right, "near": near,
            "verdict": "gap_closed" if named else "no_gap", "named": list(named), "evidence": evidence, "seen": seen,
        }  # fmt: skip

    rows = [
        row("a", 1.0, True, 0.5), row("b", 1.0, True, 0.8, "z", evidence=2.0), row("c", 1.0, True, 0.8),
        row("a", 0.7, False, 0.8, "z", evidence=1.1), row("b", 0.7, True, 0.8, "z", evidence=2.1), row("c", 0.7, False, 0.8),
        row("a", 1.4, True, 0.5), row("b", 1.4, True, 0.8, "z", evidence=1.0),
    ]  # fmt: skip
    assert summed_up(rows) == {"clearly_above": {"sets": 2, "changed": [1, 0], "lost": [1, 0], "moved": [0.6, 0.5]}}
    asked = [(c.criterion, c.factor) for c in cases(["a"], ["clearly_above"])]
    assert asked == [("", 1.0), ("clearly_above", 0.7), ("clearly_above", 1.4)]


def test_a_set_of_the_sensitivity_study_is_read_back_from_its_name() -> None:
    assert whole("null:fourth: 50 Hz, gusty:12:longitudinal") == ("null", "fourth: 50 Hz, gusty", 12, "longitudinal")
    assert whole("half:aileron_delay:401004") == ("half", "aileron_delay", 401004, "lateral")


def sources() -> Iterator[tuple[Path, ast.Module]]:
    for path in sorted(ROOMS.rglob("*.py")):
        if CATALOGUE not in path.parents:
            yield path, ast.parse(path.read_text(encoding="utf-8"))


def test_rooms_get_the_criteria_from_the_run_and_have_none_of_their_own() -> None:
    """Only what a run begins with may name the record as set."""
    users = [
        str(path.relative_to(ROOMS))
        for path, tree in sources()
        if any(isinstance(n, ast.Name) and n.id == "AS_SET" for n in ast.walk(tree)) and path.name != "criteria.py"
    ]
    assert users == ["search/state.py"]
    assert Options().criteria == AS_SET
    assert replace(Criteria(), clearly_above=2.0) != AS_SET
    assert BENCHMARK.startswith("set by hand")


def test_no_comparison_in_the_rooms_has_a_number_of_its_own() -> None:
    """Nothing, everything and none are no decisions; other numbers have a name and a reason."""
    found = [
        f"{path}:{node.lineno}"
        for path, tree in sources()
        for node in ast.walk(tree)
        if isinstance(node, ast.Compare)
        for part in (n for side in (node.left, *node.comparators) for n in ast.walk(side))
        if isinstance(part, ast.Constant) and isinstance(part.value, float) and part.value not in (0.0, 1.0)
    ]
    assert not found
