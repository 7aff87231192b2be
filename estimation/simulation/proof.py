"""Proof of an export: the written aircraft is flown by JSBSim, the model it was written from moves by its own equations
with the same surfaces, and the two are compared in units of what sensors could see."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from estimation.engine.data import Preparation
from estimation.engine.simulate import simulate
from estimation.models.base import Model
from estimation.simulation.along_flight import along
from estimation.simulation.attach import carrying, computed, without_simulation
from estimation.simulation.jsbsim.export import Written
from estimation.simulation.jsbsim.flying import flown
from estimation.simulation.jsbsim.increments import Increments
from estimation.simulation.oracle import Array, Simulation
from groundstation.flight import Flight

DEG = float(np.pi / 180.0)
NOISE: Mapping[str, float] = {
    "p": 0.3 * DEG, "q": 0.3 * DEG, "r": 0.3 * DEG, "phi": 0.2 * DEG, "theta": 0.2 * DEG, "alpha": 0.2 * DEG, "beta": 0.2 * DEG,
    "V": 0.15, "ax": 0.05, "ay": 0.05, "az": 0.08,
}  # fmt: skip
"""What good sensors of a small aircraft scatter by [SI]."""
SHARE = 0.1  # of the noise: a difference that no flight shows
AS_IT_IS = Preparation(denoise=False, draws=0, keep_held=True)  # a flight without noise


@dataclass(frozen=True)
class ExportProof:
    """rms: output -> root mean square of JSBSim less our model [SI]; allowed: a tenth of a sensor's noise. flight: as flown."""

    rms: Mapping[str, float]
    allowed: Mapping[str, float]
    flight: Flight

    @property
    def failed(self) -> tuple[str, ...]:
        return tuple(n for n, v in self.rms.items() if not v <= self.allowed[n])


def proof_of(source: Path, simulation: Simulation, made: Written, found: Increments, rate: float) -> ExportProof:
    """Fly the written aircraft and the model side by side. Raises SimulationError where there is nothing to fly."""
    values = found.physical.starts()
    plays = {t.input: abs(values[t.parameters[0]]) for t in found.transforms if t.kind == "backlash"}
    flight = flown(source, made.root, any(t.startswith("fcs/") for t in made.terms), rate, plays)
    shown = moved(simulation, found.physical, flight)
    names = [n for n in found.physical.output_names if n in NOISE]
    off = {n: shown[:, found.physical.output_names.index(n)] - flight[n] for n in names}
    return ExportProof(
        {n: float(np.sqrt(np.mean(v**2))) for n, v in off.items()}, {n: SHARE * NOISE[n] for n in names}, flight
    )


def moved(simulation: Simulation, model: Model, flight: Flight) -> Array:
    """(N, ny) what a model on a simulation shows over a flight without noise, from its first state on."""
    told = along(simulation, without_simulation(model), [flight], preparation=AS_IT_IS, names=computed(model))
    (carried,) = carrying([flight], told)
    return simulate(model, carried, x0=_start(model, flight), substeps=1, preparation=AS_IT_IS)


def _start(model: Model, flight: Flight) -> Array:
    """(nx,) the first state: as flown, states of effects where their signal says."""
    first = {n: float(flight[n][0]) for n in flight.columns}
    return np.array([
        first[s.name] if s.name in first else first[s.start] if isinstance(s.start, str) else float(s.start or 0.0)
        for s in model.states
    ])  # fmt: skip
