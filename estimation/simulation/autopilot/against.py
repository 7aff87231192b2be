"""The proof of an export: the written file, read back and flown by our statement of the simulator's equations, against the model.

Both are compared at random states. Terms that the simulator cannot express are removed from the model first, and are reported
with their size.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from estimation.aircraft import Aircraft
from estimation.models.expressions import evaluate, names_in
from estimation.models.numeric import FUNCTIONS
from estimation.simulation.autopilot import ardupilot, gazebo
from estimation.simulation.autopilot.equations import (
    GazeboPlane,
    SitlPlane,
    air_of_gazebo,
    air_of_sitl,
    gazebo_forces,
    sitl_accelerations,
)
from estimation.simulation.autopilot.linear import (
    ALPHAS,
    AXES,
    FlightStates,
    LinearAircraft,
    accelerations,
    forces,
    gyroscopic,
    random_motion,
)
from estimation.simulation.autopilot.neutral import BuildUp, evaluated
from estimation.simulation.oracle import ALPHA_RATE, COEFFICIENTS, Array

SITL_LIMIT, GAZEBO_LIMIT, TEXT_LIMIT = 1e-6, 1e-9, 1e-12
"""Largest deviation over the largest value on an axis: rounding of a float, of a double, and of the same expression."""
LEAST_SHARE = 1e-12  # of an axis, below which an omitted term is not reported
Axes = Mapping[str, Array]


@dataclass(frozen=True)
class OmittedTerm:
    """A term that the simulator lacks. value: of the derivative, NaN where it is none; share: largest effect over the largest
    value on `axis`, NaN where it is not known."""

    name: str
    value: float
    share: float
    axis: str

    def sentence(self) -> str:
        """The term with its value and share."""
        value = "" if np.isnan(self.value) else f" = {self.value:.4g}"
        weighs = "" if np.isnan(self.share) else f", up to {100.0 * self.share:.3g} % of the largest {self.axis}"
        return f"{self.name}{value}{weighs}"


@dataclass(frozen=True)
class SimulatorProof:
    """states: number of random states. deviation: axis -> largest difference over the largest value, without the terms in
    `left_out`; limit: the largest that is allowed."""

    states: int
    deviation: Mapping[str, float]
    left_out: tuple[OmittedTerm, ...]
    limit: float

    @property
    def failed(self) -> tuple[str, ...]:
        """Axes beyond the limit."""
        return tuple(n for n, v in self.deviation.items() if not v <= self.limit)

    def sentence(self) -> str:
        """The result of the proof."""
        worst_axis = max(self.deviation, key=lambda n: np.inf if np.isnan(self.deviation[n]) else self.deviation[n])
        if not self.failed:
            return (
                f"proof: at {self.states} random states every axis is the model's without what is left out, {worst_axis} to"
                f" {self.deviation[worst_axis]:.1g} of its largest value (limit {self.limit:g})"
            )
        return (
            f"proof failed: at {self.states} random states {', '.join(self.failed)} differ from the model, {worst_axis} by"
            f" {self.deviation[worst_axis]:.3g} of its largest value, and {self.limit:g} is allowed; do not fly this file"
        )

    def to_json(self) -> dict[str, Any]:
        return {
            "states": self.states,
            "deviation": dict(self.deviation),
            "limit": self.limit,
            "left_out": [[t.name, t.share if np.isnan(t.value) else t.value] for t in self.left_out],
            "left_out_share": {t.name: {"axis": t.axis, "of_largest": t.share} for t in self.left_out},
            "passed": not self.failed,
        }


def against_sitl(
    plane: SitlPlane, linear: LinearAircraft, beyond: tuple[tuple[str, float], ...] = ()
) -> SimulatorProof:
    """SITL's accelerations with a file against the model's, both at sea level. beyond: terms of the model outside its
    coefficients, as (name, size)."""
    stall = plane.values["alpha_stall"]
    alpha_range = (ALPHAS[0], min(ALPHAS[1], max(stall - ardupilot.CLEAR, 0.0)))
    motion = random_motion(linear, alpha_range)
    omitted = ardupilot.left_out(linear)
    omitted_terms = _omitted_terms(linear, motion, omitted, ardupilot.INDUCED, air_of_sitl)
    omitted_terms += _gyroscopic(linear, motion)

    def model(m: FlightStates) -> Axes:
        return accelerations(
            linear.aircraft, forces(linear.without(omitted), m.with_air(*air_of_sitl(m)), ardupilot.INDUCED)
        )

    omitted_terms += _blend(
        lambda m: sitl_accelerations(plane, m), model, random_motion(linear), alpha_range[1] < ALPHAS[1]
    )
    deviation = _axis_deviations(sitl_accelerations(plane, motion), model(motion))
    return SimulatorProof(len(motion), deviation, (*omitted_terms, *_beyond_terms(beyond)), SITL_LIMIT)


def against_gazebo(
    plane: GazeboPlane, linear: LinearAircraft, beyond: tuple[tuple[str, float], ...] = ()
) -> SimulatorProof:
    """Gazebo's forces and moments with a file against the model's, and the mass and inertia of all links together."""
    density = plane.values["air_density"]
    motion = random_motion(linear, rho=density)
    omitted = gazebo.left_out(linear)
    unstalled_plane = replace(plane, values={**plane.values, "alpha_stall": gazebo.STALL})
    omitted_terms = _omitted_terms(linear, motion, omitted, gazebo.INDUCED, air_of_gazebo)

    def model(m: FlightStates) -> Axes:
        return forces(linear.without(omitted), m.with_air(*air_of_gazebo(m)), gazebo.INDUCED)

    omitted_terms += _blend(
        lambda m: gazebo_forces(plane, m), model, motion, plane.values["alpha_stall"] < gazebo.STALL
    )
    deviation = {
        **_axis_deviations(gazebo_forces(unstalled_plane, motion), model(motion)),
        **_body_deviations(plane, linear),
    }
    return SimulatorProof(len(motion), deviation, (*omitted_terms, *_beyond_terms(beyond)), GAZEBO_LIMIT)


def against_text(content: Mapping[str, Any], model: BuildUp, body: Aircraft) -> SimulatorProof:
    """The expression trees of a neutral file against the text of the model, coefficient by coefficient; nothing is left out."""
    motion = random_motion(LinearAircraft(model.name, model.title, body, {}))
    rng = np.random.default_rng(len(motion))
    extra_states = {"thrust": rng.uniform(0.0, 10.0, len(motion)), ALPHA_RATE: rng.uniform(-0.5, 0.5, len(motion))}
    states = {**motion.values, **extra_states}
    read = evaluated(content, states)
    symbols: dict[str, Any] = {**model.numbers, **states}

    def text(name: str) -> Any:
        if name not in symbols:
            symbols[name] = evaluate(
                model.definitions[name], {n: text(n) for n in names_in(model.definitions[name])}, FUNCTIONS
            )
        return symbols[name]

    deviation = {
        axis: _share(read[c] - text(c), np.atleast_1d(text(c))) for axis, c in zip(AXES, COEFFICIENTS, strict=True)
    }
    return SimulatorProof(len(motion), deviation, (), TEXT_LIMIT)


def _axis_deviations(measured: Axes, model: Axes) -> dict[str, float]:
    return {axis: _share(measured[axis] - model[axis], model[axis]) for axis in AXES}


def _share(difference: Array, reference: Array) -> float:
    """Largest difference over the largest reference value; the difference itself where all references are zero."""
    largest = float(np.max(np.abs(reference)))
    return float(np.max(np.abs(difference))) / largest if largest > 0.0 else float(np.max(np.abs(difference)))


def _body_deviations(plane: GazeboPlane, linear: LinearAircraft) -> dict[str, float]:
    """Relative deviations of mass and inertia."""
    a, b = plane.aircraft, linear.aircraft
    size = max(b.Ixx, b.Iyy, b.Izz)
    inertia = max(abs(getattr(a, n) - getattr(b, n)) for n in ("Ixx", "Iyy", "Izz", "Ixz")) / size
    return {"mass": abs(a.mass / b.mass - 1.0), "inertia": inertia}


def _omitted_terms(
    linear: LinearAircraft,
    motion: FlightStates,
    omitted: tuple[str, ...],
    induced: tuple[str, ...],
    air: Callable[[FlightStates], tuple[Array, Array, Array]],
) -> list[OmittedTerm]:
    """Derivatives without a key, missing parts of induced drag, and other definitions of air data, each with its size."""
    full_axes = accelerations(linear.aircraft, forces(linear, motion))
    terms = []
    for name in omitted:
        reduced_axes = accelerations(linear.aircraft, forces(linear.without((name,)), motion))
        terms.append(_largest(name, linear[name], full_axes, reduced_axes))
    expressible = linear.without(omitted)
    for ending in ("beta", "p", "q", "r", "de", "da", "dr"):
        if ending not in induced and expressible[f"CL_{ending}"] != 0.0 and expressible["CD_k"] != 0.0:
            full_drag = accelerations(linear.aircraft, forces(expressible, motion, (*induced, ending)))
            reduced_axes = accelerations(linear.aircraft, forces(expressible, motion, induced))
            terms.append(_largest(f"induced drag of CL_{ending}", np.nan, full_drag, reduced_axes))
    model_axes = accelerations(linear.aircraft, forces(expressible, motion, induced))
    theirs = accelerations(linear.aircraft, forces(expressible, motion.with_air(*air(motion)), induced))
    terms.append(_largest("sideslip taken as atan2(v, u)", np.nan, model_axes, theirs))
    return [t for t in terms if t.share > LEAST_SHARE]


def _gyroscopic(linear: LinearAircraft, motion: FlightStates) -> list[OmittedTerm]:
    without = accelerations(linear.aircraft, forces(linear, motion))
    with_terms = {**without, **{n: without[n] + v for n, v in gyroscopic(linear.aircraft, motion).items()}}
    return [_largest("gyroscopic terms", np.nan, without, with_terms)]


def _blend(
    simulator: Callable[[FlightStates], Axes], model: Callable[[FlightStates], Axes], motion: FlightStates, near: bool
) -> list[OmittedTerm]:
    """The effect of a stall that is near on the states of flight."""
    return [_largest("blend into the stall", np.nan, model(motion), simulator(motion))] if near else []


def _largest(name: str, value: float, full: Axes, reduced: Axes) -> OmittedTerm:
    """The term that makes the difference, with its share on the axis where that is largest."""
    shares = {axis: _share(full[axis] - reduced[axis], full[axis]) for axis in AXES}
    axis = max(shares, key=lambda n: shares[n])
    return OmittedTerm(name, value, shares[axis], axis)


def _beyond_terms(beyond: tuple[tuple[str, float], ...]) -> list[OmittedTerm]:
    """Terms of the model outside its coefficients, of which only the size is known."""
    return [OmittedTerm(name, size, np.nan, "") for name, size in beyond]
