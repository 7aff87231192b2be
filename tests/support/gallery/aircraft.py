"""Aircraft of JSBSim as they are flown here: engine off, surfaces written into them, asked for their derivatives.

Shares nothing with the packages under test. JSBSim's words: left aileron trailing edge down rolls right; our +delta_a rolls left.
"""

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import jsbsim
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
FOOT, POUND, SLUG = 0.3048, 4.4482216152605, 14.593902937206
OWN = Path(jsbsim.get_default_root_dir())
HEIGHT = 1800.0  # m
RATE = 200  # Hz


@dataclass(frozen=True)
class Kind:
    """An aircraft and how it is flown. speed: of the glide [m/s]; pace: of a short pulse [s]; aileron, rudder: peaks [rad]."""

    name: str
    speed: float
    pace: float
    aileron: float
    rudder: float


def executive(name: str, folder: Path) -> Any:
    """JSBSim with an aircraft that writes no files and opens no sockets; `folder` takes its copy."""
    made = folder / name
    if not made.exists():
        shutil.copytree(OWN / "aircraft" / name, made)
        tree = ET.parse(made / f"{name}.xml")
        root = tree.getroot()
        for talk in [*root.findall("output"), *root.findall("input")]:  # files, and sockets that listen
            root.remove(talk)
        tree.write(made / f"{name}.xml", encoding="utf-8")
    jsbsim.FGJSBBase().debug_lvl = 0
    fdm = jsbsim.FGFDMExec(None)
    fdm.set_dt(1.0 / RATE)
    fdm.set_aircraft_path(str(folder))
    fdm.set_engine_path(str(OWN / "engine"))
    fdm.set_systems_path(str(OWN / "systems"))
    if not fdm.load_model(name):
        raise RuntimeError(f"JSBSim cannot load {name}")
    for kind in ("rate", "position"):
        for motion in ("rotational", "translational"):
            fdm[f"simulation/integrator/{kind}/{motion}"] = (
                3  # Adams-Bashforth; Euler errs by tenths of a degree per second
            )
    fdm["simulation/models/FGFCS/enabled"] = 0
    # at 45 degrees of latitude gravity less the earth's rotation is that of the textbook
    fdm["ic/lat-geod-deg"], fdm["ic/psi-true-rad"] = 45.0, 1.5
    fdm["ic/h-sl-ft"], fdm["ic/terrain-elevation-ft"] = HEIGHT / FOOT, 0.0
    return fdm


def put_surfaces(fdm: Any, elevator: float, aileron: float, rudder: float) -> None:
    """Our deflections [rad] into every word that JSBSim aircraft read; a normalised one as deflection over travel 0.35 rad."""
    for word, value in (
        ("elevator", elevator),
        ("rudder", rudder),
        ("left-aileron", -aileron),
        ("right-aileron", aileron),
    ):
        fdm[f"fcs/{word}-pos-rad"] = value
        fdm[f"fcs/{word}-pos-deg"] = float(np.degrees(value))
        fdm[f"fcs/{word}-pos-norm"] = value / TRAVEL


TRAVEL = 0.35  # rad


def glide(fdm: Any, speed: float) -> Array:
    """alpha, theta, phi, elevator, aileron, rudder [rad] of a steady glide without sideslip, in which the executive is left."""

    def off(x: Array) -> Array:
        set_state(fdm, speed, x[0], 0.0, x[1], x[2], np.zeros(3), x[3:])
        linear = [fdm[f"accelerations/{n}dot-ft_sec2"] / 32.2 for n in "uvw"]
        return np.array([*linear, *(fdm[f"accelerations/{n}dot-rad_sec2"] for n in "pqr")])

    x, step = np.array([0.03, -0.05, 0.0, 0.0, 0.0, 0.0]), 1e-3
    for _ in range(40):
        left = off(x)
        slopes = np.column_stack([(off(x + step * e) - off(x - step * e)) / (2 * step) for e in np.eye(6)])
        x = x - np.clip(np.linalg.lstsq(slopes, left, rcond=1e-6)[0], -0.05, 0.05)
    left = off(x)
    if not np.abs(left).max() < 1e-4:
        raise RuntimeError(f"{fdm.get_model_name()} finds no glide at {speed} m/s")
    return x


def set_state(
    fdm: Any, speed: float, alpha: float, beta: float, theta: float, phi: float, rates: Array, surfaces: Array
) -> None:
    """Forces and moments at a state: run_ic more than once, for what a force takes from the last step."""
    fdm["ic/vt-fps"] = speed / FOOT
    fdm["ic/theta-rad"], fdm["ic/phi-rad"], fdm["ic/alpha-rad"], fdm["ic/beta-rad"] = theta, phi, alpha, beta
    for name, rate in zip("pqr", rates, strict=True):
        fdm[f"ic/{name}-rad_sec"] = float(rate)
    put_surfaces(fdm, *surfaces)
    for _ in range(3):
        fdm.run_ic()


def properties(fdm: Any) -> dict[str, float]:
    """Mass, inertia and shape in SI, as an aircraft file has them."""
    inertia = SLUG * FOOT**2
    return {
        "span": fdm["metrics/bw-ft"] * FOOT,
        "area": fdm["metrics/Sw-sqft"] * FOOT**2,
        "chord": fdm["metrics/cbarw-ft"] * FOOT,
        "mass": fdm["inertia/mass-slugs"] * SLUG,
        "Ixx": fdm["inertia/ixx-slugs_ft2"] * inertia,
        "Iyy": fdm["inertia/iyy-slugs_ft2"] * inertia,
        "Izz": fdm["inertia/izz-slugs_ft2"] * inertia,
        "Ixz": -fdm["inertia/ixz-slugs_ft2"]
        * inertia,  # JSBSim's files have the product of inertia with the other sign
    }


def lateral_derivatives(fdm: Any, at: Mapping[str, Array], rows: NDArray[np.int64]) -> dict[str, float]:
    """CY, Cl, Cn by beta, p, r, da, dr: central differences of JSBSim's forces at rows of a flight, their mean over the rows."""
    shape = properties(fdm)
    for axis in ("north", "east", "down"):
        fdm[f"atmosphere/gust-{axis}-fps"] = 0.0
    found: dict[str, list[float]] = {}
    for row in rows:
        state = {n: float(v[row]) for n, v in at.items()}
        for word, (name, step) in STEPS.items():
            sides = []
            for sign in (1.0, -1.0):
                moved = {**state, name: state[name] + sign * step}
                rates = np.array([moved["p"], moved["q"], moved["r"]])
                surfaces = np.array([moved["delta_e"], moved["delta_a"], moved["delta_r"]])
                set_state(fdm, moved["V"], moved["alpha"], moved["beta"], moved["theta"], moved["phi"], rates, surfaces)
                density = (
                    fdm["atmosphere/rho-slugs_ft3"] * SLUG / FOOT**3
                )  # of this state, which is at the height of the start
                pressure = 0.5 * density * moved["V"] ** 2 * shape["area"]
                force = fdm["forces/fby-aero-lbs"] * POUND / pressure
                moments = [fdm[f"moments/{m}-aero-lbsft"] * POUND * FOOT / (pressure * shape["span"]) for m in "ln"]
                sides.append([force, *moments])
            unit = shape["span"] / (2.0 * state["V"]) if word in "pr" else 1.0
            for axis, slope in zip(("CY", "Cl", "Cn"), np.subtract(*sides) / (2.0 * step * unit), strict=True):
                found.setdefault(f"{axis}_{word}", []).append(float(slope))
    return {name: float(np.mean(values)) for name, values in found.items()}


STEPS = {
    "beta": ("beta", 0.01),
    "p": ("p", 0.02),
    "r": ("r", 0.02),
    "da": ("delta_a", 0.01),
    "dr": ("delta_r", 0.01),
}
