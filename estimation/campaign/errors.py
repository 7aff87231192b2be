"""Errors of a campaign: what, where, and what to do."""

from estimation.errors import EstimationError


class CampaignError(EstimationError):
    """A plan, an output folder or an engine that cannot be used."""


class OverdueError(EstimationError):
    """A piece of work that took longer than it may."""
