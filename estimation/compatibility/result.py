"""What a data-compatibility check finds: factors with bounds, and the motion the flight's own inputs make."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class FactorEstimate:
    """One instrument factor. std: bound from the information of the innovations; std_coloured: corrected for the colour
    left in them. Where the channel it belongs to is not measured, all three are NaN and `why` says so."""

    name: str
    unit: str
    estimate: float
    std: float
    std_coloured: float
    identifiable: bool
    why: str = ""


@dataclass(frozen=True)
class ReconstructedFlight:
    """measured: (N, ny), NaN where not measured or left out; reconstructed: (N, ny) motion integrated from accelerations
    and rates with the factors, NaN outside the records; noise: of each output; whiteness: lag-one autocorrelation of the
    normalised innovations per output."""

    name: str
    time: Array
    measured: Array
    reconstructed: Array
    outputs: tuple[str, ...]
    noise: Mapping[str, float]
    whiteness: Mapping[str, float]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Compatibility:
    """Factors of one flight, or shared by several."""

    factors: Mapping[str, FactorEstimate]
    correlation: Array
    flights: tuple[ReconstructedFlight, ...]
    converged: bool
    text: str
    iterations: int
    turbulence: float  # m/s per root second
    known: Mapping[str, float] = field(default_factory=dict)  # factors held at values given
