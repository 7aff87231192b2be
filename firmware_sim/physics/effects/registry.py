"""All hidden effects by name."""

from collections.abc import Mapping, Sequence

from firmware_sim.physics.effects import (
    actuator,
    aerodynamic,
    cross_axis,
    elevator,
    environment,
    inertial,
    longitudinal,
    longitudinal_sensor,
    propulsion,
    sensor,
    sudden,
    uncatalogued,
    unsteady,
)
from firmware_sim.physics.effects.base import HiddenEffect
from firmware_sim.physics.maths import Value
from firmware_sim.tables import ScenarioError

_MODULES = (
    aerodynamic, unsteady, inertial, propulsion, actuator, sensor, environment,
    longitudinal, elevator, longitudinal_sensor, cross_axis, uncatalogued, sudden,
)  # fmt: skip

EFFECTS: Mapping[str, type[HiddenEffect]] = {
    effect.name: effect
    for module in _MODULES
    for effect in vars(module).values()
    if isinstance(effect, type) and issubclass(effect, HiddenEffect) and "name" in vars(effect)
}


def make_effects(hidden: Sequence[tuple[str, Value]]) -> tuple[HiddenEffect, ...]:
    """Effects by (name, scale); raises ScenarioError for an unknown name."""
    unknown = [name for name, _ in hidden if name not in EFFECTS]
    if unknown:
        raise ScenarioError(f"hidden: no effect named {unknown[0]!r}; known are {', '.join(sorted(EFFECTS))}")
    return tuple(EFFECTS[name](scale) for name, scale in hidden)
