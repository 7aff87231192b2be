"""Pages that `make docs` writes from the program: the catalogue of effects and the numbers that decide in the gap workflow.

They are not in git. `python docs/generated_pages.py` writes them beside this file, as building the site does.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from estimation.gap.criteria import AS_SET, Criteria
from estimation.gap.effects.base import Effect, EffectParameter, Group
from estimation.gap.effects.catalogue import plane

HERE = Path(__file__).parent
SENSITIVITY = HERE / "criteria_sensitivity.json"
"""Criterion -> what a study measured, in words; written by `python -m tests.studies.gap_sensitivity`."""
EFFECTS_HEAD = """# Catalogue of candidate effects

`sideslip gap` asks a model for the effects of the axes it has: a lateral one for those of the first part, `longitudinal` for
those of the second, `six-dof` for all and for what couples the planes. Of these, every effect that applies is asked. A laboratory
adds its own in one short file: see [gap.md](gap.md#an-effect-of-your-own).

Two kinds are listed and never named. *Exactly carried*: the derivatives that are estimated anyway take the effect up whole (a
wrong density, a wrong moment of inertia). *Without excitation*: what a flight does not move leaves nothing behind; with a
throttle that never moves the tilt of the thrust line and the lag of thrust cannot be told, and its height, slipstream and size
only a fifth as well.

Sizes and limits are those of the reference aircraft (3.5 kg, 1.5 m of span). For another they grow with it: lengths with its
span, masses with its mass, products of inertia and angular momenta with both, what gives way to the airstream with the inverse of
its wing loading. Numbers without a dimension and times of instruments and servos stay.
"""
CRITERIA_HEAD = """# Numbers that decide in the gap workflow

Every number that would change an answer if another sensible value were taken, with what it means and where it comes from. What
only changes rounding or working time is named where it is used. [gap-mutation.md](gap-mutation.md) shows which test notices when
one is another number. Sensitivity: what the answers do at 0.7 and 1.4 times the value
(`python -m tests.studies.gap_sensitivity`);
empty where no study has moved it yet.

| criterion | value | unit | meaning | origin | sensitivity |
|---|---|---|---|---|---|
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
        headings = {e.name: e.name if e.name not in seen else f"{e.name} ({title.lower()})" for e in effects}
        seen |= set(headings)
        text += [f"## {title}\n", *_groups(effects, headings), *_entries(effects, headings)]
    return "\n".join(text).rstrip() + "\n"


def _groups(effects: Sequence[Effect], headings: Mapping[str, str]) -> Iterator[str]:
    yield "| group | effects |"
    yield "|---|---|"
    for group in Group:
        links = [f"[`{e.name}`](#{_anchor(headings[e.name])})" for e in effects if e.group is group]
        if links:
            yield f"| {group.value} | {' '.join(links)} |"


def _anchor(heading: str) -> str:
    return heading.lower().replace(" ", "-").replace("(", "").replace(")", "")


def _entries(effects: Sequence[Effect], headings: Mapping[str, str]) -> Iterator[str]:
    for effect in effects:
        yield f"\n### {headings[effect.name]}\n\n**{effect.title}** ({effect.group.value})\n\n{effect.physics}\n"
        yield f"- equation: {effect.equation}"
        for form in effect.forms:
            equation = f", {form.equation}" if form.equation else ""
            yield f"- {form.label}{equation}: " + "; ".join(_parameter(p) for p in form.parameters)
        yield f"- source: {effect.source}\n- signature: {effect.signature}"
        for other, difference in effect.confusions.items():
            yield f"- can be mistaken for `{other}`: {difference}"
        yield f"- isolated by: {effect.separate_by}"
        if effect.tied_to:
            yield f"- exactly carried by {', '.join(effect.tied_to)}: cannot be told from them in any flight of a linear model"


def _parameter(p: EffectParameter) -> str:
    none = "" if p.none == 0.0 else f", without effect {p.none}"
    return f"`{p.name}` [{p.unit}] {p.meaning}, usually {p.typical:g}, possible {p.lower:g} to {p.upper:g}{none}"


def criteria_page(criteria: Criteria = AS_SET, sensitivity: Mapping[str, str] | None = None) -> str:
    """The criteria as Markdown. sensitivity: criterion -> words, by default what the study left."""
    words = json.loads(SENSITIVITY.read_text(encoding="utf-8")) if sensitivity is None else sensitivity
    rows = (
        (f"`{c.name}`", f"{c.value:g}", c.unit, c.meaning, c.origin, words.get(c.name, ""))
        for c in criteria.described()
    )
    return CRITERIA_HEAD + "".join(map(_line, rows))


def _line(cells: tuple[str, ...]) -> str:
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
