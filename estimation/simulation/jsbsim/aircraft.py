"""Coefficients of a JSBSim aircraft at any state: set initial conditions, `run_ic`, read forces and moments.

Its flight control is off (it would overwrite the surfaces) and no engine runs, so forces are aerodynamic only. JSBSim's alphadot
is that of its own last step and cannot be set. So each state is evaluated at two attitudes, which change alphadot but not the
air, and the coefficients are interpolated linearly to the wanted alphadot.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from daq.utilities.constants import FOOT, SEA_LEVEL_DENSITY, SLUG
from estimation.aircraft import Aircraft
from estimation.simulation.jsbsim.library import (
    EXPORTED,
    SLUG_FOOT2,
    Surfaces,
    aircraft_file,
    knows_property,
    loaded,
    surfaces_of,
)
from estimation.simulation.oracle import COEFFICIENTS, SURFACES, Array, Simulation, SimulationError, States

ATTITUDES = (0.0, 1.0)  # rad of pitch: gravity across the flow differs by 0.46 g, and alphadot by that over V
GROUND = -30_000.0  # ft: far below, so that nothing flies in ground effect or stands on its wheels
LARGEST_ANGLE = math.radians(85.0)  # of alpha and beta: JSBSim hangs near 90 deg
HELD = "held as JSBSim starts"
SETTLED_RUNS = 10  # of `run_ic`, after which forces and the last step that they depend on no longer change
AGREES = 1e-6  # rad and relative: largest difference of JSBSim's alpha, beta, V from those that were set
STANDARD_EXPONENT, STANDARD_LAPSE = 4.25588, 2.25577e-5  # of density, and 1/m, in the ICAO troposphere
SWITCHED_OFF = tuple(f"simulation/models/{name}/enabled" for name in ("FGFCS", "FGPropulsion"))
FORCES = tuple(f"forces/fb{axis}-aero-lbs" for axis in "xyz")
MOMENTS = tuple(f"moments/{axis}-aero-lbsft" for axis in "lmn")
SETTINGS = {
    "alpha": "ic/alpha-rad",
    "beta": "ic/beta-rad",
    "p": "ic/p-rad_sec",
    "q": "ic/q-rad_sec",
    "r": "ic/r-rad_sec",
}


@dataclass(frozen=True)
class JsbsimOracle:
    """The coefficients of a JSBSim aircraft; see `estimation.simulation.oracle.Oracle`. fdm: the executive, which keeps only
    alphadot from one state to the next."""

    path: Path
    fdm: Any
    surfaces: Surfaces

    def coefficients(self, states: States) -> Array:
        result = np.empty((len(states), len(COEFFICIENTS)))
        for i in range(len(states)):
            result[i] = self._loads_at({n: float(v[i]) for n, v in states.values.items()}, float(states.rho[i]),
                                 float(states.alpha_dot[i])) / self._sizes()  # fmt: skip
        return result

    def at_its_own_rate(self, state: dict[str, float], rho: float, attitude: float) -> tuple[Array, float]:
        """(6,) coefficients of one state and JSBSim's own rate of alpha [rad/s] there, at an attitude [rad of pitch]."""
        loads, rate = self._loads_and_rate(state, rho, attitude, SETTLED_RUNS)
        return loads / self._sizes(), rate

    def _sizes(self) -> Array:
        """(6,) area [ft2], for moments times a length [ft3]."""
        area, span, chord = (self.fdm[f"metrics/{n}"] for n in ("Sw-sqft", "bw-ft", "cbarw-ft"))
        return np.asarray(area * np.array([1.0, 1.0, 1.0, span, chord, span]))

    def _loads_at(self, state: dict[str, float], rho: float, alpha_dot: float) -> Array:
        """(6,) forces and moments over dynamic pressure [ft2, ft3] at one state."""
        if not (
            state["V"] > 0.0
            and max(abs(state["alpha"]), abs(state["beta"])) < LARGEST_ANGLE
            and _finite(state, rho, alpha_dot)
        ):
            self._refuse(state)  # here, because JSBSim would never return from such a state
        loads, rate = self._loads_and_rate(state, rho, ATTITUDES[0])
        if not self.surfaces.rates:
            return loads
        other_loads, other_rate = self._loads_and_rate(state, rho, ATTITUDES[1])
        return np.asarray(loads + (other_loads - loads) * (alpha_dot - rate) / (other_rate - rate))

    def _loads(self) -> Array:
        """(6,) JSBSim's present forces and moments over the dynamic pressure [ft2, ft3]."""
        return np.array([self.fdm[n] for n in (*FORCES, *MOMENTS)]) / self.fdm["aero/qbar-psf"]

    def _loads_and_rate(
        self, state: dict[str, float], rho: float, attitude: float, runs: int = 1
    ) -> tuple[Array, float]:
        """(6,) loads over dynamic pressure and JSBSim's rate of alpha after at least so many runs of `run_ic`."""
        fdm = self.fdm
        fdm["ic/h-sl-ft"] = density_altitude(rho) / FOOT
        fdm["ic/vt-fps"] = state["V"] / FOOT
        fdm["ic/theta-rad"] = attitude
        for name, setting in SETTINGS.items():
            fdm[setting] = state[name]
        for name, (column, follows) in self.surfaces.writes.items():
            fdm[name] = follows(state[column])
        for _ in range(max(runs, 2 if self.surfaces.lift_squared else 1)):
            fdm.run_ic()
        self._check(state)
        loads = self._loads()
        if not np.isfinite(loads).all():
            fdm.run_ic()  # once in hundreds of processes JSBSim gives NaN, and a number at the second run
            loads = self._loads()
        if not np.isfinite(loads).all():
            raise SimulationError(
                f"{self.path}: its aerodynamics makes no number of V {state['V']:.3g} m/s, alpha"
                f" {math.degrees(state['alpha']):.3g} deg, beta {math.degrees(state['beta']):.3g} deg"
            )
        return loads, fdm["aero/alphadot-rad_sec"]

    def _check(self, state: dict[str, float]) -> None:
        """Raise SimulationError where JSBSim did not take the state that was set."""
        speed = self.fdm["velocities/vt-fps"] * FOOT
        deviation = max(abs(speed / state["V"] - 1.0),
                  *(abs(self.fdm[f"aero/{n}-rad"] - state[n]) for n in ("alpha", "beta")))  # fmt: skip
        if not deviation < AGREES:
            self._refuse(state)

    def _refuse(self, state: dict[str, float]) -> NoReturn:
        raise SimulationError(
            f"{self.path}: JSBSim cannot be put at V {state['V']:.3g} m/s, alpha {math.degrees(state['alpha']):.3g} deg, beta"
            f" {math.degrees(state['beta']):.3g} deg; are these columns in SI units and radians?"
        )


def _finite(state: dict[str, float], rho: float, alpha_dot: float) -> bool:
    return all(math.isfinite(v) for v in (*state.values(), rho, alpha_dot)) and rho > 0.0


def density_altitude(rho: float) -> float:
    """Height [m] at which the standard atmosphere's troposphere has density `rho` [kg/m3] (ICAO Doc 7488)."""
    return (1.0 - (rho / SEA_LEVEL_DENSITY) ** (1.0 / STANDARD_EXPONENT)) / STANDARD_LAPSE


def jsbsim_simulation(which: str) -> Simulation:
    """The simulation of the aircraft `which`: a name of JSBSim's own, a folder or a file. Raises SimulationError."""
    path = aircraft_file(which)
    surfaces = surfaces_of(path)
    fdm = loaded(path)
    for name in (*SWITCHED_OFF, "ic/terrain-elevation-ft", *surfaces.writes):
        if not knows_property(fdm, name):
            raise SimulationError(f"{path}: JSBSim knows no property {name}, which its aerodynamics reads")
    for name in SWITCHED_OFF:
        fdm[name] = 0
    fdm["ic/terrain-elevation-ft"] = GROUND
    notes = []
    unread = [n for n in SURFACES if n not in {column for column, _ in surfaces.writes.values()}]
    if unread:
        notes.append(
            f"the aerodynamics of {path.stem} reads no position that is known as {', '.join(unread)}: without effect there"
        )
    if surfaces.held:
        notes.append(f"the aerodynamics of {path.stem} also reads {', '.join(surfaces.held)}: {HELD}")
    actuated_surfaces = [n for n in surfaces.writes if n.startswith(f"fcs/{EXPORTED}")]
    if actuated_surfaces:
        notes.append(
            f"{', '.join(actuated_surfaces)}: given as measured, without the actuator that was exported before it"
        )
    oracle = JsbsimOracle(path, fdm, surfaces)
    return Simulation(f"jsbsim:{which}", path.stem, oracle, aircraft_as_loaded(fdm, path.stem), tuple(notes))


def aircraft_as_loaded(fdm: Any, name: str) -> Aircraft:
    """Geometry, mass and inertia after `run_ic`, with the fuel and loads of the file.

    JSBSim's property ixz is the element of the inertia matrix; ours is the product of inertia, with the other sign. Raises
    SimulationError for numbers that no aircraft has, with which JSBSim would compute.
    """
    fdm["ic/vt-fps"] = 100.0
    fdm.run_ic()
    inertia = {axis: fdm[f"inertia/{axis}-slugs_ft2"] * SLUG_FOOT2 for axis in ("ixx", "iyy", "izz", "ixz")}
    aircraft = Aircraft(
        name, span=fdm["metrics/bw-ft"] * FOOT, area=fdm["metrics/Sw-sqft"] * FOOT**2,
        chord=fdm["metrics/cbarw-ft"] * FOOT, mass=fdm["inertia/mass-slugs"] * SLUG,
        Ixx=inertia["ixx"], Iyy=inertia["iyy"], Izz=inertia["izz"], Ixz=-inertia["ixz"],
        title=f"JSBSim aircraft {name}",
    )  # fmt: skip
    if aircraft.impossible:
        raise SimulationError(
            f"JSBSim aircraft {name}: no aircraft has {aircraft.impossible} (SI units; with fuel and loads); correct its"
            " metrics or mass_balance"
        )
    return aircraft
