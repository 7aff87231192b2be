"""The catalogue as a page of the documentation: `python -m estimation.gap.effects.page > docs/effects.md`."""

from collections.abc import Iterator, Mapping, Sequence

from estimation.gap.effects.base import Effect, EffectParameter, Group
from estimation.gap.effects.catalogue import BUILT_IN, LONGITUDINAL
from estimation.gap.effects.cross_axis import CROSS_AXIS

HEAD = """# Catalogue of candidate effects

Generated from `estimation/gap/effects`; do not edit. `sideslip gap` asks a model for the effects of the axes it has: a lateral
one for those of the first part, `longitudinal` for those of the second, `six-dof` for all and for what couples the planes. Of
these, every effect that applies is asked. A laboratory adds its own in one short file: see
[gap.md](gap.md#an-effect-of-your-own).

Two kinds are listed and never named. *Exactly carried*: the derivatives that are estimated anyway take the effect up whole (a
wrong density, a wrong moment of inertia). *Without excitation*: what a flight does not move leaves nothing behind; with a
throttle that never moves the tilt of the thrust line and the lag of thrust cannot be told, and its height, slipstream and size
only a fifth as well.

Sizes and limits are those of the reference aircraft (3.5 kg, 1.5 m of span). For another they grow with it: lengths with its
span, masses with its mass, products of inertia and angular momenta with both, what gives way to the airstream with the inverse of
its wing loading. Numbers without a dimension and times of instruments and servos stay.
"""
PARTS: Mapping[str, Sequence[Effect]] = {
    "Lateral": BUILT_IN,
    "Longitudinal": LONGITUDINAL,
    "Across the axes": CROSS_AXIS,
}


def page(parts: Mapping[str, Sequence[Effect]] = PARTS) -> str:
    """The page as Markdown."""
    written = [HEAD]
    seen: set[str] = set()
    for title, effects in parts.items():
        names = {e.name: e.name if e.name not in seen else f"{e.name} ({title.lower()})" for e in effects}
        seen |= set(names)
        written += [f"## {title}\n", *_table(effects, names), *_entries(effects, names)]
    return "\n".join(written).rstrip() + "\n"


def _anchor(heading: str) -> str:
    return heading.lower().replace(" ", "-").replace("(", "").replace(")", "")


def _table(effects: Sequence[Effect], names: Mapping[str, str]) -> Iterator[str]:
    yield "| group | effects |"
    yield "|---|---|"
    for group in Group:
        found = [f"[`{e.name}`](#{_anchor(names[e.name])})" for e in effects if e.group is group]
        if found:
            yield f"| {group.value} | {' '.join(found)} |"


def _entries(effects: Sequence[Effect], names: Mapping[str, str]) -> Iterator[str]:
    for effect in effects:
        yield f"\n### {names[effect.name]}\n\n**{effect.title}** ({effect.group.value})\n\n{effect.physics}\n"
        yield f"- equation: {effect.equation}"
        for form in effect.forms:
            own = f", {form.equation}" if form.equation else ""
            yield f"- {form.label}{own}: " + "; ".join(_parameter(p) for p in form.parameters)
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
