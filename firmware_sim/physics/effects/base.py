"""The base of hidden effects: hooks through which an effect changes the simulated aircraft.

An effect overrides only the hooks that it needs. Each hook gets the Motion of one evaluation (floats for one flight, arrays for
many) and the state vector, in which the effect's own states begin at index `self.at`. Hooks run inside the integrator's stages
and must not change the effect; its memory (backlash, repeated samples) changes in `commit`, once a step.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np

from firmware_sim.physics.maths import Maths, State, Value

if TYPE_CHECKING:
    from estimation.aircraft import Aircraft
    from firmware_sim.physics.motion import Motion


@dataclass(slots=True)
class Sensed:
    """The quantities that error-free instruments at the CG measure: the truth, changed by hidden sensor effects. SI, radians.

    arm_left, arm_right, arm_r: angles of the servo arms, which carry the potentiometers.
    """

    ax: Value
    ay: Value
    az: Value
    p: Value
    q: Value
    r: Value
    phi: Value
    theta: Value
    psi: Value
    alpha: Value
    beta: Value
    V: Value
    arm_left: Value
    arm_right: Value
    arm_r: Value


class Host(Protocol):
    """The part of the plant that an effect may read, and may change at `bind`.

    generators: one per flight; step_size [s]; derivatives, mass [kg], Ixx, Ixz [kg m2]: of the flying aircraft.
    """

    aircraft: "Aircraft"
    xp: Maths
    step_size: float
    generators: Sequence[np.random.Generator]
    derivatives: dict[str, Value]
    mass: Value
    Ixx: Value
    Ixz: Value


class HiddenEffect:
    """A hidden effect. typical: its size at scale 1, in `unit`; states: number of its own states."""

    name: ClassVar[str]
    title: ClassVar[str]
    group: ClassVar[str]
    unit: ClassVar[str]
    typical: ClassVar[float]
    states: ClassVar[int] = 0
    catalogued: ClassVar[bool] = True  # False: a search is not expected to know its name

    def __init__(self, scale: Value = 1.0) -> None:
        self.size: Value = self.typical * scale
        self.at = 0

    def bind(self, plant: Host) -> None:
        """Take what is needed from the plant, or change its mass, inertia and derivatives, before the flight."""
        self.xp = plant.xp
        self.plant = plant

    def draw(self, sample: Callable[[np.random.Generator], float]) -> Value:
        """One random number per flight, `sample` of the flight's own generator."""
        values = [sample(generator) for generator in self.plant.generators]
        return values[0] if self.xp.flights is None else np.array(values)

    def draw_where(self, selected: Any, sample: Callable[[np.random.Generator], float]) -> Value:
        """Like `draw`, but only for the selected flights; 0 for the others, whose generators are not advanced."""
        flags = [bool(selected)] if self.xp.flights is None else list(selected)
        values = [sample(g) if flag else 0.0 for g, flag in zip(self.plant.generators, flags, strict=True)]
        return values[0] if self.xp.flights is None else np.array(values)

    def start(self, m: "Motion", x: State) -> None:
        """Set the effect's own states and memory at the start of a flight."""

    def wind(self, m: "Motion", x: State) -> None:
        """Add to the wind m.wind_north, wind_east, wind_down [m/s] or to the gusts."""

    def linkage(self, m: "Motion", x: State) -> None:
        """Change the surface deflections for the given servo arms."""

    def coefficients(self, m: "Motion", x: State) -> None:
        """Add to the aerodynamic coefficients."""

    def forces(self, m: "Motion", x: State) -> None:
        """Add to the forces X Y Z [N] at the CG."""

    def moments(self, m: "Motion", x: State) -> None:
        """Add to the moments L M N [N m] about the CG; m.beta_dot is set already."""

    def derivatives(self, m: "Motion", x: State, dx: State) -> None:
        """Set the rates of the effect's own states."""

    def sense(self, s: Sensed, m: "Motion", x: State) -> None:
        """Change the quantities that the instruments measure."""

    def commit(self, m: "Motion", x: State) -> None:
        """Update the effect's memory after a completed step."""


def overrides(effect: HiddenEffect, hook: str) -> bool:
    """Whether the effect uses this hook."""
    return getattr(type(effect), hook) is not getattr(HiddenEffect, hook)
