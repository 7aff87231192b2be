"""Derivatives of a model's lines, taken as slopes; a line that is not linear is refused."""

from collections.abc import Callable, Mapping

import numpy as np

from estimation.models.base import Model
from estimation.simulation.autopilot.linear import (
    CONSTANT,
    POLAR,
    SLOPES,
    STATES,
    FlightStates,
    LinearAircraft,
    accelerations,
    coefficients,
    forces,
    gyroscopic,
    random_motion,
)
from estimation.simulation.oracle import Array, SimulationError, States
from estimation.simulation.own_simulations import TextOracle

STEP = 0.1  # rad, or of a non-dimensional rate: a linear line has the same slope over any step
SPEED, DENSITY = 20.0, 1.2  # m/s, kg/m3 at which slopes are taken; those of a linear line are the same everywhere
SAME = 1e-9  # of the largest value of a coefficient: a linear line differs from its slopes by rounding only
ROUNDING = 1e-12  # of the largest slope of a line: a smaller slope is rounding, and counts as zero
DRAG_ROUNDING = 1e-12  # likewise of a drag term, by least squares
THRUSTS, RATES, DENSITIES = (0.0, 10.0), (-0.5, 0.5), (0.7, 1.3)  # N, rad/s (and rad), kg/m3 in which lines are tested
LATERAL, PITCH = ("CY", "Cl", "Cn"), ("CL", "CD", "Cm")
Line = Callable[[FlightStates, Array, Array], Array]
"""Value of a line at a motion, rate of alpha [rad/s] and thrust [N]."""


def lines_of(model: Model) -> dict[str, Line]:
    """Coefficient -> line, for each of CL CD CY Cl Cm Cn that a model has; lift and drag may come from CX and CZ."""
    oracle = TextOracle(model)

    def line_of(name: str) -> Line:
        def line(motion: FlightStates, alpha_dot: Array, thrust: Array) -> Array:
            values = {n: motion.values[n] for n in ("V", "alpha", "beta", "p", "q", "r", *motion.surfaces)}
            return oracle.line(name, States({**values, "thrust": thrust}, motion.values["rho"], alpha_dot))

        return line

    lines = {name: line_of(name) for name in (*LATERAL, *PITCH) if name in model.definitions}
    if "CX" in model.definitions and "CZ" in model.definitions:
        X, Z = line_of("CX"), line_of("CZ")
        body_lines: dict[str, Line] = {
            "CL": lambda m, *rest: X(m, *rest) * np.sin(m.values["alpha"]) - Z(m, *rest) * np.cos(m.values["alpha"]),
            "CD": lambda m, *rest: -X(m, *rest) * np.cos(m.values["alpha"]) - Z(m, *rest) * np.sin(m.values["alpha"]),
        }
        lines = {**body_lines, **lines}
    return lines


def derivatives_of(model: Model, frame: LinearAircraft) -> dict[str, float]:
    """Name -> value of the derivatives of a model's lines. frame: geometry and mass. Raises SimulationError for a line that is
    not linear, or that depends on what no simulator has."""
    lines = lines_of(model)
    derivatives: dict[str, float] = {}
    for name, line in lines.items():
        if name != "CD":
            derivatives |= _slopes(name, line, frame)
    if "CD" in lines:
        derivatives |= _drag(lines["CD"], LinearAircraft(frame.name, "", frame.aircraft, derivatives))
    linear_aircraft = LinearAircraft(frame.name, frame.title, frame.aircraft, derivatives)
    _check(model, lines, linear_aircraft)
    return derivatives


def _points(frame: LinearAircraft, regressors: Mapping[str, Array], count: int) -> tuple[FlightStates, Array]:
    """Motion and rate of alpha [rad/s] with these regressors (ending of SLOPES -> (count,), rates non-dimensional)."""
    a, zeros = frame.aircraft, np.zeros(count)
    V = np.full(count, SPEED)
    lengths = {"p": a.span, "q": a.chord, "r": a.span, "alphadot": a.chord}
    values = {SLOPES[e]: regressors.get(e, zeros) for e in ("alpha", "beta", "de", "da", "dr")}
    values |= {n: regressors.get(n, zeros) * 2.0 * V / lengths[n] for n in ("p", "q", "r")}
    alphadot = regressors.get("alphadot", zeros)
    values |= {"V": V, "rho": np.full(count, DENSITY), "alphadot_hat": alphadot}
    return FlightStates(values), alphadot * 2.0 * V / lengths["alphadot"]


def _slopes(name: str, line: Line, frame: LinearAircraft) -> dict[str, float]:
    """C_0 and the slopes with each of SLOPES, by one step from zero."""
    count = 1 + len(SLOPES)
    steps = {e: STEP * (np.arange(count) == i + 1) for i, e in enumerate(SLOPES)}
    motion, rate = _points(frame, steps, count)
    base_values = line(motion, rate, np.zeros(count))
    slopes = {f"{name}_{e}": float(base_values[i + 1] - base_values[0]) / STEP for i, e in enumerate(SLOPES)}
    return _without_rounding({f"{name}_{CONSTANT}": float(base_values[0]), **slopes})


def _without_rounding(slopes: Mapping[str, float]) -> dict[str, float]:
    largest = max(map(abs, slopes.values()))
    return {n: v if abs(v) > ROUNDING * largest else 0.0 for n, v in slopes.items()}


def _drag(line: Line, linear: LinearAircraft) -> dict[str, float]:
    """CD_0, CD_k (on the square of lift) and slopes, by least squares: exact where drag has that form."""
    rng = np.random.default_rng(STATES)
    values = {e: rng.uniform(-2.0 * STEP, 2.0 * STEP, STATES) for e in SLOPES}
    motion, rate = _points(linear, values, STATES)
    lift = coefficients(linear, motion)["CL"]
    rows = np.column_stack([np.ones(STATES), lift**2, *values.values()])
    size = np.maximum(np.abs(rows).max(axis=0), 1e-300)
    solved = np.linalg.lstsq(rows / size, line(motion, rate, np.zeros(STATES)), rcond=None)[0] / size
    names = (f"CD_{CONSTANT}", POLAR, *(f"CD_{e}" for e in SLOPES))
    largest = float(np.max(np.abs(solved * size)))
    terms = zip(names, solved, size, strict=True)
    return {n: float(v) if abs(v * s) > DRAG_ROUNDING * largest else 0.0 for n, v, s in terms}


def _check(model: Model, lines: Mapping[str, Line], linear: LinearAircraft) -> None:
    """Raise SimulationError for the first line that differs from its slopes."""
    motion = random_motion(linear)
    rng = np.random.default_rng(STATES + 1)
    rate, thrust, density = (rng.uniform(*ends, STATES) for ends in (RATES, THRUSTS, DENSITIES))
    hat = rate * linear.aircraft.chord / (2.0 * motion.values["V"])
    motion = FlightStates({**motion.values, "rho": density, "alphadot_hat": hat})
    linear_values = coefficients(linear, motion)
    for name, line in lines.items():
        line_values = line(motion, rate, thrust)
        largest = max(float(np.max(np.abs(line_values))), float(np.max(np.abs(linear_values[name]))), 1e-12)
        deviation = float(np.max(np.abs(line_values - linear_values[name]))) / largest
        if not deviation <= SAME:
            form = "a polar, CD_0 + CD_k CL^2, and slopes" if name == "CD" else "a constant and slopes"
            raise SimulationError(
                f"model {model.name}: {name} is not linear (it is {deviation:.2g} of its largest value from {form}), and these"
                f" simulators take nothing else; leave out the term, or write the model as it is with --to neutral"
            )


MOTIONS: Mapping[str, str] = {"p_dot": "L", "q_dot": "M", "r_dot": "N", "ax": "X", "ay": "Y", "az": "Z"}
"""Line of a model -> axis of the force or moment that causes it."""


def beyond_coefficients(model: Model, linear: LinearAircraft) -> dict[str, float]:
    """Line -> share of its largest value that coefficients, mass and inertia do not explain, for a model's accelerations. Lines
    may have gyroscopic terms or not."""
    motion = random_motion(linear)
    rng = np.random.default_rng(STATES + 2)
    thrust, phi, theta = (rng.uniform(*ends, STATES) for ends in (THRUSTS, RATES, RATES))
    linear_axes = accelerations(linear.aircraft, forces(linear, motion))
    linear_axes["X"] = linear_axes["X"] + thrust / linear.aircraft.mass
    coupling = gyroscopic(linear.aircraft, motion)
    states = States({**motion.values, "thrust": thrust, "phi": phi, "theta": theta}, motion.values["rho"], 0.0 * thrust)
    oracle, beyond = TextOracle(model), {}
    for name, axis in MOTIONS.items():
        if name in model.definitions:
            line_values = oracle.line(name, states)
            largest = max(float(np.max(np.abs(line_values))), 1e-12)
            expectations = (linear_axes[axis], linear_axes[axis] + coupling.get(axis, 0.0))
            deviation = min(float(np.max(np.abs(line_values - expected))) for expected in expectations) / largest
            if deviation > SAME:
                beyond[name] = deviation
    return beyond
