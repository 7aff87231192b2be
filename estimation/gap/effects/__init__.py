"""The catalogue of candidate effects, and how a laboratory adds its own."""

from estimation.gap.effects.base import Effect, EffectParameter, Form, Group, add_effect
from estimation.gap.effects.catalogue import catalogue, load_effects

__all__ = ["Effect", "EffectParameter", "Form", "Group", "add_effect", "catalogue", "load_effects"]
