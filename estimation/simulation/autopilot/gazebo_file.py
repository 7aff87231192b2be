"""Reads a Gazebo model: the numbers of AdvancedLiftDrag, which joint is which surface, all links as one body."""

import math
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from estimation.aircraft import Aircraft
from estimation.simulation.autopilot.equations import CONTROLS, KEYS, GazeboPlane, Hinged
from estimation.simulation.autopilot.linear import Body, combined_body, rotation_matrix
from estimation.simulation.bounded_xml import bounded_tree
from estimation.simulation.oracle import Array, SimulationError

SYSTEM = "gz::sim::systems::AdvancedLiftDrag"
UNREAD = (
    "rho",
    "alphaStall",
    "CemaStall",
    "M",
    "CD_fp_k1",
    "CD_fp_k2",
    "a0",
    "CLa_stall",
    "CDa_stall",
    "cda",
    "ref_pt",
)
"""Keys that occur in files though the plugin does not read them."""
TO_BODY_AXES = np.diag([1.0, -1.0, -1.0])  # from x forward, y left, z up to x forward, y right, z down
LARGEST = 1e9  # magnitude of a number in a file: more is a mistake
MOST_SURFACES = 64
SIZES = (1e-6, 1e6)  # least and greatest area, chord, aspect ratio or efficiency
MOST_STALL = 10.0  # rad: out of reach, and the blend's exponents stay within a double
ALIGNED = 1e-6  # largest deviation of a link's rotation matrix from identity


def read_gazebo_plane(path: Path) -> GazeboPlane:
    """The aeroplane of a model.sdf. Raises SimulationError where Gazebo would not fly it, or a number is beyond its limits."""
    root = bounded_tree(path, "model of Gazebo")
    plugin = _plugin(root, path)
    model = next((m for m in root.iter("model") if plugin in list(m)), root)
    values = {key: _number(plugin, key, path, default) for key, default in KEYS.items()}
    _check(values, path)
    link = next((e for e in model.iter("link") if e.get("name") == _child_text(plugin, "link_name")), None)
    if link is None:
        raise SimulationError(
            f"{path}: its AdvancedLiftDrag acts on link {_child_text(plugin, 'link_name')!r}, which the model has not"
        )
    axes = [_vector(plugin, key, path, default) for key, default in (("forward", (1, 0, 0)), ("upward", (0, 0, 1)))]
    if axes != [(1, 0, 0), (0, 0, 1)]:
        raise SimulationError(f"{path}: forward and upward are not x and z of the link; only such aeroplanes are read")
    place, upright = _pose(link, path)
    if not np.allclose(upright, np.eye(3), atol=ALIGNED):
        raise SimulationError(
            f"{path}: the link of its AdvancedLiftDrag is turned in the model; x forward, y left, z up is read"
        )
    total_body = combined_body([_body(e, path) for e in model.iter("link")])
    cp = TO_BODY_AXES @ (place + np.array(_vector(plugin, "cp", path, (0, 0, 0))) - total_body.centre)
    surfaces, notes = _surfaces(model, plugin, path)
    unread = [k for k in UNREAD if plugin.find(k) is not None]
    if unread:
        notes.append(f"{path.name}: the plugin does not read {', '.join(unread)}")
    if values["Cem0"] or values["Cema"]:
        notes.append(
            f"{path.name}: Cem0 and Cema are taken as gz-sim with pull 3817 does; before it they are thrown away"
        )
    aircraft = _aircraft(model.get("name") or path.parent.name, total_body, values, path)
    return GazeboPlane(values, (float(cp[0]), float(cp[1]), float(cp[2])), surfaces, aircraft, tuple(notes))


def _plugin(root: ET.Element, path: Path) -> ET.Element:
    plugins = [e for e in root.iter("plugin") if e.get("name") == SYSTEM]
    if len(plugins) != 1:
        raise SimulationError(
            f"{path}: has {len(plugins)} plugins {SYSTEM}, and one aeroplane with one is read; the simple LiftDrag is not"
        )
    return plugins[0]


def _check(values: dict[str, float], path: Path) -> None:
    """Raise SimulationError for sizes beyond their limits; set `mac` where the file leaves it out."""
    for key in ("area", "AR"):
        if not SIZES[0] <= values[key] <= SIZES[1]:
            raise SimulationError(f"{path}: {key} is {values[key]:g}; give a number above zero, {SIZES[1]:g} at most")
    if abs(values["eff"]) < SIZES[0]:
        raise SimulationError(f"{path}: eff is {values['eff']:g}, by which the plugin divides; give it")
    if not 0.0 < values["alpha_stall"] <= MOST_STALL:
        raise SimulationError(
            f"{path}: alpha_stall is {values['alpha_stall']:g} rad; give one from 0 to {MOST_STALL:g}"
        )
    if values["mac"] == 0.0:
        values["mac"] = values["area"] / math.sqrt(values["area"] * values["AR"])
    if not SIZES[0] <= values["mac"] <= SIZES[1]:
        raise SimulationError(f"{path}: mac is {values['mac']:g}; give a number above zero, {SIZES[1]:g} at most")


def _child_text(element: ET.Element, tag: str) -> str:
    return (element.findtext(tag) or "").strip()


def _number(element: ET.Element, tag: str, path: Path, default: float | None = None) -> float:
    text = element.findtext(tag)
    if text is None and default is not None:
        return default
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not abs(value) < LARGEST:
        raise SimulationError(
            f"{path}: <{tag}> is {(text or 'missing').strip()[:40]!r}, not a number that can be flown with"
        )
    return value


def _vector(element: ET.Element, tag: str, path: Path, default: tuple[float, ...]) -> tuple[float, ...]:
    words = _child_text(element, tag).split()
    if not words:
        return default
    try:
        values = tuple(float(w) for w in words)
    except ValueError:
        values = ()
    if len(values) != len(default) or not all(abs(v) < LARGEST for v in values):
        raise SimulationError(f"{path}: <{tag}> {' '.join(words)[:60]!r} is not {len(default)} numbers")
    return values


def _pose(element: ET.Element | None, path: Path) -> tuple[Array, Array]:
    """(3,) position and (3, 3) rotation matrix of an element's pose."""
    if element is None:
        return np.zeros(3), np.eye(3)
    x, y, z, *angles = _vector(element, "pose", path, (0.0,) * 6)
    return np.array([x, y, z]), rotation_matrix(angles[0], angles[1], angles[2])


def _body(link: ET.Element, path: Path) -> Body:
    """A link's mass, centre and inertia in the model's axes."""
    inertial = link.find("inertial")
    if inertial is None:
        raise SimulationError(
            f"{path}: link {link.get('name')!r} has no <inertial>; Gazebo would take 1 kg, so state it"
        )
    place, upright = _pose(link, path)
    position, rotation = _pose(inertial, path)
    mass = _number(inertial, "mass", path)
    tensor = inertial.find("inertia")
    if tensor is None or not mass > 0.0:
        raise SimulationError(f"{path}: link {link.get('name')!r} has no mass above zero, or no <inertia>")
    i = {n: _number(tensor, n, path, 0.0) for n in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")}
    matrix = np.array([[i["ixx"], i["ixy"], i["ixz"]], [i["ixy"], i["iyy"], i["iyz"]], [i["ixz"], i["iyz"], i["izz"]]])
    axes = upright @ rotation
    return Body(mass, place + upright @ position, axes @ matrix @ axes.T)


def _surfaces(model: ET.Element, plugin: ET.Element, path: Path) -> tuple[tuple, list[str]]:  # type: ignore[type-arg]
    listed = plugin.findall("control_surface")
    count = _number(plugin, "num_ctrl_surfaces", path, 0.0)
    if count > len(listed) or len(listed) > MOST_SURFACES:
        raise SimulationError(
            f"{path}: num_ctrl_surfaces is {count:g} and {len(listed)} <control_surface> are given; Gazebo crashes there"
        )
    read = []
    for element in listed[: int(count)]:
        direction = _number(element, "direction", path)
        values = {key: direction * _number(element, key, path) for key in CONTROLS}
        read.append((_child_text(element, "name"), values, _hinge(model, _child_text(element, "name"), path)))
    return hinged(read, path)


def _hinge(model: ET.Element, name: str, path: Path) -> tuple[Array, float]:
    """(3,) axis of a joint in the model's axes, positive by the right-hand rule, and its position to the left [m]."""
    joint = next((j for j in model.iter("joint") if j.get("name") == name), None)
    if joint is None:
        raise SimulationError(f"{path}: control surface {name!r} is no joint of the model")
    axis = joint.find("axis")
    axis_direction = np.array(_vector(axis, "xyz", path, (0, 0, 1)) if axis is not None else (0, 0, 1), float)
    child = next((e for e in model.iter("link") if e.get("name") == _child_text(joint, "child")), None)
    link_place, link_axes = _pose(child, path)
    position, rotation = _pose(joint, path)
    size = float(np.linalg.norm(axis_direction))
    if not size > 0.0:
        raise SimulationError(f"{path}: the axis of joint {name!r} has no direction")
    place = link_place + link_axes @ position
    return link_axes @ rotation @ axis_direction / size, float(place[1])


def _aircraft(name: str, body: Body, values: dict[str, float], path: Path) -> Aircraft:
    inertia = TO_BODY_AXES @ body.inertia @ TO_BODY_AXES
    aircraft = Aircraft(
        name, span=math.sqrt(values["area"] * values["AR"]), area=values["area"], chord=values["mac"], mass=body.mass,
        Ixx=float(inertia[0, 0]), Iyy=float(inertia[1, 1]), Izz=float(inertia[2, 2]), Ixz=float(-inertia[0, 2]),
        title=f"Gazebo model {name}",
    )  # fmt: skip
    if aircraft.impossible:
        raise SimulationError(
            f"{path}: no aircraft has {aircraft.impossible}, which its links and lift-drag plugins together make"
        )
    return aircraft


MOSTLY = 0.5  # component of a unit hinge axis from which a surface counts as horizontal, or as vertical
CENTRE = 1e-3  # m from the plane of symmetry, within which a surface lies in it
HingeData = tuple[str, dict[str, float], tuple[Array, float]]
"""Joint, numbers per degree, and (hinge axis, position to the left [m])."""


def hinged(surface_data: Sequence[HingeData], path: Path) -> tuple[tuple[Hinged, ...], list[str]]:
    """Surfaces with the joint angles that our deflections cause, and notes on those that do not move.

    A trailing edge lies behind its hinge: turning by the axis a moves it up by a_y and to port by -a_z. Horizontal surfaces in
    the plane of symmetry are elevators. Off that plane, those that roll more than they pitch are ailerons and the others
    elevators; if there is no elevator, all of them are both.
    """
    surfaces, notes = [], []
    horizontal = [(name, values, left) for name, values, (axis, left) in surface_data if abs(axis[1]) > MOSTLY]
    elevators = [name for name, values, left in horizontal if abs(left) < CENTRE or not _rolls(values)]
    for name, values, (axis, left) in surface_data:
        vertical, port = float(axis[1]), float(-axis[2])
        if abs(vertical) > MOSTLY:
            side = -np.sign(left) if abs(left) >= CENTRE else 0.0  # +1 on the right, whose edge moves down with delta_a
            moves_both = not elevators and side != 0.0
            moves = {"delta_e": -1.0 / vertical} if name in elevators or moves_both else {}
            if side != 0.0 and (name not in elevators or moves_both):
                moves["delta_a"] = -float(side) / vertical
        elif abs(port) > MOSTLY:
            moves = {"delta_r": 1.0 / port}
        else:
            moves = {}
            notes.append(f"{path.name}: joint {name} turns about neither y nor z: held at zero")
        surfaces.append(Hinged(name, values, moves))
    if not any(s.moves for s in surfaces) and surfaces:
        raise SimulationError(f"{path}: none of its control surfaces turns about y or z, so none is known")
    joint_list = [f"{s.joint} by {', '.join(s.moves)}" for s in surfaces if s.moves]
    if joint_list:
        notes.append(f"{path.name}: surfaces move {'; '.join(joint_list)}")
    return tuple(surfaces), notes


def _rolls(values: dict[str, float]) -> bool:
    """Whether a surface rolls more than it pitches."""
    return abs(values["Cell_ctrl"]) > abs(values["Cem_ctrl"])
