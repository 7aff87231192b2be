"""Where a hidden effect can take hold of the simulated aircraft.

An effect overrides only the hooks it needs. All hooks see the Motion of one evaluation (floats of one flight or arrays of
many) and the state vector; an effect with states of its own finds them at `self.at`. Hooks run inside the integrator's
stages and must not change the effect; memory (backlash, held samples) changes in `commit`, once a step.
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
    """What flawless instruments at the CG would be shown: the truth, as hidden sensor effects bend it. SI, radians.

    arm_left, arm_right, arm_r are the servo arms where the potentiometers sit.
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
    """What an effect may know, and at `bind` change, of the aircraft that carries it: the plant is one.

    generators: one a flight; step_size [s]; mass [kg], inertia [kg m2], derivatives as they fly.
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
    """A hidden effect; `typical` is its size in the units of `unit` at scale 1."""

    name: ClassVar[str]
    title: ClassVar[str]
    group: ClassVar[str]
    unit: ClassVar[str]
    typical: ClassVar[float]
    states: ClassVar[int] = 0
    catalogued: ClassVar[bool] = True  # False: beyond the names a search is expected to know

    def __init__(self, scale: Value = 1.0) -> None:
        self.size: Value = self.typical * scale
        self.at = 0

    def bind(self, plant: Host) -> None:
        """Take what is needed from the plant (or change its mass and derivatives) before the flight."""
        self.xp = plant.xp
        self.plant = plant

    def draw(self, how: Callable[[np.random.Generator], float]) -> Value:
        """One random number per flight from the flights' own generators."""
        values = [how(generator) for generator in self.plant.generators]
        return values[0] if self.xp.flights is None else np.array(values)

    def draw_where(self, wanted: Any, how: Callable[[np.random.Generator], float]) -> Value:
        """Like `draw`, but only flights where `wanted` use up a number; 0 for the others."""
        flags = [bool(wanted)] if self.xp.flights is None else list(wanted)
        values = [how(g) if flag else 0.0 for g, flag in zip(self.plant.generators, flags, strict=True)]
        return values[0] if self.xp.flights is None else np.array(values)

    def start(self, m: "Motion", x: State) -> None:
        """Set the effect's own states and memory for a flight that starts in this motion."""

    def wind(self, m: "Motion", x: State) -> None:
        """Add to the wind m.wind_north, wind_east, wind_down [m/s] or gusts."""

    def linkage(self, m: "Motion", x: State) -> None:
        """Change where the surfaces stand for the given servo arms."""

    def coefficients(self, m: "Motion", x: State) -> None:
        """Add to the aerodynamic coefficients."""

    def forces(self, m: "Motion", x: State) -> None:
        """Add to the forces X Y Z [N] at the CG."""

    def moments(self, m: "Motion", x: State) -> None:
        """Add to the moments L M N [N m] about the CG; m.beta_dot is known here."""

    def derivatives(self, m: "Motion", x: State, dx: State) -> None:
        """Rates of the effect's own states."""

    def sense(self, s: Sensed, m: "Motion", x: State) -> None:
        """Bend what the instruments are shown."""

    def commit(self, m: "Motion", x: State) -> None:
        """Keep what must be remembered of a completed step."""


def overrides(effect: HiddenEffect, hook: str) -> bool:
    """Does the effect use this hook?"""
    return getattr(type(effect), hook) is not getattr(HiddenEffect, hook)
