"""What can be wrong with a flight."""

from collections.abc import Sequence

from daq.utilities.errors import UserError

UNKNOWN_SHOWN = 4  # of the columns with unknown names: a hint, not the list


class FlightError(UserError):
    """A flight file that cannot be used."""


class MissingColumnError(FlightError):
    """A needed column is not in the flight.

    purpose: what needs it. models: those that do without it. unknown: columns of the flight with unknown names, one of which may
    be it. either: columns of which one is enough. near: end of the sentence that names a similar column.
    """

    def __init__(
        self,
        flight: str,
        missing: Sequence[str],
        purpose: str,
        models: Sequence[str] = (),
        unknown: Sequence[str] = (),
        either: Sequence[str] = (),
        near: str = "",
    ) -> None:
        self.missing = tuple(missing)
        names = ", ".join(missing)
        plural = "s" if len(missing) > 1 else ""
        one_of = f" (of {' and '.join(either)} one would do)" if either else ""
        alternatives = f", or choose a model that does without: {', '.join(models)}" if models else ""
        if unknown:
            examples = ", ".join(unknown[:UNKNOWN_SHOWN]) + (", ..." if len(unknown) > UNKNOWN_SHOWN else "")
            alternatives += (
                f"; if it is there by another name ({examples}), 'sideslip import' with --map gives it its own"
            )
        super().__init__(
            f"{flight}: column{plural} {names} missing, needed for {purpose}{one_of}; add the column{plural}{alternatives}{near}"
        )
