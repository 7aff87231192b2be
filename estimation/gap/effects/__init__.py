"""The catalogue of candidate effects, and how a laboratory adds its own."""

from estimation.gap.effects.base import Effect, EffectParameter, Form, Group
from estimation.gap.effects.catalogue import catalogue, load_effects

__all__ = ["Effect", "EffectParameter", "Form", "Group", "catalogue", "load_effects"]
