"""The one place that imports JSBSim, an optional package, and silences it."""

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree as ET

from daq.contract.constants import FOOT, GRAVITY, SLUG
from daq.contract.input_files import read_xml
from estimation.simulation.oracle import SimulationError

SLUG_FOOT2 = SLUG * FOOT**2
RADIUS = 6.4e8  # m: a hundred earths, so that 20 s of flight do not see the curve
STILL_EARTH = f"""<planet name="still"><semimajor_axis unit="M">{RADIUS}</semimajor_axis>
<semiminor_axis unit="M">{RADIUS}</semiminor_axis><rotation_rate unit="RAD/SEC">0.0</rotation_rate>
<GM unit="M3/SEC2">{GRAVITY * RADIUS**2}</GM><J2>0.0</J2></planet>"""
PREFIX = "jsbsim:"  # of a simulation or an aircraft that is JSBSim's


def library() -> Any:
    """The package `jsbsim`. Raises SimulationError where it is not installed."""
    try:
        import jsbsim
    except ModuleNotFoundError as error:
        raise SimulationError(
            "jsbsim:... needs the package jsbsim, which is not installed; pip install 'sideslip[jsbsim]'"
        ) from error
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
    if (inside := path / f"{path.name}.xml").is_file():
        return inside.resolve()
    own = Path(library().get_default_root_dir()) / "aircraft"
    if (built_in := own / which / f"{which}.xml").is_file():
        return built_in
    near = ", ".join(sorted(p.name for p in own.iterdir() if p.name[:2].lower() == which[:2].lower())[:6])
    raise SimulationError(
        f"jsbsim:{which}: neither an aircraft of JSBSim, nor a folder NAME with NAME.xml in it"
        + (f"; JSBSim has {near}" if near else f"; JSBSim's own are in {own}")
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
    own = Path(jsbsim.get_default_root_dir())
    root = tree_of(path) if root is None else root
    for talk in [*root.findall("output"), *root.findall("input")]:  # files, and sockets that would listen for commands
        root.remove(talk)
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
        beside = path.parent.parent.parent
        for name, give in (("engine", fdm.set_engine_path), ("systems", fdm.set_systems_path)):
            give(str(beside / name if (beside / name).is_dir() else own / name))
        try:
            done = fdm.load_model(path.stem)
        except (jsbsim.BaseError, RuntimeError, ValueError) as error:
            raise SimulationError(f"{path}: JSBSim cannot load it ({error})") from error
    if not done:
        raise SimulationError(f"{path}: JSBSim cannot load it; try it with JSBSim itself, which says why")
    return fdm


def known(fdm: Any, name: str) -> bool:
    """Whether a property exists. Asked before every first write: JSBSim creates an unknown one without a word."""
    return bool(fdm.get_property_manager().hasNode(name))
