"""What can be wrong with a flight."""

from collections.abc import Sequence

from daq.contract.errors import UserError


class FlightError(UserError):
    """A flight file that cannot be used."""


class MissingColumnError(FlightError):
    """A column that the work at hand needs is not in the flight."""

    def __init__(self, flight: str, missing: Sequence[str], purpose: str) -> None:
        self.missing = tuple(missing)
        names = ", ".join(missing)
        plural = "s" if len(missing) > 1 else ""
        instead = " or choose a model without" if purpose.startswith("model") else ""
        super().__init__(
            f"{flight}: column{plural} {names} missing, needed for {purpose}; add the column{plural}{instead}"
        )
