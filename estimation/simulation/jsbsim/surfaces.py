"""Which properties of a JSBSim aircraft's aerodynamics are our three surfaces, and how each follows from them.

`fcs/elevator-pos-norm` does not follow a written `fcs/elevator-pos-rad`; so every property that the aerodynamics reads is
written by itself. A left aileron down (+) rolls right in JSBSim; our +delta_a rolls left.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from estimation.simulation.jsbsim.library import tree_of
from estimation.simulation.oracle import SimulationError

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
    found = tree_of(path).find("aerodynamics")
    if found is not None and found.get("file"):
        found = tree_of(path.parent / f"{found.get('file', '').removesuffix('.xml')}.xml")
    if found is None:
        raise SimulationError(f"{path}: has no section <aerodynamics>; nothing can be asked of it")
    return found


def properties_read(section: ET.Element) -> set[str]:
    """Names of all properties that functions and tables of a section read."""
    read = {(e.text or "").strip().lstrip("-") for e in section.iter() if e.tag in ("property", "p", "independentVar")}
    return {name for name in read if name}


def surfaces_of(path: Path) -> Surfaces:
    """The surfaces of an aircraft. Raises SimulationError for a normalised position whose travel the file does not say."""
    read = properties_read(aerodynamics_of(path))
    writes: dict[str, tuple[str, Follows]] = {}
    held = []
    for name in sorted(n for n in read if n.startswith(("fcs/", "gear/", "propulsion/"))):
        surface, _, unit = name.removeprefix("fcs/").partition("-pos-")
        if surface.startswith(
            EXPORTED
        ):  # behind an actuator that is asked as if it were none: surfaces are where they act
            surface, unit = surface.removeprefix(EXPORTED), unit.partition("-")[0]
        size = surface.startswith("mag-")
        column, sign = SIGNS.get(surface.removeprefix("mag-"), ("", 0.0))
        if not column or unit not in ("rad", "deg", "norm"):
            held.append(name)
        elif size:
            scale = 1.0 if unit == "rad" else float(np.degrees(1.0))
            writes[name] = column, lambda value, k=scale: k * abs(value)  # type: ignore[misc]
        elif unit == "norm":
            writes[name] = column, _normalised(path, surface, sign)
        else:
            scale = sign * (1.0 if unit == "rad" else float(np.degrees(1.0)))
            writes[name] = column, lambda value, k=scale: k * value  # type: ignore[misc]
    rates = any(n.rpartition("/")[2].startswith(("alphadot", "betadot")) for n in read)
    return Surfaces(writes, tuple(held), rates, "aero/cl-squared" in read)


def _normalised(path: Path, surface: str, sign: float) -> Follows:
    """Normalised position from deflection, by the `aerosurface_scale` of the aircraft that makes it (zero stays zero)."""
    for scale in tree_of(path).iter("aerosurface_scale"):
        inputs = [(e.text or "").strip() for e in scale.findall("input")]
        outputs = [(e.text or "").strip() for e in scale.findall("output")]
        if f"fcs/{surface}-pos-norm" not in outputs or inputs != [f"fcs/{surface}-pos-rad"]:
            continue
        try:
            low, high = (float(scale.findtext(f"domain/{end}", "")) for end in ("min", "max"))
            least, most = (float(scale.findtext(f"range/{end}", "")) for end in ("min", "max"))
        except ValueError:
            continue
        if low < 0.0 < high:
            return lambda value: sign * value * (most / high if sign * value > 0.0 else least / low)
    raise SimulationError(
        f"{path}: its aerodynamics reads fcs/{surface}-pos-norm, and no aerosurface_scale says how that follows the deflection;"
        " give the simulation as a Python function instead (module:function)"
    )
