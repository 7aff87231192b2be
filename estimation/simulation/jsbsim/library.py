"""The one place that imports JSBSim, an optional package, and silences it; which of an aircraft's properties are our surfaces."""

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
RADIUS = 6.4e8  # m: a hundred earths, so that 20 s of flight do not see the curve
STILL_EARTH = f"""<planet name="still"><semimajor_axis unit="M">{RADIUS}</semimajor_axis>
<semiminor_axis unit="M">{RADIUS}</semiminor_axis><rotation_rate unit="RAD/SEC">0.0</rotation_rate>
<GM unit="M3/SEC2">{GRAVITY * RADIUS**2}</GM><J2>0.0</J2></planet>"""
_PART = r"[A-Za-z_][\w.-]*(\[\d+\])?"
_PROPERTY = re.compile(rf"/?{_PART}(/{_PART})*/?")
PREFIX = "jsbsim:"  # of a simulation or an aircraft that is JSBSim's


def library() -> Any:
    """The package `jsbsim`. Raises MissingPackageError where it is not installed."""
    jsbsim = optional("jsbsim", "jsbsim:...")
    jsbsim.FGJSBBase().debug_lvl = 0  # it talks on standard output otherwise, and that may be somebody's pipe
    return jsbsim


def aircraft_file(which: str) -> Path:
    """The XML of an aircraft: of JSBSim's own by name, or of a folder or file that is named.

    Raises SimulationError where there is none.
    """
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
        sorted(p.name for p in library_folder.iterdir() if p.name[:2].lower() == which[:2].lower())[:6]
    )
    raise SimulationError(
        f"jsbsim:{which}: neither an aircraft of JSBSim, nor a folder NAME with NAME.xml in it"
        + (f"; JSBSim has {similar_names}" if similar_names else f"; JSBSim's own are in {library_folder}")
    )


def tree_of(path: Path) -> ET.Element:
    """The root of an aircraft's XML. Raises SimulationError where it is none, or is declared in a way that could swell."""
    return read_xml(path, "aircraft of JSBSim", SimulationError)


def loaded(
    path: Path,
    rate: float = 120.0,
    root: ET.Element | None = None,
    declared: Sequence[str] = (),
    still: bool = False,
) -> Any:
    """An executive with the aircraft of `path` loaded, steps of 1/rate s, that writes no files and opens no ports.

    root: another text in place of the file's. declared: properties of our own that are to exist before. still: over an earth that
    neither turns nor curves, as our equations of motion have it. Raises SimulationError where JSBSim refuses it.

    Loaded from a shadow of its folder in which the aircraft has no `output` and `input` sections: JSBSim would open their files
    wherever we are, at every `run_ic` again whatever it was told, and listen on the ports that a stranger's file names.
    """
    jsbsim = library()
    library_root = Path(jsbsim.get_default_root_dir())
    root = tree_of(path) if root is None else root
    for talk in [*root.findall("output"), *root.findall("input")]:  # files, and sockets that would listen for commands
        root.remove(talk)
    for name in properties_read(root):
        if not _PROPERTY.fullmatch(name):
            raise SimulationError(f"{path}: {name!r} is no name of a property of JSBSim")
    with TemporaryDirectory() as folder:
        shadow = Path(folder) / path.stem
        shadow.mkdir()
        for entry in path.parent.iterdir():
            if entry.name != path.name:
                (shadow / entry.name).symlink_to(entry)
        ET.ElementTree(root).write(shadow / path.name, encoding="utf-8")
        fdm = jsbsim.FGFDMExec(None)
        for name in declared:
            fdm[name] = 0.0
        if still:
            (Path(folder) / "planet.xml").write_text(STILL_EARTH, encoding="utf-8")
            fdm.load_planet(str(Path(folder) / "planet.xml"), False)
        fdm.set_dt(1.0 / rate)
        fdm.set_aircraft_path(folder)
        aircraft_root = path.parent.parent.parent
        for name, give in (("engine", fdm.set_engine_path), ("systems", fdm.set_systems_path)):
            give(str(aircraft_root / name if (aircraft_root / name).is_dir() else library_root / name))
        try:
            load_succeeded = fdm.load_model(path.stem)
        except (jsbsim.BaseError, RuntimeError, ValueError) as error:
            raise SimulationError(f"{path}: JSBSim cannot load it ({one_line(str(error)).strip()})") from error
    if not load_succeeded:
        raise SimulationError(f"{path}: JSBSim cannot load it; try it with JSBSim itself, which says why")
    section = root.find("aerodynamics")
    unknown = [] if section is None else [n for n in sorted(properties_read(section)) if not knows_property(fdm, n)]
    for name in unknown:
        fdm[name] = 0.0  # or JSBSim, which asks for its value once more as it ends, would end this process
    if unknown:
        raise SimulationError(f"{path}: JSBSim knows no property {unknown[0]}, which its aerodynamics reads")
    return fdm


def knows_property(fdm: Any, name: str) -> bool:
    """Whether a property exists. Asked before every first write: JSBSim creates an unknown one without a word."""
    return bool(fdm.get_property_manager().hasNode(name))


# Which properties of a JSBSim aircraft's aerodynamics are our three surfaces, and how each follows from them.
#
# `fcs/elevator-pos-norm` does not follow a written `fcs/elevator-pos-rad`; so every property that the aerodynamics reads is
# written by itself. A left aileron down (+) rolls right in JSBSim; our +delta_a rolls left.

Follows = Callable[[float], float]

SIGNS: Mapping[str, tuple[str, float]] = {
    "elevator": ("delta_e", 1.0),
    "rudder": ("delta_r", 1.0),
    "aileron": ("delta_a", -1.0),
    "left-aileron": ("delta_a", -1.0),
    "right-aileron": ("delta_a", 1.0),
}
"""JSBSim's word for a surface -> our column, and its sign."""


EXPORTED = "sideslip/"  # before positions behind what `sideslip export` found of an actuator


@dataclass(frozen=True)
class Surfaces:
    """writes: property -> (our column, its value from ours). held: other positions and flags that the aerodynamics reads.
    rates, lift_squared: whether it reads alphadot or betadot, or the square of lift, which JSBSim has of its last step."""

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
        raise SimulationError(f"{path}: has no section <aerodynamics>; nothing can be asked of it")
    return section


def properties_read(section: ET.Element) -> set[str]:
    """Names of all properties that functions and tables of a section read."""
    read = {(e.text or "").strip().lstrip("-") for e in section.iter() if e.tag in ("property", "p", "independentVar")}
    return {name for name in read if name}


def surfaces_of(path: Path) -> Surfaces:
    """The surfaces of an aircraft. Raises SimulationError for a normalised position whose travel the file does not say."""
    read = properties_read(aerodynamics_of(path))
    writes: dict[str, tuple[str, Follows]] = {}
    held_properties = []
    for name in sorted(n for n in read if n.startswith(("fcs/", "gear/", "propulsion/"))):
        surface, _, unit = name.removeprefix("fcs/").partition("-pos-")
        if surface.startswith(
            EXPORTED
        ):  # behind an actuator that is asked as if it were none: surfaces are where they act
            surface, unit = surface.removeprefix(EXPORTED), unit.partition("-")[0]
        size = surface.startswith("mag-")
        column, sign = SIGNS.get(surface.removeprefix("mag-"), ("", 0.0))
        if not column or unit not in ("rad", "deg", "norm"):
            held_properties.append(name)
        elif size:
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
    """Normalised position from deflection, by the `aerosurface_scale` of the aircraft that makes it (zero stays zero)."""
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
