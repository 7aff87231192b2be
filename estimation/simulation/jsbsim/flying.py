"""A JSBSim aircraft flown by JSBSim: a glide with steps of its surfaces, recorded by instruments at the centre of gravity.

It integrates by the second-order Adams-Bashforth rule, because JSBSim's default Euler steps err by tenths of a degree per second.
No engine runs. The earth neither rotates nor curves, as in our equations of motion; in 20 s its rotation alone makes 0.02 m/s.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from daq.utilities.constants import FOOT, POUND, SLUG
from estimation.simulation.jsbsim.aircraft import GROUND, SWITCHED_OFF
from estimation.simulation.jsbsim.forces import OURS
from estimation.simulation.jsbsim.library import Surfaces, loaded, surfaces_of
from estimation.simulation.oracle import SURFACES, Array, SimulationError
from groundstation.flight import Flight

HEIGHT = 6000.0  # ft
SETTLE, DURATION = 2.0, 20.0  # s of steady glide before, and of recorded flight
SERVO = 0.03  # s: time constant of the servos, which round the steps
STEPS_OF = {"delta_a": (1.0, 4.0), "delta_r": (6.5, 3.0), "delta_e": (12.0, 1.0)}  # surface -> begin [s], size [deg]
STEP = 0.8  # s: width of a doublet's halves
SECOND_DOUBLET = 2.5  # s after the first, half as wide
CENTRING = 3  # frames of each step that centres a play
FEEDBACK = {"delta_e": (0.15, 0.1), "delta_a": (0.08, 0.02)}  # on pitch and bank [rad per rad], their rates [s]
INJECTED = f"{OURS}/injected/"
ADAMS_BASHFORTH = 3.0  # JSBSim's number of the second-order rule, by which `estimation.simulation.proof` integrates too
LARGEST_SIDESLIP = 0.5  # rad, above which the motion has run away
LIFTS = (0.4, 0.3, 0.5, 0.6, 0.8, 0.2)  # lift coefficients at which a glide is tried
TRIMMED = 1e-4  # g and rad/s2: largest acceleration of a trimmed glide
TRIM_START = (0.03, -0.05, 0.0, 0.0, 0.0, 0.0)  # alpha, theta, phi, surfaces [rad]
TRIM_ROUNDS, TRIM_STEP = 30, 1e-3  # of Newton's method; rad, of its slopes
TRIM_MOVE, TRIM_LIMIT = 0.05, 0.5  # rad: largest change in a round, largest result
GRAVITY_FT = 32.174  # ft/s2


def fly_aircraft(source: Path, root: ET.Element, components: bool, rate: float, plays: Mapping[str, float]) -> Flight:
    """A flight of the aircraft with the XML `root`, made from the file `source`, with every step recorded.

    components: whether it has components of ours; then the flight control runs, and the aerodynamics reads surfaces that only we
    write. plays: surface -> width [rad]; they begin centred, as in our models. Raises SimulationError where no glide is found or
    the motion runs away.
    """
    surfaces = surfaces_of(source)
    steady = glide(source, surfaces, rate)
    names = {n: f"{INJECTED}{n}" if components else n for n in surfaces.writes}
    text = ET.fromstring(ET.tostring(root))
    if components:
        _inject(text, names)
    fdm = loaded(source, rate, text, list(names.values()) if components else (), still=True)
    _prepare(fdm)
    fdm["simulation/models/FGFCS/enabled"] = float(components)
    _begin(fdm, steady)
    rows, actual = [], np.array([steady[n] for n in SURFACES])
    trim = actual.copy()
    for k in range(round((SETTLE + DURATION) * rate)):
        time = k / rate - SETTLE
        if time >= 0.0:
            rows.append(_instrument_row(fdm, time, actual))
        command = trim + _pilot(fdm, time, steady)
        actual = actual + (command - actual) * min(1.0, 1.0 / (SERVO * rate))
        _write(fdm, surfaces, names, actual + (_centring(k, plays) if k < 2 * CENTRING else 0.0))
        fdm.run()
    table = np.array(rows)
    if not np.isfinite(table).all() or np.abs(table[:, COLUMNS.index("beta")]).max() > LARGEST_SIDESLIP:
        raise SimulationError(
            f"{source.stem}: its motion runs away in a glide with small steps; nothing can be compared"
        )
    return Flight.build(source.stem, table[:, 0], {n: table[:, i] for i, n in enumerate(COLUMNS) if i})


COLUMNS = (
    "time", "V", "alpha", "beta", "p", "q", "r", "phi", "theta", "ax", "ay", "az", *SURFACES, "rho", "thrust", "alpha_dot",
    "V_dot",
)  # fmt: skip
"""Columns of the recorded flight, in the order of `_instrument_row`."""


def glide(source: Path, surfaces: Surfaces, rate: float) -> dict[str, float]:
    """Speed [m/s], attitude and surfaces [rad] of a steady glide of the unchanged aircraft, wings nearly level.

    Raises SimulationError where there is none at usual lift coefficients.
    """
    fdm = loaded(source, rate, still=True)
    _prepare(fdm)
    fdm["simulation/models/FGFCS/enabled"] = 0.0
    fdm["ic/vt-fps"] = 100.0
    fdm.run_ic()
    loading = fdm["inertia/weight-lbs"] / fdm["metrics/Sw-sqft"]
    for lift in LIFTS:
        speed = math.sqrt(2.0 * loading / (fdm["atmosphere/rho-slugs_ft3"] * lift)) * FOOT
        trim = _trimmed(fdm, surfaces, speed)
        if trim is not None:
            return {"V": speed, **dict(zip(("alpha", "theta", "phi", *SURFACES), trim.tolist(), strict=True))}
    raise SimulationError(f"{source.stem}: finds no steady glide without engine; nothing can be flown to compare")


def _trimmed(fdm: Any, surfaces: Surfaces, speed: float) -> Array | None:
    """(6,) alpha, theta, phi, elevator, aileron, rudder without acceleration, by Newton's method; None where it fails."""

    def residuals(x: Array) -> Array:
        """(6,) accelerations [g, rad/s2]."""
        _begin(fdm, {"V": speed, "alpha": x[0], "theta": x[1], "phi": x[2]}, surfaces, x[3:])
        rates = [fdm[f"accelerations/{n}dot-ft_sec2"] / GRAVITY_FT for n in "uvw"]
        return np.array([*rates, *(fdm[f"accelerations/{n}dot-rad_sec2"] for n in "pqr")])

    x = np.array(TRIM_START)
    for _ in range(TRIM_ROUNDS):
        residual = residuals(x)
        if not np.isfinite(residual).all():
            return None
        if np.abs(residual).max() < TRIMMED:
            return x if np.abs(x).max() < TRIM_LIMIT else None
        steps = TRIM_STEP * np.eye(len(x))
        slopes = np.column_stack([(residuals(x + e) - residuals(x - e)) / (2.0 * TRIM_STEP) for e in steps])
        x = x - np.clip(np.linalg.lstsq(slopes, residual, rcond=None)[0], -TRIM_MOVE, TRIM_MOVE)
    return None


def _prepare(fdm: Any) -> None:
    """Set the integration rule, switch the engines off, and set place, heading and height."""
    for kind in ("rate", "position"):
        for motion in ("rotational", "translational"):
            fdm[f"simulation/integrator/{kind}/{motion}"] = ADAMS_BASHFORTH
    fdm[SWITCHED_OFF[1]] = 0.0
    fdm["ic/lat-geod-deg"], fdm["ic/psi-true-rad"], fdm["ic/h-sl-ft"] = 0.0, 1.5, HEIGHT
    fdm["ic/terrain-elevation-ft"] = GROUND


def _begin(
    fdm: Any, state: Mapping[str, float], surfaces: Surfaces | None = None, positions: Array | None = None
) -> None:
    """Set the initial conditions `at`, and surface positions where given."""
    for _ in range(3):  # setting an angle moves those set before, and forces depend on the last step
        fdm["ic/vt-fps"] = state["V"] / FOOT
        fdm["ic/theta-rad"], fdm["ic/phi-rad"] = state["theta"], state["phi"]
        fdm["ic/alpha-rad"], fdm["ic/beta-rad"] = state["alpha"], 0.0
        if surfaces is not None and positions is not None:
            _write(fdm, surfaces, {n: n for n in surfaces.writes}, positions)
        fdm.run_ic()


def _write(fdm: Any, surfaces: Surfaces, names: Mapping[str, str], positions: Array) -> None:
    surface_values = dict(zip(SURFACES, positions.tolist(), strict=True))
    for name, (column, follows) in surfaces.writes.items():
        fdm[names[name]] = follows(surface_values[column])


def _inject(root: ET.Element, names: Mapping[str, str]) -> None:
    """Make the aerodynamics and our components read the properties `names`, which the flight control does not write."""
    channel = [e for e in root.iter("channel") if e.get("name") == OURS]
    sections = [*(e for e in root if e.tag == "aerodynamics"), *channel]
    for element in (e for section in sections for e in section.iter()):
        text = (element.text or "").strip()
        if text.lstrip("-") in names:
            element.text = f"{'-' if text.startswith('-') else ''}{names[text.lstrip('-')]}"


def _pilot(fdm: Any, time: float, steady: Mapping[str, float]) -> Array:
    """(3,) elevator, aileron, rudder from trim [rad]: a doublet and a faster one each, with weak feedback."""
    deflections = dict.fromkeys(SURFACES, 0.0)
    for name, (begin, size) in STEPS_OF.items():
        for start, width in ((begin, STEP), (begin + SECOND_DOUBLET, 0.5 * STEP)):
            if start <= time < start + 2 * width:
                deflections[name] += math.radians(size) * (1.0 if time < start + width else -1.0)
    for name, angle, rate in (("delta_e", "theta", "q"), ("delta_a", "phi", "p")):
        k, d = FEEDBACK[name]
        deflections[name] += k * (fdm[f"attitude/{angle}-rad"] - steady[angle]) + d * fdm[f"velocities/{rate}-rad_sec"]
    return np.array([deflections[n] for n in SURFACES])


def _centring(k: int, plays: Mapping[str, float]) -> Array:
    """(3,) from trim [rad]: two widths low, then half a width high, which leaves a play in its middle."""
    return np.array([plays.get(n, 0.0) * (-2.0 if k < CENTRING else 0.5) for n in SURFACES])


def _instrument_row(fdm: Any, time: float, surfaces: Array) -> list[float]:
    mass = fdm["inertia/mass-slugs"] * SLUG
    return [
        time, fdm["velocities/vt-fps"] * FOOT, fdm["aero/alpha-rad"], fdm["aero/beta-rad"],
        *(fdm[f"velocities/{n}-rad_sec"] for n in "pqr"), fdm["attitude/phi-rad"], fdm["attitude/theta-rad"],
        *(fdm[f"forces/fb{n}-total-lbs"] * POUND / mass for n in "xyz"), *surfaces.tolist(),
        fdm["atmosphere/rho-slugs_ft3"] * SLUG / FOOT**3, fdm["forces/fbx-prop-lbs"] * POUND,
        fdm["aero/alphadot-rad_sec"], _speed_rate(fdm) * FOOT,
    ]  # fmt: skip


def _speed_rate(fdm: Any) -> float:
    """Rate of airspeed [ft/s2] without wind."""
    velocity = np.array([fdm[f"velocities/{n}-fps"] for n in "uvw"])
    rate = np.array([fdm[f"accelerations/{n}dot-ft_sec2"] for n in "uvw"])
    return float(velocity @ rate / np.linalg.norm(velocity))
