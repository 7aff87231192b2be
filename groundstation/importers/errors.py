"""The error of importing, with a message on what to correct."""

from daq.utilities.errors import UserError


class ImportDataError(UserError):
    """A file of another program, or its mapping, that cannot be used."""
