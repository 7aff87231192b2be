"""Errors of the gap workflow."""

from estimation.errors import EstimationError


class GapError(EstimationError):
    """The gap workflow cannot be run on what was given."""


class EffectError(EstimationError):
    """A candidate effect that cannot be used."""
