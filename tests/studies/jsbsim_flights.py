"""Flights that JSBSim makes by itself, for tests and studies of `--simulation`: a third truth beside the other two.

Shares nothing with `estimation.simulation`: an aircraft of JSBSim (a copy in a folder of one's own where something is hidden in
it) is trimmed in a glide, its engine never runs, surfaces are written into it at 200 Hz, and what instruments at the CG would
show is sampled at 20 Hz. Rotation by Adams-Bashforth: JSBSim's Euler steps err by tenths of a degree per second. At 45 degrees of
latitude, where gravity less the earth's rotation is that of the textbook.
"""

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import jsbsim
import numpy as np
from numpy.typing import NDArray

from groundstation.flight import Flight

Array = NDArray[np.float64]
RATE, SAMPLE = 200, 20  # Hz
DEG = np.pi / 180
FOOT, SLUG = 0.3048, 14.593902937206
SERVO = 0.03  # s, first order: an edge that 20 Hz can follow
NOISE: Mapping[str, float] = {
    "p": 0.3 * DEG, "q": 0.3 * DEG, "r": 0.3 * DEG, "phi": 0.2 * DEG, "theta": 0.2 * DEG, "alpha": 0.2 * DEG, "beta": 0.2 * DEG,
    "V": 0.15, "ax": 0.05, "ay": 0.05, "az": 0.08, "delta_e": 0.05 * DEG, "delta_a": 0.05 * DEG, "delta_r": 0.05 * DEG,
}  # fmt: skip
OWN = Path(jsbsim.get_default_root_dir()) / "aircraft"
Input = Callable[[Array, int], Array]


@dataclass(frozen=True)
class Flown:
    """What to fly. file: NAME.xml in a folder NAME. lag: time constants [s] of surfaces behind what is recorded of them. trimmed:
    another aircraft in whose glide it begins; its flight control then runs, of which only the channel `sideslip` is left.
    integrator: JSBSim's number of the one it uses, 3 for Adams-Bashforth; None as JSBSim sets them."""

    file: Path
    seed: int
    speed: float = 50.0
    duration: float = 30.0
    lag: Mapping[str, float] = field(default_factory=dict)
    noise: float = 1.0
    size: float = 1.0
    trimmed: Path | None = None
    integrator: int | None = 3


def changed(folder: Path, base: str, change: Callable[[str], str], name: str = "") -> Path:
    """A copy of a JSBSim aircraft, its text changed; the file of the copy."""
    name = name or base
    made = folder / name
    shutil.copytree(OWN / base, made)
    text = (made / f"{base}.xml").read_text(encoding="utf-8")
    after = change(text)
    if name != base:
        (made / f"{base}.xml").unlink()
    (made / f"{name}.xml").write_text(after, encoding="utf-8")
    return made / f"{name}.xml"


def with_own_channel_only(file: Path, folder: Path) -> Path:
    """A copy of an exported aircraft whose flight control leaves the surfaces to us."""
    made = folder / file.stem
    shutil.copytree(file.parent, made)
    tree = ET.parse(made / file.name)
    for section in ("flight_control", "autopilot"):
        for control in tree.getroot().findall(section):
            for child in [c for c in control if not (c.tag == "channel" and c.get("name") == "sideslip")]:
                control.remove(child)
    tree.write(made / file.name)
    return made / file.name


def _executive(file: Path, integrator: int | None = 3) -> Any:
    jsbsim.FGJSBBase().debug_lvl = 0
    fdm = jsbsim.FGFDMExec(None)
    fdm.set_dt(1.0 / RATE)
    fdm.set_aircraft_path(str(file.parent.parent))
    if not fdm.load_model(file.stem):
        raise RuntimeError(f"JSBSim cannot load {file}")
    for kind in ("rate", "position") if integrator is not None else ():
        for motion in ("rotational", "translational"):
            fdm[f"simulation/integrator/{kind}/{motion}"] = integrator
    fdm["simulation/models/FGFCS/enabled"] = 0
    fdm["ic/psi-true-rad"], fdm["ic/lat-geod-deg"], fdm["ic/h-sl-ft"], fdm["ic/terrain-elevation-ft"] = (
        1.5,
        45.0,
        6000.0,
        0.0,
    )
    return fdm


def _surfaces(fdm: Any, elevator: float, aileron: float, rudder: float) -> None:
    fdm["fcs/elevator-pos-rad"], fdm["fcs/rudder-pos-rad"] = elevator, rudder
    fdm["fcs/left-aileron-pos-rad"], fdm["fcs/right-aileron-pos-rad"] = -aileron, aileron


def _glide(fdm: Any, speed: float) -> Array:
    """(elevator, aileron, rudder) [rad] of a steady glide, in which the executive is left."""

    def off(x: Array) -> Array:
        """Accelerations (6,) in g and rad/s2 at x = alpha, theta, phi, elevator, aileron, rudder."""
        fdm["ic/vt-fps"] = speed / FOOT
        fdm["ic/theta-rad"], fdm["ic/phi-rad"], fdm["ic/alpha-rad"] = x[1], x[2], x[0]
        fdm["ic/beta-rad"] = 0.0
        _surfaces(fdm, *x[3:])
        for _ in range(3):  # more than once, for what a force takes from the last step
            fdm.run_ic()
        rates = [fdm[f"accelerations/{n}dot-ft_sec2"] / 32.2 for n in "uvw"]
        return np.array([*rates, *(fdm[f"accelerations/{n}dot-rad_sec2"] for n in "pqr")])

    x, step = np.array([0.03, -0.05, 0.0, 0.0, 0.0, 0.0]), 1e-3
    for _ in range(30):
        left = off(x)
        slopes = np.column_stack([(off(x + step * e) - off(x - step * e)) / (2 * step) for e in np.eye(6)])
        x = x - np.clip(np.linalg.solve(slopes, left), -0.05, 0.05)
    left = off(x)
    if not np.abs(left).max() < 1e-5:
        raise RuntimeError(f"{fdm.get_model_name()} finds no glide at {speed} m/s")
    return np.asarray(x[3:])


def _pilot(flown: Flown, rng: np.random.Generator, steps: int) -> Array:
    """(3, steps) added elevator, aileron, rudder."""
    u, t = np.zeros((3, steps)), np.arange(steps) / RATE

    def multistep(row: int, start: float, widths: list[float], amplitude: float) -> None:
        at, sign = start + rng.uniform(-0.3, 0.3), rng.choice((-1.0, 1.0))
        for width in widths:
            u[row, (t >= at) & (t < at + width)] += sign * amplitude * flown.size
            at, sign = at + width, -sign

    w = rng.uniform(0.9, 1.1)
    multistep(1, 1.5, [0.8 * w, 0.8 * w], rng.uniform(5, 7) * DEG)
    multistep(2, 5.5, [0.9 * w, 0.9 * w], rng.uniform(4, 6) * DEG)
    multistep(0, 9.5, [0.5, 0.5], 1.5 * DEG)
    multistep(1, 12.0, [1.2 * w, 0.8 * w, 0.4 * w, 0.4 * w], rng.uniform(4, 6) * DEG)
    multistep(2, 16.5, [1.2 * w, 0.8 * w, 0.4 * w, 0.4 * w], rng.uniform(4, 5) * DEG)
    multistep(0, 20.5, [0.4, 0.4, 0.3], 1.5 * DEG)
    multistep(1, 22.0, [0.5 * w] * 4, rng.uniform(3, 4) * DEG)
    multistep(2, 25.5, [0.6 * w] * 2, rng.uniform(3, 4) * DEG)
    return u


def columns_of(flown: Flown) -> dict[str, Array]:
    """One flight without the noise of its sensors, 20 Hz."""
    rng = np.random.default_rng([flown.seed, 20261123])
    fdm, steps = _executive(flown.file, flown.integrator), round(flown.duration * RATE) + 1
    if flown.trimmed is None:
        trim = _glide(fdm, flown.speed)
    else:
        other = _executive(flown.trimmed)
        trim = _glide(other, flown.speed)
        fdm["simulation/models/FGFCS/enabled"] = 1
        for _ in range(3):  # an angle that is set moves those set before
            for name in ("vt-fps", "theta-rad", "phi-rad", "alpha-rad", "beta-rad"):
                fdm[f"ic/{name}"] = other[f"ic/{name}"]
            _surfaces(fdm, *trim)
            fdm.run_ic()
    added = _pilot(flown, rng, steps)
    actual = acting = trim.copy()
    lag = np.array([flown.lag.get(n, 0.0) for n in ("delta_e", "delta_a", "delta_r")])
    rows = []
    for k in range(steps):
        phi, theta = fdm["attitude/phi-rad"], fdm["attitude/theta-rad"]
        p, q = fdm["velocities/p-rad_sec"], fdm["velocities/q-rad_sec"]
        if k == 0:
            level = theta
        feedback = np.array([0.15 * (theta - level) + 0.1 * q, 0.08 * phi + 0.02 * p, 0.0])
        if k % (RATE // SAMPLE) == 0:
            rows.append(_seen(fdm, k, actual))
        actual = actual + (trim + added[:, k] + feedback - actual) / (SERVO * RATE)
        acting = np.where(lag > 0.0, acting + (actual - acting) / np.maximum(lag * RATE, 1.0), actual)
        _surfaces(fdm, *acting)
        fdm.run()
    table = np.array(rows)
    return {n: table[:, i] for i, n in enumerate(SEEN)}


SEEN = ("time", "V", "alpha", "beta", "p", "q", "r", "phi", "theta", "psi", "ax", "ay", "az", "delta_e", "delta_a", "delta_r",
        "rho", "altitude", "thrust")  # fmt: skip


def _seen(fdm: Any, k: int, surfaces: Array) -> list[float]:
    mass = fdm["inertia/mass-slugs"] * SLUG
    force = [fdm[f"forces/fb{n}-total-lbs"] * 4.4482216152605 / mass for n in "xyz"]
    return [
        k / RATE, fdm["velocities/vt-fps"] * FOOT, fdm["aero/alpha-rad"], fdm["aero/beta-rad"],
        *(fdm[f"velocities/{n}-rad_sec"] for n in "pqr"), *(fdm[f"attitude/{n}-rad"] for n in ("phi", "theta", "psi")),
        *force, *surfaces, fdm["atmosphere/rho-slugs_ft3"] * SLUG / FOOT**3, fdm["position/h-sl-ft"] * FOOT, 0.0,
    ]  # fmt: skip


def flight(flown: Flown, name: str) -> Flight:
    """One flight with noise, as Sideslip reads it."""
    columns = columns_of(flown)
    rng = np.random.default_rng([flown.seed, 7])
    time = columns.pop("time")
    noisy = {n: v + flown.noise * NOISE.get(n, 0.0) * rng.standard_normal(v.size) for n, v in columns.items()}
    return Flight.build(name, time, noisy)
