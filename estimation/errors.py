"""Errors of the estimation laboratory: each message says what is wrong, where, and what to do."""

from daq.utilities.errors import UserError


class EstimationError(UserError):
    """Something a person can put right: a model file, an aircraft file, a flight or an option."""


class UnknownNameError(EstimationError, KeyError):
    """A name that an answer does not have."""

    __str__ = Exception.__str__  # KeyError would put the sentence in quotes


class AircraftError(EstimationError):
    """An aircraft file that cannot be used."""


class ModelError(EstimationError):
    """A postulated model that cannot be used."""


class DataError(EstimationError):
    """A flight that cannot feed the chosen model."""


class GapError(EstimationError):
    """The gap workflow cannot run on these flights and this model."""


class EffectError(EstimationError):
    """A candidate effect that cannot be used."""
