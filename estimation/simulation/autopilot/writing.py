"""From a model or aircraft file to a simulator's files, proved on the spot: what `sideslip export --to ardupilot|gazebo` does."""

from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree as ET

from daq.contract.outputs import write_json, write_text
from estimation.simulation.autopilot import ardupilot, gazebo, px4
from estimation.simulation.autopilot.against import SimulatorProof, against_gazebo, against_sitl, against_text
from estimation.simulation.autopilot.ardupilot_file import file_text, read_sitl_plane
from estimation.simulation.autopilot.gathering import Gathered, Stated, gathered
from estimation.simulation.autopilot.gazebo_file import read_gazebo_plane
from estimation.simulation.autopilot.neutral import neutral, read_back
from estimation.simulation.autopilot.whole_model import whole_model
from estimation.simulation.oracle import SimulationError


@dataclass(frozen=True)
class Request:
    """stall: angle of attack [rad], None where nobody states it. force: files that exist are replaced. only_prove: nothing is
    written; what stands there is held against the model."""

    stated: Stated = field(default_factory=Stated)
    stall: float | None = None
    force: bool = False
    only_prove: bool = False


@dataclass(frozen=True)
class ExportedSimulator:
    """files: what was written, nothing where it was only proved. lines: what a person should read beside the proof."""

    files: tuple[Path, ...]
    proof: SimulatorProof
    lines: tuple[str, ...]


def to_ardupilot(path: Path, out: Path, request: Request) -> ExportedSimulator:
    """Write `out`, a file of ArduPilot's SITL. Raises a UserError, before anything is written, where it cannot be right."""
    ardupilot.check_name(out)
    ardupilot.check_stall(request.stall)
    _check_free((out,), request)
    made = gathered(path, request.stated, "ArduPilot's SITL", needs_thrust=False)
    craft = made.craft
    if not request.only_prove:
        left = [(n, craft[n]) for n in ardupilot.left_out(craft)] + list(made.beyond)
        comments = ardupilot.comments(craft, path.name, left, request.stall)
        write_text(file_text(ardupilot.sitl_values(craft, request.stall), comments), out)
    ardupilot.sitl_values(craft, request.stall)  # refuses what no file could say, also where nothing is written
    plane = read_sitl_plane(out)
    proof = against_sitl(plane, craft, made.beyond)
    flying = ardupilot.command_lines(out, craft.thrust, craft.aircraft.mass)
    stall = (
        ()
        if request.stall is not None
        else (
            f"stall: nobody states it, so that it is at {ardupilot.STALL} rad, as late as SITL allows; --alpha-stall RAD",
        )
    )
    return ExportedSimulator(() if request.only_prove else (out,), proof, (*craft.notes, *stall, *flying))


def to_gazebo(path: Path, out: Path, request: Request) -> ExportedSimulator:
    """Write the folder `out`, a model of Gazebo with PX4's airframe. Raises as `to_ardupilot` does."""
    name = px4.check_folder_name(out)
    if request.stall is not None and not 0.2 <= request.stall <= gazebo.STALL:
        raise SimulationError(f"--alpha-stall {request.stall:g}: give 0.2 to {gazebo.STALL:g} rad (11 to 115 deg)")
    files = (out / "model.config", out / "model.sdf", out / px4.airframe_name(name))
    _check_free(files, request)
    made = gathered(path, request.stated, "a Gazebo model", needs_thrust=True)
    craft = made.craft
    sdf = gazebo.model_sdf(name, craft, request.stall)
    if not request.only_prove:
        for file, text in zip(
            files, (_xml(px4.config(name, craft.title)), _xml(sdf), px4.airframe(name, craft)), strict=True
        ):
            write_text(text, file)
    plane = read_gazebo_plane(files[1])
    proof = against_gazebo(plane, craft, made.beyond)
    return ExportedSimulator(
        () if request.only_prove else files,
        proof,
        (*craft.notes, *_warnings(made, request), *px4.command_lines(out, name)),
    )


def _xml(root: ET.Element) -> str:
    return f'<?xml version="1.0"?>\n{ET.tostring(root, encoding="unicode")}\n'


def _warnings(made: Gathered, request: Request) -> list[str]:
    lines = []
    if not gazebo.possible(gazebo.inertia_of(made.craft).inertia):
        lines.append("warning: no body has this inertia (one principal moment is above the sum of the others), and gz-sim will"
                     " not load it; weigh and swing the aircraft again")  # fmt: skip
    if request.stall is None:
        lines.append(f"stall: nobody states it, so that it is at {gazebo.STALL:g} rad, out of reach; --alpha-stall RAD")
    return lines


def _check_free(files: tuple[Path, ...], request: Request) -> None:
    """Raise SimulationError for a file that exists and may not be replaced, or that is to be proved and does not exist."""
    for file in files:
        if not request.only_prove and file.exists() and not request.force:
            raise SimulationError(f"{file}: exists already; give another name, or --force to replace it")


def to_neutral(path: Path, out: Path, request: Request) -> ExportedSimulator:
    """Write `out`, the whole build-up as JSON. Raises as `to_ardupilot` does."""
    if out.suffix.lower() != ".json":
        raise SimulationError(f"{out}: the neutral form is JSON; end the name in .json")
    _check_free((out,), request)
    model, body, more = whole_model(path, request.stated)
    content = neutral(model, body, more)
    if not request.only_prove:
        write_json(content, out)
    proof = against_text(read_back(out), model, body)
    reader = "read it with docs/examples/read_neutral.py or read_neutral.m; every key: docs/export.md"
    return ExportedSimulator(() if request.only_prove else (out,), proof, (*more["notes"], reader))
