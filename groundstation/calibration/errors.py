"""Errors of calibration that a person can act on."""

from daq.contract.errors import UserError


class CalibrationError(UserError):
    """A calibration file, set or recording that cannot be used for calibrating."""
