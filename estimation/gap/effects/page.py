"""The catalogue as a page of the documentation: `python -m estimation.gap.effects.page > docs/effects.md`."""

from collections.abc import Iterator, Sequence

from estimation.gap.effects.base import Effect, EffectParameter, Group
from estimation.gap.effects.catalogue import BUILT_IN

HEAD = """# Catalogue of candidate effects

Generated from `estimation/gap/effects`; do not edit. `sideslip gap` asks every effect that applies to the given model.
A laboratory adds its own in one short file: see [gap.md](gap.md#an-effect-of-your-own).
"""


def page(effects: Sequence[Effect] = BUILT_IN) -> str:
    """The page as Markdown."""
    return "\n".join([HEAD, *_table(effects), *_entries(effects)]).rstrip() + "\n"


def _table(effects: Sequence[Effect]) -> Iterator[str]:
    yield "| group | effects |"
    yield "|---|---|"
    for group in Group:
        names = [f"[`{e.name}`](#{e.name.lower()})" for e in effects if e.group is group]
        if names:
            yield f"| {group.value} | {' '.join(names)} |"


def _entries(effects: Sequence[Effect]) -> Iterator[str]:
    for effect in effects:
        yield f"\n## {effect.name}\n\n**{effect.title}** ({effect.group.value})\n\n{effect.physics}\n"
        yield f"- equation: {effect.equation}"
        for form in effect.forms:
            yield f"- {form.label}: " + "; ".join(_parameter(p) for p in form.parameters)
        yield f"- source: {effect.source}\n- signature: {effect.signature}"
        for other, what in effect.confusions.items():
            yield f"- can be mistaken for `{other}`: {what}"
        yield f"- isolated by: {effect.separate_by}"
        if effect.tied_to:
            yield f"- exactly carried by {', '.join(effect.tied_to)}: cannot be told from them in any flight of a linear model"


def _parameter(p: EffectParameter) -> str:
    none = "" if p.none == 0.0 else f", without effect {p.none}"
    return f"`{p.name}` [{p.unit}] {p.meaning}, usually {p.typical:g}, possible {p.lower:g} to {p.upper:g}{none}"


if __name__ == "__main__":
    print(page(), end="")
