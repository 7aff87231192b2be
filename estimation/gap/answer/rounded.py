"""Numbers as they stand in a JSON file."""


def rounded(value: float, digits: int = 4) -> float:
    """Rounded for a file; numbers that are not finite have no place in JSON and become None."""
    value = float(value)
    return round(value, digits) if value - value == 0.0 else None  # type: ignore[return-value]
