"""Errors of the gap workflow."""

from estimation.errors import EstimationError


class GapError(EstimationError):
    """The gap workflow cannot run on these flights and this model."""


class EffectError(EstimationError):
    """A candidate effect that cannot be used."""
