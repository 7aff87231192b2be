"""Errors of importing that a person can act on."""

from daq.utilities.errors import UserError


class ImportDataError(UserError):
    """Foreign data, or a mapping for it, that cannot be used."""
