"""A model found on a JSBSim aircraft, written back as a copy of the aircraft with the model's increments.

Each term of a moment becomes a function in its axis. Our force terms act in body and stability axes at the centre of gravity,
while JSBSim's LIFT, DRAG and SIDE are wind axes and act at AERORP: forces are rotated, and their moment about that point is
cancelled. An effect on a surface becomes components after its position, whose output the whole aerodynamics reads.
"""

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

from daq.utilities.durable import replacing_folder, whole
from estimation.models.base import Model
from estimation.simulation.jsbsim.aircraft import aircraft_as_loaded
from estimation.simulation.jsbsim.components import chains_of, states_of, surfaces_read
from estimation.simulation.jsbsim.forces import OURS, Base, write_functions
from estimation.simulation.jsbsim.functions import Term, Translator
from estimation.simulation.jsbsim.increments import Increments, increments_of
from estimation.simulation.jsbsim.library import SLUG_FOOT2, loaded, tree_of
from estimation.simulation.oracle import SimulationError

SAME_MASS = 1e-3  # relative: by which the model's mass may differ from the aircraft's as loaded


@dataclass(frozen=True)
class JsbsimExport:
    """file: the aircraft's XML. terms: names of the added functions and components. left_out: phrases on the rest."""

    file: Path
    terms: tuple[str, ...]
    left_out: tuple[str, ...]


@dataclass(frozen=True)
class WrittenAircraft:
    """An aircraft's XML with the increments. chains: property that the aerodynamics now reads -> original position."""

    root: ET.Element
    terms: tuple[str, ...]
    chains: Mapping[str, str]


def export_aircraft(
    model: Model, source: Path, folder: Path, lineage: str, rate: float
) -> tuple[JsbsimExport, WrittenAircraft, Increments]:
    """Write NAME-sideslip/NAME-sideslip.xml into `folder`, NAME the aircraft `source`. rate: JSBSim steps per second, the unit of
    delays. Raises SimulationError, before anything is written, for what an aircraft cannot have."""
    increments = increments_of(model)
    written_aircraft = write_aircraft(increments, source, rate, lineage)
    name = f"{source.stem}-{OURS}"
    target = folder / name
    if target.exists() and (target / f"{source.stem}.xml").resolve() == source:
        raise SimulationError(f"{target}: that is the aircraft to start from; choose another --out")
    written_aircraft.root.set("name", name)
    ET.indent(written_aircraft.root)
    with replacing_folder(target) as new:
        shutil.copytree(source.parent, new, dirs_exist_ok=True)
        (new / source.name).unlink()
        with whole(new / f"{name}.xml") as file:
            ET.ElementTree(written_aircraft.root).write(file, encoding="utf-8", xml_declaration=True)
    return (
        JsbsimExport(target / f"{name}.xml", written_aircraft.terms, increments.left_out),
        written_aircraft,
        increments,
    )


WIND_AXES = {"LIFT", "DRAG", "SIDE", "ROLL", "PITCH", "YAW"}


def write_aircraft(increments: Increments, source: Path, rate: float, lineage: str) -> WrittenAircraft:
    """The XML of the aircraft `source` with the increments. rate: JSBSim steps per second; lineage: a note for its header. Raises
    SimulationError for what cannot be written."""
    root = inlined(source)
    aerodynamics = _child(root, "aerodynamics")
    other_axes = {a.get("name", "").upper() for a in aerodynamics.iter("axis")} - WIND_AXES
    if other_axes:
        raise SimulationError(
            f"{source}: its aerodynamics is in axes {', '.join(sorted(other_axes))}; only wind axes can be added to"
        )
    values = _values(increments.physical)
    chains, channel = chains_of(increments, values, source, rate)
    for element in list(aerodynamics.iter()):
        text = (element.text or "").strip()
        for new, old in chains.items():
            if text.lstrip("-") == old:
                element.text = f"{'-' if text.startswith('-') else ''}{new}"
    base = Base(aerodynamics)
    properties: dict[str, Term] = {**base.coefficients(), **surfaces_read(source, chains)}
    translator = Translator(increments.physical, properties, values)
    channel += states_of(increments, translator, rate, properties)
    terms = write_functions(increments, translator, aerodynamics, base)
    if channel:
        control = _child(root, "flight_control")
        if not control.get("name"):
            control.set("name", OURS)
        section = ET.SubElement(control, "channel", name=OURS)
        section.extend(channel)
        terms += [e.get("name", "") for e in channel]
    terms += _inertia(increments.physical, root, source)
    header = _child(root, "fileheader", first=True)
    ET.SubElement(header, "note").text = lineage
    return WrittenAircraft(root, tuple(terms), chains)


def inlined(source: Path) -> ET.Element:
    """The aircraft's XML with aerodynamics and flight control included from their own files."""
    root = tree_of(source)
    for tag in ("aerodynamics", "flight_control"):
        section = root.find(tag)
        if section is not None and section.get("file"):
            include_path = source.parent / f"{section.get('file', '').removesuffix('.xml')}.xml"
            included = tree_of(include_path)
            del section.attrib["file"]
            section.attrib.update({k: v for k, v in included.attrib.items() if k != "file"})
            section.extend(list(included))
    return root


def _child(root: ET.Element, tag: str, first: bool = False) -> ET.Element:
    """The section `tag`, which is added where it is missing; first: before all others."""
    child = root.find(tag)
    if child is None:
        child = ET.Element(tag)
        if first:
            root.insert(0, child)
        elif tag == "flight_control" and (aerodynamics := root.find("aerodynamics")) is not None:
            root.insert(list(root).index(aerodynamics), child)
        else:
            root.append(child)
    return child


def _values(model: Model) -> dict[str, float]:
    return {**{n: float(v) for n, v in model.constants.items()}, **model.starts()}


def _inertia(model: Model, root: ET.Element, source: Path) -> list[str]:
    """Write the model's moments of inertia where they differ from the aircraft's as loaded; returns their names. Raises
    SimulationError where the mass differs."""
    values = _values(model)
    loaded_aircraft = aircraft_as_loaded(loaded(source), source.stem)
    if abs(values["m"] / loaded_aircraft.mass - 1.0) > SAME_MASS:
        raise SimulationError(
            f"model {model.name}: its mass is {values['m']:.5g} kg, that of {source.stem} as loaded"
            f" {loaded_aircraft.mass:.5g} kg; set weight, loads and fuel of the aircraft to what was flown, and start again"
        )
    changed = []
    balance = _child(root, "mass_balance")
    for name, sign in (("Ixx", 1.0), ("Iyy", 1.0), ("Izz", 1.0), ("Ixz", -1.0)):
        if name not in values:
            continue
        added_inertia = sign * (values[name] - getattr(loaded_aircraft, name)) / SLUG_FOOT2
        if abs(added_inertia) * SLUG_FOOT2 > SAME_MASS * loaded_aircraft.Ixx:
            _add_inertia(balance, name.lower(), added_inertia)
            changed.append(name.lower())
    return changed


def _add_inertia(balance: ET.Element, tag: str, increment: float) -> None:
    """Add to a moment of inertia of the empty aircraft [slug ft2]. A file's ixz is the product unless it says otherwise."""
    element = balance.find(tag)
    if element is None:
        element = ET.SubElement(balance, tag, unit="SLUG*FT2")
        element.text = "0"
    unit = 1.0 if element.get("unit", "SLUG*FT2") == "SLUG*FT2" else SLUG_FOOT2
    negated = balance.get("negated_crossproduct_inertia", "true") == "true"
    sign = -1.0 if tag == "ixz" and not negated else 1.0
    element.text = repr(float(element.text or 0.0) + sign * increment * unit)
