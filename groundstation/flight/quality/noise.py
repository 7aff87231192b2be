"""The white noise of a channel, estimated from its samples, and whether a flight is sampled fast enough for a model."""

from collections.abc import Iterable

import numpy as np

from groundstation.flight.arrays import Array
from groundstation.flight.flight import Flight

_MAD_TO_SIGMA = 1.482602218505602  # of a normal distribution
_THIRD_DIFFERENCE_GAIN = 20.0  # variance of y3 - 3 y2 + 3 y1 - y0 for white y of variance 1
_FEWEST_SAMPLES = 12  # differences, for a median to be of use

FAST = ("p", "q", "r", "ax", "ay", "az", "phi", "theta", "alpha", "beta", "delta_e", "delta_a", "delta_r")
"""Columns of the fast modes; airspeed, height and heading may be sampled more slowly."""
LEAST_RATE = 5.0
"""[Hz] below which roll and short period, with time constants of 0.05 to 0.5 s, decay between two samples. Derivatives from
telemetry of 4 Hz were wrong by hundreds of their bounds, from 10 Hz right."""
GOOD_RATE = 20.0  # [Hz] from which the roll damping of a light aircraft can be identified well


def noise(values: Array) -> float | None:
    """Standard deviation of the white noise of evenly sampled values (N,), in their unit; None for too few samples.

    Third differences remove motion up to a parabola through four samples; their median absolute deviation is insensitive to edges
    and spikes. A channel that mostly repeats its value (quantised, commanded) has noise 0.
    """
    third = np.diff(values, 3)
    third = third[np.isfinite(third)]
    if third.size < _FEWEST_SAMPLES:
        return None
    return float(_MAD_TO_SIGMA * np.median(np.abs(third - np.median(third))) / np.sqrt(_THIRD_DIFFERENCE_GAIN))


def too_slow(flight: Flight, columns: Iterable[str]) -> str:
    """Why a flight is sampled too slowly for a model that uses `columns`, as a sentence; empty where it is not."""
    sample_rate = 1.0 / flight.sample_interval
    model_columns = set(columns)
    rates = {
        c: min(flight.native_rate(c) or sample_rate, sample_rate)
        for c in FAST
        if c in model_columns and flight.measured(c)
    }
    slow = {c: rate for c, rate in rates.items() if rate < LEAST_RATE}
    if not slow:
        return ""
    return (
        f"{', '.join(slow)} come at {min(slow.values()):.2g} Hz, too slow for any model of the motion: log at least "
        f"{2 * LEAST_RATE:.0f} Hz, better {GOOD_RATE:.0f} Hz or more"
    )
