"""A linear aircraft as a Gazebo model (model.sdf) for PX4's airframe gz_advanced_plane.

Links are placed in axes x forward, y left, z up with the origin at the centre of gravity. Positions of surfaces and propeller are
only for the picture: neither forces nor moments depend on them. All links together have the aircraft's mass, centre and inertia.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree import ElementTree as ET

import numpy as np

from daq.utilities.constants import DEGREE
from daq.utilities.constants import SEA_LEVEL_DENSITY as DENSITY
from estimation.simulation.autopilot.gathering import symmetric_throws
from estimation.simulation.autopilot.linear import LINES, SLOPES, Body, LinearAircraft, remaining_body, rotation_matrix
from estimation.simulation.oracle import Array

STALL = 2.0  # rad, where none is stated: so far that the blend, of fixed width, changes nothing in flight
NO_POLAR = 1e12  # eff without induced drag
SURFACE = Body(1e-8, np.zeros(3), 1e-6 * np.eye(3))  # a surface: negligible mass and inertia, like PX4's own
PROPELLER_SHARE, PROPELLER_MOST = 1e-3, 0.005  # of the aircraft's mass; kg
JOINT_LIMIT = 1e16  # rad: the propeller turns without limit
FASTEST = 1600.0  # rad/s at full throttle, PX4's SIM_GZ_EC_MAX1 of this airframe
FORWARD = (0.0, 0.5 * math.pi, 0.0)  # roll, pitch, yaw of a link whose z points ahead
SERVO_GAIN, SERVO_DAMPING = 10.0, 1.0  # together a lag of 0.1 s
NAMES = {"CL": "CL", "CD": "CD", "CY": "CY", "Cl": "Cell", "Cm": "Cem", "Cn": "Cen"}
INDUCED = ("0", "alpha", "beta", "de", "da", "dr")
"""Endings of the terms of lift in its induced drag: all but rates."""
HAS_KEY = {
    "CL": ("0", *SLOPES), "CD": ("0", "p", "q", "r", "de", "da", "dr"), "CY": tuple(SLOPES), "Cl": tuple(SLOPES),
    "Cm": ("0", *SLOPES), "Cn": tuple(SLOPES),
}  # fmt: skip
"""Endings of the derivatives for which the plugin has keys; it has none for alphadot."""
ALPHADOT = "alphadot"
NEEDS = "gz-sim with pull 3817 (July 2026): without it Cem0 and Cema are thrown away, and nothing holds it in pitch"


@dataclass(frozen=True)
class Flap:
    """A surface: joint, name of its link, position (x, y, z over span), hinge axis (positive by the right-hand rule), and the
    deflection that moves it."""

    joint: str
    link: str
    place: tuple[float, float, float]
    axis: tuple[int, int, int]
    delta: str
    turns: float
    """Joint angle over the deflection of `delta`."""


FLAPS = (
    Flap("servo_0", "left_aileron", (-0.1, 0.35, 0.0), (0, 1, 0), "delta_a", 1.0),
    Flap("servo_1", "right_aileron", (-0.1, -0.35, 0.0), (0, 1, 0), "delta_a", -1.0),
    Flap("servo_2", "elevator", (-0.45, 0.0, 0.0), (0, 1, 0), "delta_e", -1.0),
    Flap("servo_3", "rudder", (-0.45, 0.0, 0.06), (0, 0, 1), "delta_r", -1.0),
)
"""As in advanced_plane: a positive joint angle moves the trailing edge up, or to starboard. delta_a is half of right minus
left."""


def left_out(linear: LinearAircraft) -> tuple[str, ...]:
    """Names of the non-zero derivatives without a key."""
    return tuple(
        f"{c}_{e}" for c in LINES for e in ("0", *SLOPES)
        if (e not in HAS_KEY[c] or e == ALPHADOT) and linear[f"{c}_{e}"] != 0.0
    )  # fmt: skip


def plugin_values(linear: LinearAircraft, stall: float | None) -> dict[str, float]:
    """Key -> number of the plugin, without those of its surfaces. stall: angle of attack [rad] or None."""
    a = linear.aircraft
    aspect = a.span**2 / a.area
    values = {"CL0": linear["CL_0"], "CD0": linear["CD_0"], "Cem0": linear["Cm_0"]}
    for line, name in NAMES.items():
        letters = (
            {"p": "p", "q": "q", "r": "r"}
            if line == "CD"
            else {"a": "alpha", "b": "beta", "p": "p", "q": "q", "r": "r"}
        )
        values |= {f"{name}{letter}": linear[f"{line}_{ending}"] for letter, ending in letters.items()}
    eff = 1.0 / (math.pi * aspect * linear["CD_k"]) if linear["CD_k"] else NO_POLAR
    return {
        **values, "alpha_stall": STALL if stall is None else stall, "Cema_stall": linear["Cm_alpha"], "area": a.area,
        "AR": aspect, "mac": a.chord, "eff": eff, "air_density": DENSITY,
    }  # fmt: skip


def control_values(linear: LinearAircraft, flap: Flap) -> dict[str, float]:
    """Key -> number of a surface per degree of its joint. Each aileron has half the effect of delta_a."""
    ending = flap.delta.replace("delta_", "d")
    share = 0.5 if flap.delta == "delta_a" else 1.0
    return {f"{name}_ctrl": linear[f"{line}_{ending}"] * share * DEGREE / flap.turns for line, name in NAMES.items()}


def inertia_of(linear: LinearAircraft) -> Body:
    """The whole aircraft about its centre of gravity in axes x forward, y left, z up, where Ixz is the matrix element itself."""
    a = linear.aircraft
    return Body(a.mass, np.zeros(3), np.array([[a.Ixx, 0.0, a.Ixz], [0.0, a.Iyy, 0.0], [a.Ixz, 0.0, a.Izz]]))


def possible(inertia: Array) -> bool:
    """Whether a body can have this inertia: gz-sim refuses a link with one principal moment above the sum of the others."""
    principal = np.linalg.eigvalsh(inertia)
    return bool(principal[0] > 0.0 and principal[2] <= principal[0] + principal[1])


def model_sdf(name: str, linear: LinearAircraft, stall: float | None) -> ET.Element:
    """The XML of model.sdf. Raises SimulationError for throws that differ in the two directions."""
    throws = symmetric_throws(linear, "PX4's simulated servos")
    thrust = linear.thrust or 0.0
    root = ET.Element("sdf", version="1.9")
    model = ET.SubElement(root, "model", name=name)
    a = linear.aircraft
    _text_element(model, "pose", f"0 0 {_number_text(0.1 * a.span)} 0 0 0")
    parts = [Body(SURFACE.mass, a.span * np.array(f.place), SURFACE.inertia) for f in FLAPS]
    propeller = _propeller(linear)
    base = remaining_body(inertia_of(linear), [*parts, *([propeller] if thrust else [])])
    model.append(_base_link(base, a.span, a.chord))
    for flap, body in zip(FLAPS, parts, strict=True):
        size = (
            (0.1 * a.chord, 0.2 * a.span, 0.01 * a.span)
            if flap.axis[1]
            else (0.1 * a.chord, 0.01 * a.span, 0.1 * a.span)
        )
        model.append(_link(flap.link, Body(body.mass, np.zeros(3), body.inertia), size, body.centre))
        throw = throws[flap.delta]
        model.append(_joint(flap.joint, flap.link, flap.axis, -throw, throw, SERVO_DAMPING))
        model.append(_servo(flap.joint))
    if thrust:
        model.append(_rotor(propeller, a.span))
        model.append(_joint("rotor_puller_joint", "rotor_puller", (0, 0, 1), -JOINT_LIMIT, JOINT_LIMIT, 0.0))
        model.append(_motor(thrust))
    model.append(_aerodynamics(linear, stall))
    ET.indent(root)
    return root


def _number_text(value: float) -> str:
    return repr(float(value))


def _text_element(parent: ET.Element, tag: str, text: str, **attributes: str) -> ET.Element:
    element = ET.SubElement(parent, tag, attributes)
    element.text = text
    return element


def _inertial(parent: ET.Element, body: Body) -> None:
    inertial = ET.SubElement(parent, "inertial")
    _text_element(inertial, "pose", " ".join(_number_text(v) for v in body.centre) + " 0 0 0")
    _text_element(inertial, "mass", _number_text(body.mass))
    inertia = ET.SubElement(inertial, "inertia")
    for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        _text_element(inertia, f"i{'xyz'[i]}{'xyz'[j]}", _number_text(body.inertia[i, j]))


def _box(parent: ET.Element, tag: str, name: str, size: tuple[float, float, float]) -> None:
    geometry = ET.SubElement(ET.SubElement(parent, tag, name=name), "geometry")
    _text_element(ET.SubElement(geometry, "box"), "size", " ".join(_number_text(v) for v in size))


def _link(
    name: str,
    body: Body,
    size: tuple[float, float, float],
    place: Array | None = None,
    angles: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> ET.Element:
    link = ET.Element("link", name=name)
    if place is not None:
        _text_element(link, "pose", " ".join(_number_text(v) for v in (*place, *angles)))
    _inertial(link, body)
    _box(link, "visual", f"{name}_visual", size)
    return link


def _base_link(body: Body, span: float, chord: float) -> ET.Element:
    link = _link("base_link", body, (chord, span, 0.02 * span))
    _box(link, "collision", "base_link_collision", (chord, 0.3 * span, 0.05 * span))
    for name, kind, rate in (
        ("imu_sensor", "imu", 250),
        ("air_pressure_sensor", "air_pressure", 50),
        ("navsat_sensor", "navsat", 30),
    ):
        sensor = ET.SubElement(link, "sensor", name=name, type=kind)
        _text_element(sensor, "always_on", "1")
        _text_element(sensor, "update_rate", str(rate))
    return link


def _joint(name: str, child: str, axis: tuple[int, int, int], low: float, high: float, damping: float) -> ET.Element:
    joint = ET.Element("joint", name=name, type="revolute")
    _text_element(joint, "parent", "base_link")
    _text_element(joint, "child", child)
    turning = ET.SubElement(joint, "axis")
    _text_element(turning, "xyz", " ".join(map(str, axis)))
    limit = ET.SubElement(turning, "limit")
    _text_element(limit, "lower", _number_text(low))
    _text_element(limit, "upper", _number_text(high))
    _text_element(ET.SubElement(turning, "dynamics"), "damping", _number_text(damping))
    return joint


def _plugin(system: str, words: Mapping[str, str]) -> ET.Element:
    file = "".join(f"-{c.lower()}" if c.isupper() else c for c in system)
    plugin = ET.Element("plugin", filename=f"gz-sim{file}-system", name=f"gz::sim::systems::{system}")
    for tag, text in words.items():
        _text_element(plugin, tag, text)
    return plugin


def _servo(joint: str) -> ET.Element:
    gains = {"p_gain": _number_text(SERVO_GAIN), "i_gain": "0", "d_gain": "0"}
    return _plugin("JointPositionController", {"joint_name": joint, "sub_topic": joint, **gains})


def _propeller(linear: LinearAircraft) -> Body:
    """A disc ahead, so light that its gyroscopic moment is negligible."""
    mass, radius = min(PROPELLER_SHARE * linear.aircraft.mass, PROPELLER_MOST), 0.05 * linear.aircraft.span
    across = 0.25 * mass * radius**2
    return Body(mass, np.array([0.2 * linear.aircraft.span, 0.0, 0.0]), np.diag([2.0 * across, across, across]))


def _rotor(propeller: Body, span: float) -> ET.Element:
    """The link of the propeller, with z along its shaft, the thrust axis of the motor plugin."""
    upright = rotation_matrix(*FORWARD)
    turned_body = Body(propeller.mass, np.zeros(3), upright.T @ propeller.inertia @ upright)
    return _link("rotor_puller", turned_body, (0.15 * span, 0.02 * span, 0.01 * span), propeller.centre, FORWARD)


def _motor(thrust: float) -> ET.Element:
    """Thrust along x at the height of the centre of gravity, as in our models: without torque or drag."""
    return _plugin("MulticopterMotorModel", {
        "jointName": "rotor_puller_joint", "linkName": "rotor_puller", "turningDirection": "cw", "timeConstantUp": "0.0125",
        "timeConstantDown": "0.025", "maxRotVelocity": _number_text(FASTEST), "motorConstant": _number_text(thrust / FASTEST**2),
        "momentConstant": "0", "commandSubTopic": "command/motor_speed", "motorNumber": "0", "rotorDragCoefficient": "0",
        "rollingMomentCoefficient": "0", "rotorVelocitySlowdownSim": "10", "motorType": "velocity",
    })  # fmt: skip


def _aerodynamics(linear: LinearAircraft, stall: float | None) -> ET.Element:
    numbers = {key: _number_text(value) for key, value in plugin_values(linear, stall).items()}
    plugin = _plugin("AdvancedLiftDrag", {"link_name": "base_link", **numbers, "cp": "0 0 0", "forward": "1 0 0",
                                          "upward": "0 0 1", "num_ctrl_surfaces": str(len(FLAPS))})  # fmt: skip
    for flap in FLAPS:
        surface = ET.SubElement(plugin, "control_surface")
        _text_element(surface, "name", flap.joint)
        _text_element(surface, "direction", "1")
        for key, value in control_values(linear, flap).items():
            _text_element(surface, key, _number_text(value))
    return plugin
