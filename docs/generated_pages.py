"""Pages that `make docs` writes from the program: the catalogue of effects and the numbers that decide in the gap workflow.

They are not in git. `python docs/generated_pages.py` writes them beside this file, as building the site does.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from estimation.gap.criteria import AS_SET, Criteria, Criterion
from estimation.gap.effects.base import Effect, EffectParameter
from estimation.gap.effects.catalogue import plane

HERE = Path(__file__).parent
SENSITIVITY = HERE / "criteria_sensitivity.json"
"""Criterion -> what a study measured; written by `python -m tests.studies.gap_sensitivity`."""
EFFECTS_HEAD = """# Catalogue of candidate effects

Reference: every effect that `sideslip gap` can name. A model is asked for the effects of its axes, `six-dof` for all.
To add one: [gap.md](gap.md#an-effect-of-your-own).

Each entry: equation; parameters with usual size and [possible range]; effects it can be confused with; what isolates it.
Physics, source and signature: `estimation/gap/effects/*.toml`. Sizes are those of an aircraft of 3.5 kg and 1.5 m span; they
[scale](gap-details.md#aircraft-of-any-size). An effect *carried by* derivatives, which absorb it, is never named.
"""
CRITERIA_HEAD = """# Numbers that decide in the gap workflow

Reference: every number of `estimation.gap.criteria.Criteria` that would change an answer; the reason for each stands there.
`tests/unit/estimation/gap/mutation.md` names the test that notices another value. At 0.7/1.4 times the number, six sets (three
kinds of flights with nothing hidden, two effects of half size, a stale vane): how many answers *changed*, and by how much the
deciding ratios *moved* at most (evidence of the name, the nearest score over its threshold, sizes that would be seen). A 0 is a
guard against flights that are not among the six (`python -m tests.studies.gap_sensitivity`).

| criterion | value | meaning [unit] | changed | moved |
|---|---|---|---|---|
"""


def effects_page(parts: Mapping[str, Sequence[Effect]] | None = None) -> str:
    """The catalogue as Markdown; parts: title -> effects, by default the built-in ones."""
    built_in = {
        "Lateral": plane("lateral"),
        "Longitudinal": plane("longitudinal"),
        "Across the axes": plane("across_axes"),
    }
    text, seen = [EFFECTS_HEAD], set[str]()
    for title, effects in (parts or built_in).items():
        text.append(f"## {title}")
        for effect in effects:
            repeated = f" ({title.lower()})" if effect.name in seen else ""
            text.append(
                f"\n### {effect.name}{repeated}\n\n**{effect.title}** ({effect.group.value})\n\n{_entry(effect)}"
            )
        seen |= {effect.name for effect in effects}
        text.append("")
    return "\n".join(text).rstrip() + "\n"


def _entry(effect: Effect) -> str:
    several = len(effect.forms) > 1
    parts = [effect.equation]
    parts += [(f"{f.label}: " if several else "") + ", ".join(map(_parameter, f.parameters)) for f in effect.forms]
    if effect.confusions:
        parts.append("confused with " + ", ".join(f"`{other}`" for other in effect.confusions))
    parts.append(f"isolated by {effect.separate_by}")
    if effect.tied_to:
        parts.append(f"carried by {', '.join(effect.tied_to)}")
    return "; ".join(parts) + "."


def _parameter(p: EffectParameter) -> str:
    none = "" if p.none == 0.0 else f", none: {p.none}"
    unit = "" if p.unit == "1" else f" {p.unit}"
    return f"`{p.name}` {p.typical:g}{unit} [{p.lower:g}, {p.upper:g}{none}]"


def criteria_page(criteria: Criteria = AS_SET, sensitivity: Mapping[str, Mapping[str, Any]] | None = None) -> str:
    """The criteria as Markdown. sensitivity: criterion -> counts, by default what the study left."""
    known = json.loads(SENSITIVITY.read_text(encoding="utf-8")) if sensitivity is None else sensitivity
    rows = ((f"`{c.name}`", f"{c.value:g}", _meaning(c), *_measured(known.get(c.name))) for c in criteria.described())
    return CRITERIA_HEAD + "".join(map(_line, rows))


def _measured(counts: Mapping[str, Any] | None) -> tuple[str, str]:
    """How many answers changed and by how much ratios moved, at the lower and the higher value."""
    if counts is None:
        return "", ""
    return "/".join(map(str, counts["changed"])), "/".join(f"{share:.0%}" for share in counts["moved"])


def _meaning(c: Criterion) -> str:
    return c.meaning if c.unit == "1" else f"{c.meaning} [{c.unit}]"


def _line(cells: Sequence[str]) -> str:
    safe = [cell.replace("|", "\\|") for cell in cells]
    return f"| {' | '.join(safe)} |\n"


def write_pages(folder: Path = HERE) -> None:
    """Write both pages; one that is up to date is left alone, so that the site is not built anew for it."""
    for name, text in (("effects.md", effects_page()), ("gap-criteria.md", criteria_page())):
        path = folder / name
        if not path.is_file() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    write_pages()
