"""What PX4 has to be told of an exported Gazebo model: the airframe file, and how to fly it."""

import math
import shlex
from pathlib import Path
from xml.etree import ElementTree as ET

from estimation.simulation.autopilot.gazebo import FASTEST, FLAPS, NEEDS
from estimation.simulation.autopilot.linear import LinearAircraft
from estimation.simulation.oracle import SimulationError

BASE = 4008  # PX4's airframe gz_advanced_plane, whose gains are begun with
OWN = 22500  # a number that PX4 leaves free
EFFECTS = {
    "left_aileron": ("TRQ_R -0.5", 1), "right_aileron": ("TRQ_R 0.5", 2), "elevator": ("TRQ_P 1", 3), "rudder": ("TRQ_Y 1", 4),
}  # fmt: skip
"""Link -> what PX4's allocation gives it, and its type."""


def check_folder_name(folder: Path) -> str:
    """The model's name, that of the folder. Raises SimulationError for one that Gazebo or PX4 cannot call."""
    name = folder.resolve().name
    if not name.replace("_", "").isalnum() or not name.isascii():
        raise SimulationError(
            f"{folder}: the folder's name is the model's, which PX4 puts behind gz_; use letters, digits and _ alone"
        )
    return name


def airframe(name: str, craft: LinearAircraft) -> str:
    """An airframe file of PX4's simulation: allocation, throws in degrees, motor. Gains are those of gz_advanced_plane."""
    lines = [
        "#!/bin/sh", "#", f"# @name {name}", "#", f"# Written by sideslip export --to gazebo. Gains: those of airframe {BASE}.",
        f"# Needs {NEEDS}.", "", "PX4_SIMULATOR=${PX4_SIMULATOR:=gz}", "PX4_GZ_WORLD=${PX4_GZ_WORLD:=default}",
        f"PX4_SIM_MODEL=${{PX4_SIM_MODEL:={name}}}", "", f". ${{R}}etc/init.d-posix/airframes/{BASE}_gz_advanced_plane", "",
        f"param set-default CA_SV_CS_COUNT {len(FLAPS)}",
    ]  # fmt: skip
    for i, flap in enumerate(FLAPS):
        effect, kind = EFFECTS[flap.link]
        throw = math.degrees(craft.throws[flap.delta][1])
        lines += [
            f"param set-default CA_SV_CS{i}_{effect}",
            f"param set-default CA_SV_CS{i}_TYPE {kind}",
            f"param set-default SIM_GZ_SV_FUNC{i + 1} {201 + i}",
            f"param set-default SIM_GZ_SV_MINA{i + 1} {-throw:.6g}",
            f"param set-default SIM_GZ_SV_MAXA{i + 1} {throw:.6g}",
        ]
    if craft.thrust:
        lines += ["param set-default SIM_GZ_EC_FUNC1 101", f"param set-default SIM_GZ_EC_MAX1 {FASTEST:g}"]
    return "\n".join([*lines, ""])


def airframe_name(name: str) -> str:
    """File name of the airframe."""
    return f"{OWN}_gz_{name}"


def config(name: str, title: str) -> ET.Element:
    """model.config."""
    root = ET.Element("model")
    for tag, text in (("name", name), ("version", "1.0")):
        ET.SubElement(root, tag).text = text
    ET.SubElement(root, "sdf", version="1.9").text = "model.sdf"
    author = ET.SubElement(root, "author")
    ET.SubElement(author, "name").text = "sideslip export"
    ET.SubElement(root, "description").text = f"{title}; needs {NEEDS}"
    ET.indent(root)
    return root


def command_lines(folder: Path, name: str) -> list[str]:
    """How to fly it."""
    above = shlex.quote(str(folder.resolve().parent))
    return [
        f"needs: {NEEDS}",
        f"fly it: copy {airframe_name(name)} to PX4's ROMFS/px4fmu_common/init.d-posix/airframes, its name into CMakeLists.txt"
        f" there; then GZ_SIM_RESOURCE_PATH={above} make px4_sitl gz_{name}",
        f"  or without building: GZ_SIM_RESOURCE_PATH={above} PX4_SYS_AUTOSTART={BASE} PX4_SIM_MODEL=gz_{name}"
        " ./build/px4_sitl_default/bin/px4 with the SIM_GZ_SV parameters of that file set by hand",
        "  gains are those of gz_advanced_plane; begin with the real aircraft's",
    ]
