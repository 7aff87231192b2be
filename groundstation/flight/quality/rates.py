"""Whether samples come fast enough for the motion of an aircraft to be told from them."""

from collections.abc import Iterable

from groundstation.flight.flight import Flight

FAST = ("p", "q", "r", "ax", "ay", "az", "phi", "theta", "alpha", "beta", "delta_e", "delta_a", "delta_r")
"""Columns that follow the fast modes; airspeed, height and heading may come slower."""
SLOWEST = 5.0
"""Samples a second below which roll damping and short period pass between two of them: their time constants are 0.05 to 0.5 s.
Telemetry of 4 Hz gave derivatives hundreds of bounds off, of 10 Hz right ones."""
GOOD = 20.0
"""[Hz] from which roll damping of a light aircraft is told well."""


def too_slow(flight: Flight, columns: Iterable[str]) -> str:
    """Why a flight is too slow for a model that uses some columns; empty where it is not."""
    every = 1.0 / flight.sample_interval
    used = set(columns)
    rates = {c: min(flight.native_rate(c) or every, every) for c in FAST if c in used and flight.measured(c)}
    slow = {c: rate for c, rate in rates.items() if rate < SLOWEST}
    if not slow:
        return ""
    lowest = min(slow.values())
    return (
        f"{', '.join(slow)} come at {lowest:.2g} Hz, too slow for any model of the motion: log at least {2 * SLOWEST:.0f} Hz, "
        f"better {GOOD:.0f} Hz or more"
    )
