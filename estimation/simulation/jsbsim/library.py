"""JSBSim, an optional package that is imported only here; and which of an aircraft's properties are our surfaces."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from daq.utilities.constants import FOOT, GRAVITY, SLUG
from daq.utilities.input_files import read_xml
from daq.utilities.packages import optional
from daq.utilities.plain_words import one_line
from estimation.simulation.oracle import SimulationError

SLUG_FOOT2 = SLUG * FOOT**2
RADIUS = 6.4e8  # m: a hundred earth radii, so that 20 s of flight do not show the curvature
STILL_EARTH = f"""<planet name="still"><semimajor_axis unit="M">{RADIUS}</semimajor_axis>
<semiminor_axis unit="M">{RADIUS}</semiminor_axis><rotation_rate unit="RAD/SEC">0.0</rotation_rate>
<GM unit="M3/SEC2">{GRAVITY * RADIUS**2}</GM><J2>0.0</J2></planet>"""
_PART = r"[A-Za-z_][\w.-]*(\[\d+\])?"
_PROPERTY = re.compile(rf"/?{_PART}(/{_PART})*/?")
PREFIX = "jsbsim:"  # of the text that names a simulation or an aircraft of JSBSim
MOST_SIMILAR = 6  # names that a message suggests


def library() -> Any:
    """The package `jsbsim`. Raises MissingPackageError where it is not installed."""
    jsbsim = optional("jsbsim", "jsbsim:...")
    jsbsim.FGJSBBase().debug_lvl = 0  # otherwise it prints on standard output, which may be a pipe
    return jsbsim


def aircraft_file(which: str) -> Path:
    """The XML file of an aircraft: by name of JSBSim's own, or by folder or file. Raises SimulationError where there is none."""
    path = Path(which).expanduser()
    if path.suffix == ".xml" and path.is_file():
        if path.stem != path.parent.name:
            raise SimulationError(
                f"{path}: JSBSim finds an aircraft as NAME/NAME.xml; put the file into a folder called {path.stem}"
            )
        return path.resolve()
    if (folder_file := path / f"{path.name}.xml").is_file():
        return folder_file.resolve()
    library_folder = Path(library().get_default_root_dir()) / "aircraft"
    if (built_in := library_folder / which / f"{which}.xml").is_file():
        return built_in
    similar_names = ", ".join(
        sorted(p.name for p in library_folder.iterdir() if p.name[:2].lower() == which[:2].lower())[:MOST_SIMILAR]
    )
    raise SimulationError(
        f"jsbsim:{which}: neither an aircraft of JSBSim, nor a folder NAME with NAME.xml in it"
        + (f"; JSBSim has {similar_names}" if similar_names else f"; JSBSim's own are in {library_folder}")
    )


def tree_of(path: Path) -> ET.Element:
    """The root of an aircraft's XML. Raises SimulationError for no XML, or for declarations that could expand without limit."""
    return read_xml(path, "aircraft of JSBSim", SimulationError)


def loaded(
    path: Path,
    rate: float = 120.0,
    root: ET.Element | None = None,
    declared: Sequence[str] = (),
    still: bool = False,
) -> Any:
    """An executive with the aircraft of `path` loaded, steps of 1/rate s, that writes no files and opens no ports.

    root: XML to use instead of the file's. declared: properties of ours that must exist before loading. still: over an earth that
    neither rotates nor curves, as in our equations of motion. Raises SimulationError where JSBSim refuses the aircraft.

    It is loaded from a copy of its folder in which the aircraft has no `output` and `input` sections. With these, JSBSim would
    write files into the working directory at every `run_ic`, and listen on ports that an untrusted file names.
    """
    jsbsim = library()
    library_root = Path(jsbsim.get_default_root_dir())
    root = tree_of(path) if root is None else root
    for section in [*root.findall("output"), *root.findall("input")]:  # files, and sockets for commands
        root.remove(section)
    for name in properties_read(root):
        if not _PROPERTY.fullmatch(name):
            raise SimulationError(f"{path}: {name!r} is no name of a property of JSBSim")
    with TemporaryDirectory() as folder:
        aircraft_copy = Path(folder) / path.stem
        aircraft_copy.mkdir()
        for entry in path.parent.iterdir():
            if entry.name != path.name:
                (aircraft_copy / entry.name).symlink_to(entry)
        ET.ElementTree(root).write(aircraft_copy / path.name, encoding="utf-8")
        fdm = jsbsim.FGFDMExec(None)
        for name in declared:
            fdm[name] = 0.0
        if still:
            (Path(folder) / "planet.xml").write_text(STILL_EARTH, encoding="utf-8")
            fdm.load_planet(str(Path(folder) / "planet.xml"), False)
        fdm.set_dt(1.0 / rate)
        fdm.set_aircraft_path(folder)
        aircraft_root = path.parent.parent.parent
        for name, set_path in (("engine", fdm.set_engine_path), ("systems", fdm.set_systems_path)):
            set_path(str(aircraft_root / name if (aircraft_root / name).is_dir() else library_root / name))
        try:
            load_succeeded = fdm.load_model(path.stem)
        except (jsbsim.BaseError, RuntimeError, ValueError) as error:
            raise SimulationError(f"{path}: JSBSim cannot load it ({one_line(str(error)).strip()})") from error
    if not load_succeeded:
        raise SimulationError(f"{path}: JSBSim cannot load it; try it with JSBSim itself, which says why")
    aerodynamics = root.find("aerodynamics")
    read = [] if aerodynamics is None else sorted(properties_read(aerodynamics))
    unknown = [n for n in read if not knows_property(fdm, n)]
    for name in unknown:
        fdm[name] = (
            0.0  # JSBSim reads the value once more when it is destroyed, and would abort this process without it
        )
    if unknown:
        raise SimulationError(f"{path}: JSBSim knows no property {unknown[0]}, which its aerodynamics reads")
    return fdm


def knows_property(fdm: Any, name: str) -> bool:
    """Whether a property exists. To be checked before a first write, because JSBSim silently creates an unknown one."""
    return bool(fdm.get_property_manager().hasNode(name))


# Which properties of a JSBSim aircraft's aerodynamics are our three surfaces, and how each follows from them.
#
# With the flight control off, `fcs/elevator-pos-norm` does not follow a written `fcs/elevator-pos-rad`, so every property that
# the aerodynamics reads is written separately. A left aileron down (+) rolls right in JSBSim; our +delta_a rolls left.

Follows = Callable[[float], float]

SIGNS: Mapping[str, tuple[str, float]] = {
    "elevator": ("delta_e", 1.0),
    "rudder": ("delta_r", 1.0),
    "aileron": ("delta_a", -1.0),
    "left-aileron": ("delta_a", -1.0),
    "right-aileron": ("delta_a", 1.0),
}
"""JSBSim's name of a surface -> our column, and its sign."""


EXPORTED = "sideslip/"  # begins positions after an actuator that `sideslip export` wrote


@dataclass(frozen=True)
class Surfaces:
    """writes: property -> (our column, function from our value to its). held: other positions and flags that the aerodynamics
    reads. rates, lift_squared: whether it reads alphadot or betadot, or the square of lift, all of JSBSim's last step."""

    writes: Mapping[str, tuple[str, Follows]]
    held: tuple[str, ...]
    rates: bool
    lift_squared: bool


def aerodynamics_of(path: Path) -> ET.Element:
    """The `aerodynamics` section, from the file itself or the one it names. Raises SimulationError where there is none."""
    section = tree_of(path).find("aerodynamics")
    if section is not None and section.get("file"):
        section = tree_of(path.parent / f"{section.get('file', '').removesuffix('.xml')}.xml")
    if section is None:
        raise SimulationError(f"{path}: has no section <aerodynamics>, so it has no coefficients")
    return section


def properties_read(section: ET.Element) -> set[str]:
    """Names of all properties that functions and tables of a section read."""
    read = {(e.text or "").strip().lstrip("-") for e in section.iter() if e.tag in ("property", "p", "independentVar")}
    return {name for name in read if name}


def surfaces_of(path: Path) -> Surfaces:
    """The surfaces of an aircraft. Raises SimulationError for a normalised position whose travel the file does not state."""
    read = properties_read(aerodynamics_of(path))
    writes: dict[str, tuple[str, Follows]] = {}
    held_properties = []
    for name in sorted(n for n in read if n.startswith(("fcs/", "gear/", "propulsion/"))):
        surface, _, unit = name.removeprefix("fcs/").partition("-pos-")
        if surface.startswith(EXPORTED):  # after an actuator, which is bypassed: surfaces are given as they act
            surface, unit = surface.removeprefix(EXPORTED), unit.partition("-")[0]
        magnitude = surface.startswith("mag-")
        column, sign = SIGNS.get(surface.removeprefix("mag-"), ("", 0.0))
        if not column or unit not in ("rad", "deg", "norm"):
            held_properties.append(name)
        elif magnitude:
            scale = 1.0 if unit == "rad" else float(np.degrees(1.0))
            writes[name] = column, lambda value, k=scale: k * abs(value)  # type: ignore[misc]
        elif unit == "norm":
            writes[name] = column, _normalised(path, surface, sign)
        else:
            scale = sign * (1.0 if unit == "rad" else float(np.degrees(1.0)))
            writes[name] = column, lambda value, k=scale: k * value  # type: ignore[misc]
    rates = any(n.rpartition("/")[2].startswith(("alphadot", "betadot")) for n in read)
    return Surfaces(writes, tuple(held_properties), rates, "aero/cl-squared" in read)


def _normalised(path: Path, surface: str, sign: float) -> Follows:
    """Function from deflection to normalised position, by the aircraft's `aerosurface_scale` for it (zero stays zero)."""
    for scale in tree_of(path).iter("aerosurface_scale"):
        inputs = [(e.text or "").strip() for e in scale.findall("input")]
        outputs = [(e.text or "").strip() for e in scale.findall("output")]
        if f"fcs/{surface}-pos-norm" not in outputs or inputs != [f"fcs/{surface}-pos-rad"]:
            continue
        try:
            low, high = (float(scale.findtext(f"domain/{end}", "")) for end in ("min", "max"))
            lowest, highest = (float(scale.findtext(f"range/{end}", "")) for end in ("min", "max"))
        except ValueError:
            continue
        if low < 0.0 < high:
            return lambda value: sign * value * (highest / high if sign * value > 0.0 else lowest / low)
    raise SimulationError(
        f"{path}: its aerodynamics reads fcs/{surface}-pos-norm, and no aerosurface_scale says how that follows the deflection;"
        " give the simulation as a Python function instead (module:function)"
    )
