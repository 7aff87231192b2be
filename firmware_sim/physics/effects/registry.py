"""All hidden effects by name: rows of the table, and classes where one statement is not enough."""

from collections.abc import Mapping, Sequence

from firmware_sim.physics.effects import actuator, airframe, sensor, sudden, uncatalogued
from firmware_sim.physics.effects.base import HiddenEffect
from firmware_sim.physics.effects.table import ROWS
from firmware_sim.physics.maths import Value
from firmware_sim.tables import ScenarioError

EFFECTS: Mapping[str, type[HiddenEffect]] = {effect.name: effect for effect in ROWS} | {
    effect.name: effect
    for module in (airframe, actuator, sensor, uncatalogued, sudden)
    for effect in vars(module).values()
    if isinstance(effect, type) and issubclass(effect, HiddenEffect) and "name" in vars(effect)
}


def make_effects(hidden: Sequence[tuple[str, Value]]) -> tuple[HiddenEffect, ...]:
    """Effects by (name, scale); raises ScenarioError for an unknown name."""
    unknown = [name for name, _ in hidden if name not in EFFECTS]
    if unknown:
        raise ScenarioError(f"hidden: no effect named {unknown[0]!r}; known are {', '.join(sorted(EFFECTS))}")
    return tuple(EFFECTS[name](scale) for name, scale in hidden)
