"""A flight as the engine needs it: de-noised inputs, measured outputs, initial states, cut at every gap."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from estimation.models.base import Model
from estimation.signals.rounding import Grid
from groundstation.flight import Array
from groundstation.flight.findings import Finding

SHORTEST_SEGMENT = 8  # samples
DRAWS = 24  # of the remaining errors of the inputs
SAMPLES_TIMES_DRAWS = 200_000  # at most: long flights need fewer draws, because they average over time
FEWEST_DRAWS = 12
PIECES = (8.0, 4.0, 2.0, 1.0)  # s: lengths into which an unstable motion is cut, tried from the longest on


@dataclass(frozen=True)
class Segment:
    """A stretch of samples covered by one integration.

    first: index of its first sample in the flight. time: (N,) s. u: (N, nu) inputs. z: (N, ny) outputs, NaN where not
    measured. x0: (nx,) guess of the initial state.
    """

    first: int
    time: Array
    u: Array
    z: Array
    x0: Array

    def __len__(self) -> int:
        return int(self.time.size)

    @property
    def rows(self) -> slice:
        """The segment's samples in the flight."""
        return slice(self.first, self.first + len(self))

    def part(self, start: int, stop: int, x0: Array) -> "Segment":
        """Samples start..stop-1 of the segment as a segment."""
        s = slice(start, stop)
        return Segment(self.first + start, self.time[s], self.u[s], self.z[s], x0)


@dataclass(frozen=True)
class FlightData:
    """A flight prepared for one model. samples: of the flight; states: (samples, nx) de-noised measured states, NaN where a state
    is not measured; noise: input -> (standard deviation, rms removed by de-noising); errors: (samples, nu, draws) draws of the
    remaining errors of the inputs (from the posterior of the de-noising, or of noise that was not removed; zero outside the
    segments), or None where unknown; follows: (samples, nu) the part of each control that follows the motion, where it was
    looked for; commands: control that is a recorded command -> interval of its record [s]; restless: controls that never
    rest, so that de-noising would take more signal than noise; grids: coarsely rounded control -> its levels."""

    name: str
    samples: int
    segments: tuple[Segment, ...]
    states: Array
    noise: Mapping[str, tuple[float, float]]
    notes: tuple[Finding, ...]
    absent_outputs: tuple[str, ...]
    errors: NDArray[np.float32] | None = None
    follows: Array | None = None
    commands: Mapping[str, float] = field(default_factory=dict)
    restless: frozenset[str] = frozenset()
    grids: Mapping[str, Grid] = field(default_factory=dict)

    @property
    def used(self) -> int:
        """Samples that lie in a segment."""
        return sum(len(s) for s in self.segments)

    def histories(self, ny: int) -> tuple[Array, Array]:
        """Time (samples,) and measured outputs (samples, ny), NaN outside the segments."""
        time, measured = np.full(self.samples, np.nan), np.full((self.samples, ny), np.nan)
        for s in self.segments:
            time[s.rows], measured[s.rows] = s.time, s.z
        return time, measured


@dataclass(frozen=True, slots=True)
class Preparation:
    """How measured signals are prepared. denoise: de-noise the measured inputs, edges preserved. draws: of their remaining
    errors, for the corrected bound (0: it takes the inputs for exact). keep_held: take the repeated values of slow and stuck
    sensors for measurements. feedback: in a model with pitch rate, controls keep their part that follows the motion, and their
    measured values near steps. every_axis: so do those of any model."""

    denoise: bool = True
    draws: int = DRAWS
    keep_held: bool = False
    feedback: bool = True
    every_axis: bool = False


AS_USUAL = Preparation()
FOR_REGRESSION = Preparation(feedback=False)  # noise in a regressor biases more than the loss of some feedback


def draws_for(samples: int) -> int:
    """Number of draws that describe the input errors of a flight of so many samples well enough."""
    return min(DRAWS, max(FEWEST_DRAWS, SAMPLES_TIMES_DRAWS // samples))


def without_absent_outputs(model: Model, flights: list[FlightData]) -> tuple[Model, list[FlightData]]:
    """Model and flights without the outputs that are absent from all flights."""
    absent = set(flights[0].absent_outputs).intersection(*(d.absent_outputs for d in flights[1:]))
    if not absent:
        return model, flights
    present = [i for i, n in enumerate(model.output_names) if n not in absent]
    reduced = []
    for flight in flights:
        segments = tuple(replace(s, z=np.ascontiguousarray(s.z[:, present])) for s in flight.segments)
        reduced.append(replace(flight, segments=segments, absent_outputs=()))
    return model.without_outputs(*absent), reduced


def cut_into_pieces(flight: FlightData, seconds: float) -> FlightData:
    """The flight with its segments cut into pieces of about `seconds`, each starting from its measured state."""
    parts = []
    for s in flight.segments:
        count = max(1, round((s.time[-1] - s.time[0]) / seconds))
        edges = np.linspace(0, len(s), count + 1).round().astype(int).tolist()
        for a, b in pairwise(edges):
            measured = flight.states[s.first + a]
            parts.append(s.part(a, b, np.where(np.isfinite(measured), measured, s.x0)))
    return replace(flight, segments=tuple(parts))
