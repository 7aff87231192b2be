"""The errors' root under the name that the documentation gives it (docs/api.md)."""

from daq.utilities.errors import UserError

__all__ = ["UserError"]
