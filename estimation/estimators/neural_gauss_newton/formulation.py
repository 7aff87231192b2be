"""Training rows of one or several flights, and the unknowns, shared or local.

All flights share the network, and the aerodynamic parameters but for those that are local in the model.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from estimation.errors import EstimationError
from estimation.estimators.neural_gauss_newton.axes import Axis
from estimation.estimators.neural_gauss_newton.frozen import Standard
from estimation.estimators.neural_gauss_newton.samples import (
    COSTLY,
    SHORTEST,
    Form,
    SampleStretch,
    missing_optional,
    predicted_signals,
    require_columns,
    training_stretches,
)
from estimation.models.base import Model
from groundstation.flight import Array, Flight
from groundstation.flight.findings import Finding, FindingKind

Index = NDArray[np.int64]

BLOCK_S = 1.0  # of the block bootstrap: residuals are correlated over 0.2 s; half a minute has thirty blocks
HELD_OUT_EVERY, HELD_OUT_FIRST = 8, 4  # blocks that validate a network: an eighth of them, spread over the flight


@dataclass(frozen=True)
class FlightUnknowns:
    """The place of each flight's parameters among the n unknowns.

    names: (n,) of the unknowns, local ones once for each flight; owner: (n,) flight of each unknown, -1 for shared ones; base:
    (flights, axis parameters) values of fixed parameters; index: (flights, axis parameters) place among the unknowns, -1 for
    fixed ones; start: (n,) values believed before flying.
    """

    names: tuple[str, ...]
    owner: tuple[int, ...]
    base: Array
    index: Index
    start: Array

    @classmethod
    def build(cls, model: Model, axis: Axis, flights: int) -> "FlightUnknowns":
        """Raises EstimationError where the model's parameters are not those of the axis."""
        mismatch = set(model.parameter_names) ^ set(axis.parameters)
        if mismatch:
            raise EstimationError(
                f"model {model.name}: Neural Gauss-Newton knows the built-in {axis.name} aerodynamics only, "
                f"not {', '.join(sorted(mismatch))}; use method ml"
            )
        names: list[str] = []
        owner: list[int] = []
        start: list[float] = []
        base, index = np.zeros((flights, len(axis.parameters))), np.full((flights, len(axis.parameters)), -1)
        parameters = [model.parameter(n) for n in axis.parameters]
        base[:] = [p.start if p.fixed else 0.0 for p in parameters]
        for local in (False, True):
            for j, p in enumerate(parameters):
                if p.fixed or (p.local and flights > 1) != local:
                    continue
                for f in range(flights) if local else (-1,):
                    index[f if local else slice(None), j] = len(names)
                    names.append(p.name)
                    owner.append(f)
                    start.append(p.start)
        return cls(tuple(names), tuple(owner), base, index, np.array(start))

    @property
    def size(self) -> int:
        return len(self.names)

    def of_flight(self, flight: int, values: Array) -> Array:
        """(axis parameters,) of one flight, from the values (n,) of the unknowns."""
        index = self.index[flight]
        return np.where(index >= 0, values[np.maximum(index, 0)], self.base[flight])

    def scatter(self, flight: int, slopes: Array) -> Array:
        """(M, out, n) derivatives by the unknowns, from those (M, out, axis parameters) of a flight."""
        index = self.index[flight]
        by_unknown = np.zeros((*slopes.shape[:2], self.size))
        by_unknown[:, :, index[index >= 0]] = slopes[:, :, index >= 0]
        return by_unknown


@dataclass(frozen=True)
class TrainingRows:
    """All M rows on which a network is trained. flight: of each stretch; step: sample interval [s]; u, z: (M, in) and (M, out)
    standardised; held_out: (M,) rows for validation; block: (M,) of the block bootstrap."""

    axis: Axis
    motion: tuple[str, ...]
    stretches: tuple[SampleStretch, ...]
    flight: tuple[int, ...]
    step: float
    standard: Standard
    u: torch.Tensor
    z: torch.Tensor
    held_out: torch.Tensor
    block: Index
    notes: tuple[Finding, ...]

    @classmethod
    def build(cls, axis: Axis, flights: Sequence[Flight], form: Form) -> "TrainingRows":
        """Raises MissingColumnError or DataError naming the flight that cannot be used."""
        for flight in flights:
            require_columns(axis, flight)
        missing = missing_optional(axis, flights)
        motion = tuple(c for c in axis.motion if c not in missing)
        stretch_list: list[SampleStretch] = []
        owner: list[int] = []
        notes = [
            Finding(FindingKind.NOT_MEASURED, f"{c} is not measured, or not throughout: the network does without it")
            for c in missing
        ]
        for i, flight in enumerate(flights):
            flight_stretches = training_stretches(axis, flight, form, motion)
            stretch_list += flight_stretches
            owner += [i] * len(flight_stretches)
            notes += _unused(flight, flight_stretches)
        standard = Standard.build(stretch_list)
        u = torch.as_tensor(np.vstack([standard.u(s.u) for s in stretch_list]))
        z = torch.as_tensor(np.vstack([standard.z(s.z) for s in stretch_list]))
        step = float(np.median([f.sample_interval for f in flights]))
        block = _blocks(stretch_list, step)
        held_out = torch.as_tensor(block % HELD_OUT_EVERY == HELD_OUT_FIRST)
        return cls(axis, motion, tuple(stretch_list), tuple(owner), step, standard, u, z, held_out, block, tuple(notes))

    def split(self, values: Array) -> list[Array]:
        """Values (M, ...) of all rows, as one array for each stretch."""
        return np.split(values, np.cumsum([len(s.u) for s in self.stretches])[:-1])

    def resampled(self, rng: np.random.Generator) -> Array:
        """(M,) how often each row is drawn, in whole blocks (Künsch 1989, Annals of Statistics 17, 1217-1241)."""
        count = int(self.block[-1]) + 1
        multiplicity = np.bincount(rng.integers(0, count, count), minlength=count)
        return multiplicity[self.block].astype(float)

    def instruments(self) -> list[dict[str, Array]]:
        """Signals of every stretch that do not share the noise of the measured ones."""
        return predicted_signals(self.axis, list(self.stretches), self.motion, self.step)


def _unused(flight: Flight, flight_stretches: Sequence[SampleStretch]) -> list[Finding]:
    """A note where more than COSTLY of a flight cannot be used."""
    covered = sum(len(s.u) + max(s.window, 1) for s in flight_stretches)
    if covered >= (1.0 - COSTLY) * len(flight):
        return []
    return [
        Finding(
            FindingKind.LEFT_OUT,
            f"{flight.name}: the networks saw {covered} of {len(flight)} samples; elsewhere a channel is missing, or the "
            f"stretch is shorter than {SHORTEST}",
        )
    ]


def _blocks(stretch_list: Sequence[SampleStretch], step: float) -> Index:
    """(M,) number of each row's block; no block spans two stretches."""
    length = max(2, round(BLOCK_S / step))
    numbers, first = [], 0
    for s in stretch_list:
        count = max(1, round(len(s.u) / length))
        numbers.append(first + np.minimum(np.arange(len(s.u)) * count // len(s.u), count - 1))
        first += count
    return np.concatenate(numbers)
