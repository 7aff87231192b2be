"""From a model or aircraft file to a simulator's files with a proof: `sideslip export --to ardupilot|gazebo|neutral`."""

import math
import shlex
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree as ET

from daq.utilities.outputs import write_json, write_text
from estimation.simulation.autopilot import ardupilot, gazebo
from estimation.simulation.autopilot.against import SimulatorProof, against_gazebo, against_sitl, against_text
from estimation.simulation.autopilot.ardupilot import file_text, read_sitl_plane
from estimation.simulation.autopilot.gathering import Gathered, Stated, gather_aircraft
from estimation.simulation.autopilot.gazebo import FASTEST, FLAPS, NEEDS
from estimation.simulation.autopilot.gazebo_file import read_gazebo_plane
from estimation.simulation.autopilot.linear import LinearAircraft
from estimation.simulation.autopilot.neutral import full_model, neutral, read_back
from estimation.simulation.oracle import SimulationError

BASE = 4008  # PX4's airframe gz_advanced_plane, whose gains the written airframe starts with
FREE_NUMBER = 22500  # of an airframe, not used by PX4
LEAST_STALL = 0.2  # rad: with an earlier stall the blend changes lift where an aircraft flies
EFFECTS = {
    "left_aileron": ("TRQ_R -0.5", 1), "right_aileron": ("TRQ_R 0.5", 2), "elevator": ("TRQ_P 1", 3), "rudder": ("TRQ_Y 1", 4),
}  # fmt: skip
"""Link -> its torque in PX4's control allocation, and its type there."""


def check_folder_name(folder: Path) -> str:
    """The model's name, which is the folder's. Raises SimulationError for a name that Gazebo or PX4 cannot use."""
    name = folder.resolve().name
    if not name.replace("_", "").isalnum() or not name.isascii():
        raise SimulationError(
            f"{folder}: the folder's name is the model's, which PX4 puts behind gz_; use letters, digits and _ alone"
        )
    return name


def airframe(name: str, linear: LinearAircraft) -> str:
    """The text of an airframe file for PX4's simulation: allocation, throws in degrees, motor. Gains: of gz_advanced_plane."""
    lines = [
        "#!/bin/sh", "#", f"# @name {name}", "#", f"# Written by sideslip export --to gazebo. Gains: those of airframe {BASE}.",
        f"# Needs {NEEDS}.", "", "PX4_SIMULATOR=${PX4_SIMULATOR:=gz}", "PX4_GZ_WORLD=${PX4_GZ_WORLD:=default}",
        f"PX4_SIM_MODEL=${{PX4_SIM_MODEL:={name}}}", "", f". ${{R}}etc/init.d-posix/airframes/{BASE}_gz_advanced_plane", "",
        f"param set-default CA_SV_CS_COUNT {len(FLAPS)}",
    ]  # fmt: skip
    for i, flap in enumerate(FLAPS):
        effect, kind = EFFECTS[flap.link]
        throw = math.degrees(linear.throws[flap.delta][1])
        lines += [
            f"param set-default CA_SV_CS{i}_{effect}",
            f"param set-default CA_SV_CS{i}_TYPE {kind}",
            f"param set-default SIM_GZ_SV_FUNC{i + 1} {201 + i}",
            f"param set-default SIM_GZ_SV_MINA{i + 1} {-throw:.6g}",
            f"param set-default SIM_GZ_SV_MAXA{i + 1} {throw:.6g}",
        ]
    if linear.thrust:
        lines += ["param set-default SIM_GZ_EC_FUNC1 101", f"param set-default SIM_GZ_EC_MAX1 {FASTEST:g}"]
    return "\n".join([*lines, ""])


def airframe_name(name: str) -> str:
    return f"{FREE_NUMBER}_gz_{name}"


def config(name: str, title: str) -> ET.Element:
    """The XML of model.config."""
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
    """How to fly the model with PX4."""
    parent_folder = shlex.quote(str(folder.resolve().parent))
    return [
        f"needs: {NEEDS}",
        f"fly it: copy {airframe_name(name)} to PX4's ROMFS/px4fmu_common/init.d-posix/airframes, its name into CMakeLists.txt"
        f" there; then GZ_SIM_RESOURCE_PATH={parent_folder} make px4_sitl gz_{name}",
        f"  or without building: GZ_SIM_RESOURCE_PATH={parent_folder} PX4_SYS_AUTOSTART={BASE} PX4_SIM_MODEL=gz_{name}"
        " ./build/px4_sitl_default/bin/px4 with the SIM_GZ_SV parameters of that file set by hand",
        "  gains are those of gz_advanced_plane; begin with the real aircraft's",
    ]


@dataclass(frozen=True)
class Request:
    """Options of an export. stall: angle of attack [rad], None where it is not stated. force: replace existing files. only_prove:
    write nothing, and compare the existing files with the model."""

    stated: Stated = field(default_factory=Stated)
    stall: float | None = None
    force: bool = False
    only_prove: bool = False


@dataclass(frozen=True)
class ExportedSimulator:
    """files: the written ones, none where they were only proved. lines: notes, warnings and commands to print with the proof."""

    files: tuple[Path, ...]
    proof: SimulatorProof
    lines: tuple[str, ...]


def to_ardupilot(path: Path, out: Path, request: Request) -> ExportedSimulator:
    """Write `out`, a file of ArduPilot's SITL. Raises a UserError, before anything is written, for what it cannot express."""
    ardupilot.check_name(out)
    ardupilot.check_stall(request.stall)
    _check_free((out,), request)
    gathered = gather_aircraft(path, request.stated, "ArduPilot's SITL", needs_thrust=False)
    linear = gathered.linear
    values = ardupilot.sitl_values(linear, request.stall)
    if not request.only_prove:
        omitted_terms = [(n, linear[n]) for n in ardupilot.left_out(linear)] + list(gathered.beyond)
        comments = ardupilot.comments(linear, path.name, omitted_terms, request.stall)
        write_text(file_text(values, comments), out)
    plane = read_sitl_plane(out)
    proof = against_sitl(plane, linear, gathered.beyond)
    lines = list(linear.notes)
    if request.stall is None:
        lines.append(f"stall: not stated, so it is at {ardupilot.STALL} rad, as late as SITL allows; --alpha-stall RAD")
    lines += ardupilot.command_lines(out, linear.thrust, linear.aircraft.mass)
    return ExportedSimulator(() if request.only_prove else (out,), proof, tuple(lines))


def to_gazebo(path: Path, out: Path, request: Request) -> ExportedSimulator:
    """Write the folder `out`, a model of Gazebo with PX4's airframe. Raises as `to_ardupilot` does."""
    name = check_folder_name(out)
    if request.stall is not None and not LEAST_STALL <= request.stall <= gazebo.STALL:
        raise SimulationError(
            f"--alpha-stall {request.stall:g}: give {LEAST_STALL} to {gazebo.STALL:g} rad (11 to 115 deg)"
        )
    files = (out / "model.config", out / "model.sdf", out / airframe_name(name))
    _check_free(files, request)
    gathered = gather_aircraft(path, request.stated, "a Gazebo model", needs_thrust=True)
    linear = gathered.linear
    sdf = gazebo.model_sdf(name, linear, request.stall)
    if not request.only_prove:
        for file, text in zip(
            files, (_xml(config(name, linear.title)), _xml(sdf), airframe(name, linear)), strict=True
        ):
            write_text(text, file)
    plane = read_gazebo_plane(files[1])
    proof = against_gazebo(plane, linear, gathered.beyond)
    return ExportedSimulator(
        () if request.only_prove else files,
        proof,
        (*linear.notes, *_warnings(gathered, request), *command_lines(out, name)),
    )


def _xml(root: ET.Element) -> str:
    return f'<?xml version="1.0"?>\n{ET.tostring(root, encoding="unicode")}\n'


def _warnings(gathered: Gathered, request: Request) -> list[str]:
    lines = []
    if not gazebo.possible(gazebo.inertia_of(gathered.linear).inertia):
        lines.append("warning: no body has this inertia (one principal moment is above the sum of the others), and gz-sim will"
                     " not load it; weigh and swing the aircraft again")  # fmt: skip
    if request.stall is None:
        lines.append(f"stall: not stated, so it is at {gazebo.STALL:g} rad, out of reach; --alpha-stall RAD")
    return lines


def _check_free(files: tuple[Path, ...], request: Request) -> None:
    """Raise SimulationError for a file that exists and may not be replaced."""
    for file in files:
        if not request.only_prove and file.exists() and not request.force:
            raise SimulationError(f"{file}: exists already; give another name, or --force to replace it")


def to_neutral(path: Path, out: Path, request: Request) -> ExportedSimulator:
    """Write `out`, the full aerodynamic model as JSON. Raises as `to_ardupilot` does."""
    if out.suffix.lower() != ".json":
        raise SimulationError(f"{out}: the neutral form is JSON; end the name in .json")
    _check_free((out,), request)
    model, body, more = full_model(path, request.stated)
    content = neutral(model, body, more)
    if not request.only_prove:
        write_json(content, out)
    proof = against_text(read_back(out), model, body)
    reader = "read it with docs/examples/read_neutral.py or read_neutral.m; every key: docs/export.md"
    return ExportedSimulator(() if request.only_prove else (out,), proof, (*more["notes"], reader))
