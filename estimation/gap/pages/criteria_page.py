"""The criteria as a page of the documentation: `python -m estimation.gap.pages.criteria_page > docs/gap-criteria.md`.

Sensitivity is read from `criteria_sensitivity.json` beside this file: criterion -> what a study measured, in words. It is written
by `python -m tests.studies.gap_sensitivity`; a criterion that no study has moved yet says so.
"""

import json
from collections.abc import Mapping
from pathlib import Path

from estimation.gap.criteria import AS_SET, Criteria

SENSITIVITY = Path(__file__).with_name("criteria_sensitivity.json")
HEAD = """# Numbers that decide in the gap workflow

Generated from `estimation/gap/criteria.py`; do not edit. Every number that would change an answer if another sensible value
were taken, with what it means and where it comes from. What only changes rounding or working time is named where it is used.
[gap-mutation.md](gap-mutation.md) shows which test notices when one is another number. Sensitivity: what the answers do at 0.7
and 1.4 times the value (`python -m tests.studies.gap_sensitivity`); empty where no study has moved it yet.

| criterion | value | unit | meaning | origin | sensitivity |
|---|---|---|---|---|---|
"""


def page(criteria: Criteria = AS_SET, measured: Mapping[str, str] | None = None) -> str:
    """The page as Markdown. measured: criterion -> sensitivity in words, by default what the study left."""
    told = json.loads(SENSITIVITY.read_text(encoding="utf-8")) if measured is None else measured
    rows = (
        (f"`{c.name}`", f"{c.value:g}", c.unit, c.meaning, c.origin, told.get(c.name, "")) for c in criteria.described()
    )
    return HEAD + "".join(_line(row) for row in rows)


def _line(cells: tuple[str, ...]) -> str:
    safe = [cell.replace("|", "\\|") for cell in cells]
    return f"| {' | '.join(safe)} |\n"


if __name__ == "__main__":
    print(page(), end="")
