"""Aircraft of autopilots' simulators as simulations: `ardupilot:FILE.json` and `gazebo:FILE.sdf`.

SITL flies accelerations, of 2 kg and 1 kg m2. Its coefficients are those that give an aircraft, with its own mass, inertia and
geometry, the same accelerations. A Gazebo model has its own mass and inertia, so its coefficients are used unchanged.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from estimation.aircraft import Aircraft
from estimation.simulation.autopilot.ardupilot import read_sitl_plane
from estimation.simulation.autopilot.equations import MASS, GazeboPlane, SitlPlane, gazebo_forces, sitl_accelerations
from estimation.simulation.autopilot.gazebo_file import read_gazebo_plane
from estimation.simulation.autopilot.linear import FlightStates
from estimation.simulation.oracle import Array, PolarOfAlpha, Simulation, SimulationError, States

ARDUPILOT, GAZEBO = "ardupilot:", "gazebo:"  # begin the text that names a simulation


@dataclass(frozen=True)
class SitlOracle:
    """The coefficients of a SITL plane; see `estimation.simulation.oracle.Oracle`. aircraft: the one to which they refer."""

    plane: SitlPlane
    aircraft: Aircraft

    def coefficients(self, states: States) -> Array:
        a, axes = self.aircraft, sitl_accelerations(self.plane, _motion(states))
        force = [axes[axis] * a.mass for axis in ("X", "Y", "Z")]
        L, N = a.Ixx * axes["L"] - a.Ixz * axes["N"], a.Izz * axes["N"] - a.Ixz * axes["L"]
        return _over_pressure(states, a, [*force, L, axes["M"] * a.Iyy, N])


@dataclass(frozen=True)
class GazeboOracle:
    """The coefficients of a Gazebo model; see `estimation.simulation.oracle.Oracle`. Density is that of the state."""

    plane: GazeboPlane

    def coefficients(self, states: States) -> Array:
        force = gazebo_forces(replace(self.plane, values={**self.plane.values, "air_density": 1.0}), _motion(states))
        return _over_pressure(states, self.plane.aircraft, [states.rho * v for v in force.values()])


def _motion(states: States) -> FlightStates:
    return FlightStates({**states.values, "rho": states.rho})


def _over_pressure(states: States, a: Aircraft, force: list[Array]) -> Array:
    """(N, 6) coefficients of three forces and three moments."""
    area = 0.5 * states.rho * states.values["V"] ** 2 * a.area
    return np.column_stack(
        [f / (area * size) for f, size in zip(force, (1, 1, 1, a.span, a.chord, a.span), strict=True)]
    )


def ardupilot_simulation(file: str) -> Simulation:
    """SITL's plane from its file. Raises SimulationError."""
    path = Path(file)
    plane = read_sitl_plane(path)
    k = plane.values
    name = path.stem
    if plane.real:
        own = Aircraft(name, **plane.real, title=f"ArduPilot SITL plane {name}")  # type: ignore[arg-type]
    else:
        own = Aircraft(name, span=k["b"], area=k["s"], chord=k["c"], mass=MASS, Ixx=1.0, Iyy=1.0, Izz=1.0, Ixz=0.0,
                       title=f"ArduPilot SITL plane {name}, of 2 kg and 1 kg m2")  # fmt: skip

    def referred(aircraft: Aircraft) -> Simulation:
        aircraft.need(("m", "S", "b", "c", "Ixx", "Iyy", "Izz"), f"{ARDUPILOT}{file}")
        return replace(simulation, oracle=SitlOracle(plane, aircraft), polar=_polar_of_alpha(plane, aircraft))

    simulation = Simulation(f"{ARDUPILOT}{file}", name, SitlOracle(plane, own), own, plane.notes, referred)
    return simulation


def _polar_of_alpha(plane: SitlPlane, aircraft: Aircraft) -> PolarOfAlpha:
    """SITL's induced drag in coefficients of the aircraft, whose mass and area differ from 2 kg and the file's."""
    k = plane.values
    scale = k["s"] * aircraft.mass / (MASS * aircraft.area)
    CD_k = 1.0 / (np.pi * k["oswald"] * k["b"] ** 2 / k["s"])
    return PolarOfAlpha(scale * k["c_lift_0"], scale * k["c_lift_a"], CD_k / scale)


def gazebo_simulation(file: str) -> Simulation:
    """A Gazebo aeroplane from its model.sdf, or the folder that contains it. Raises SimulationError."""
    path = Path(file)
    if path.is_dir():
        path /= "model.sdf"
    if path.suffix != ".sdf":
        raise SimulationError(f"{GAZEBO}{file}: give a model's file that ends in .sdf, or its folder")
    plane = read_gazebo_plane(path)
    return Simulation(f"{GAZEBO}{file}", plane.aircraft.name, GazeboOracle(plane), plane.aircraft, plane.notes)
