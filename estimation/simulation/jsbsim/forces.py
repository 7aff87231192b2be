"""Forces and moments of a JSBSim aircraft: its own as coefficients, and increments to them in JSBSim's axes."""

from collections.abc import Mapping
from xml.etree import ElementTree as ET

from daq.utilities.constants import FOOT, POUND
from estimation.models.expressions import names_in
from estimation.simulation.jsbsim.functions import Term, Translator, copied, node, product, prop, total
from estimation.simulation.jsbsim.increments import Addend, Increments

OURS = "sideslip"
AXES = {"Cl": ("ROLL", "metrics/bw-ft"), "Cm": ("PITCH", "metrics/cbarw-ft"), "Cn": ("YAW", "metrics/bw-ft")}
ARM = (
    ("inertia/cg-x-in", "metrics/aero-rp-x-in"), ("metrics/aero-rp-y-in", "inertia/cg-y-in"),
    ("inertia/cg-z-in", "metrics/aero-rp-z-in"),
)  # fmt: skip
"""Body axes from the centre of gravity to AERORP, as differences of structural inches (x aft, y right, z up)."""


class Base:
    """The aircraft's own coefficients as functions before the axes; only those that an increment uses are written."""

    def __init__(self, aerodynamics: ET.Element) -> None:
        self._sums = {a.get("name", "").upper(): _sum_of(a) for a in aerodynamics.iter("axis")}

    def coefficients(self) -> dict[str, ET.Element]:
        """Symbol of the model -> property; `functions` makes the functions that set these properties."""
        return {f"{c}_sim": prop(f"aero/{OURS}/base/{c}") for c in ("CL", "CD", "CY", "Cl", "Cm", "Cn")}

    def functions(self, used: set[str]) -> list[ET.Element]:
        """The functions of all coefficients, each after those it depends on; none where `used` is empty."""
        if not used:
            return []
        D, Y, L = (prop(f"aero/{OURS}/base/{n}") for n in ("drag", "side", "lift"))
        functions = [
            _function(f"base/{n.lower()}", "force of the simulation alone, lbs", self._sums.get(n, 0.0))
            for n in ("DRAG", "SIDE", "LIFT")
        ]
        coefficients = {"CL": L, "CD": total(product(D, cos_beta()), product(Y, sin_beta())),
                "CY": total(product(-1.0, D, sin_beta()), product(Y, cos_beta()))}  # fmt: skip
        for name, force in coefficients.items():
            functions.append(_function(f"base/{name}", "of the simulation alone",
                                  node("quotient", force, product(prop("aero/qbar-psf"), prop("metrics/Sw-sqft")))))  # fmt: skip
        forces = body_forces(*(prop(f"aero/{OURS}/base/{c}") for c in ("CL", "CD", "CY")))
        for i, (name, (axis, length)) in enumerate(AXES.items()):
            moment = node("quotient", self._sums.get(axis, 0.0), pressure_moment(length))
            arm = node("quotient", about_centre(forces)[i], prop(length))
            functions.append(
                _function(f"base/{name}", "of the simulation alone, about the centre of gravity", total(moment, arm))
            )
        return functions


def _sum_of(axis: ET.Element) -> Term:
    """The sum of an axis' functions, as copies without names."""
    parts: list[Term] = []
    for function in axis.findall("function"):
        copy = ET.fromstring(ET.tostring(function))
        for element in copy.iter():
            element.attrib.pop("name", None)
        parts += [e for e in copy if e.tag not in ("description", "documentation")]
    return total(*parts)


def _function(name: str, description: str, value: Term) -> ET.Element:
    function = ET.Element("function", name=f"aero/{OURS}/{name}")
    function.append(node("description", description))
    function.append(value if isinstance(value, ET.Element) else node("value", repr(value)))
    return function


def cos_beta() -> ET.Element:
    return node("cos", prop("aero/beta-rad"))


def sin_beta() -> ET.Element:
    return node("sin", prop("aero/beta-rad"))


def pressure_moment(length: str) -> Term:
    """Dynamic pressure times area times a length [lbs ft]."""
    return product(prop("aero/qbar-psf"), prop("metrics/Sw-sqft"), prop(length))


def body_forces(CL: Term, CD: Term, CY: Term) -> tuple[Term, Term, Term]:
    """X, Y, Z in body axes over dynamic pressure and area, from lift and drag in stability axes and side force in body axes."""
    c, s = node("cos", prop("aero/alpha-rad")), node("sin", prop("aero/alpha-rad"))
    X = total(product(copied(CL), s), product(-1.0, copied(CD), c))
    Z = total(product(-1.0, copied(CL), copied(c)), product(-1.0, copied(CD), copied(s)))
    return X, copied(CY), Z


def about_centre(force: tuple[Term, Term, Term]) -> tuple[Term, Term, Term]:
    """Moments about the centre of gravity of a force at AERORP: arm x force, arm in feet."""
    x, y, z = (product(1.0 / 12.0, node("difference", prop(a), prop(b))) for a, b in ARM)
    X, Y, Z = force
    return (
        total(product(copied(y), copied(Z)), product(-1.0, copied(z), copied(Y))),
        total(product(copied(z), copied(X)), product(-1.0, copied(x), copied(Z))),
        total(product(copied(x), copied(Y)), product(-1.0, copied(y), copied(X))),
    )


def write_functions(increments: Increments, translator: Translator, aerodynamics: ET.Element, base: Base) -> list[str]:
    """Write the increments into their axes; returns the names of their functions."""
    names: list[str] = []
    terms: list[tuple[Addend, str, Term]] = []
    for addend in increments.addends:
        value = _value(addend, translator)
        if value == 0.0:
            continue
        name = addend.name if addend.name not in names else f"{addend.name}_{addend.line}"
        names.append(name)
        terms.append((addend, name, value))
    functions: list[ET.Element] = []
    forces: dict[str, list[Term]] = {"CL": [], "CD": [], "CY": []}
    for addend, name, value in terms:
        description = f"found by Sideslip: {addend.line} = ... + {addend.text}"
        if addend.line in AXES or addend.line in ("roll", "yaw", "p_dot", "q_dot", "r_dot"):
            for axis, moment in _moments(addend, value, translator.values).items():
                suffix = "" if addend.line in AXES else f"/{axis.lower()}"
                _axis(aerodynamics, axis).append(_function(f"{name}{suffix}", description, moment))
        else:
            functions.append(_function(name, description, value))
            addend_property = prop(f"aero/{OURS}/{name}")
            c, s = node("cos", prop("aero/alpha-rad")), node("sin", prop("aero/alpha-rad"))
            parts = {"CX": {"CL": (1.0, s), "CD": (-1.0, c)}, "CZ": {"CL": (-1.0, c), "CD": (-1.0, s)}}
            for coefficient, factors in parts.get(addend.line, {addend.line: ()}).items():
                forces[coefficient].append(product(addend_property, *factors))
    prefix = f"aero/{OURS}/base/"
    read = {e.text or "" for n in [*functions, *aerodynamics.iter("axis")] for e in n.iter("property")}
    used_coefficients = {name.removeprefix(prefix) for name in read if name.startswith(prefix)}
    functions = [*base.functions(used_coefficients), *functions]
    if any(forces.values()):
        _write_forces(aerodynamics, functions, forces)
    # before the first axis, and so after the aircraft's own functions, on which ours may depend
    place = next((i for i, e in enumerate(aerodynamics) if e.tag == "axis"), len(aerodynamics))
    aerodynamics[place:place] = functions
    return names


def _value(addend: Addend, translator: Translator) -> Term:
    """An addend less the simulation's own coefficient, which the aircraft has already."""
    simulation_symbol = f"{addend.line}_sim"
    full_term = translator.term(addend.text)
    if simulation_symbol not in names_in(addend.text):
        return full_term
    if isinstance(full_term, ET.Element) and full_term.tag == "property":
        return 0.0
    if (
        isinstance(full_term, ET.Element)
        and full_term.tag == "product"
        and len(full_term) == 2
        and full_term[0].tag == "value"
    ):
        return product(float(full_term[0].text or 0.0) - 1.0, full_term[1])
    return total(full_term, product(-1.0, translator.known[simulation_symbol]))


def _moments(addend: Addend, value: Term, constants: Mapping[str, float]) -> dict[str, Term]:
    """Axis -> moment [lbs ft] of an addend to a coefficient, to a moment [N m] or to an angular acceleration [rad/s2]."""
    if addend.line in AXES:
        axis, length = AXES[addend.line]
        return {axis: product(prop("aero/qbar-psf"), prop("metrics/Sw-sqft"), prop(length), value)}
    pound_feet = 1.0 / (POUND * FOOT)  # of one N m
    k = {n: constants.get(n, 0.0) for n in ("Ixx", "Iyy", "Izz", "Ixz")}
    rows = {
        "roll": {"ROLL": 1.0}, "yaw": {"YAW": 1.0}, "q_dot": {"PITCH": k["Iyy"]},
        "p_dot": {"ROLL": k["Ixx"], "YAW": -k["Ixz"]}, "r_dot": {"YAW": k["Izz"], "ROLL": -k["Ixz"]},
    }  # fmt: skip
    moments = {axis: product(pound_feet * size, copied(value)) for axis, size in rows[addend.line].items()}
    return {axis: moment for axis, moment in moments.items() if moment != 0.0}


def _axis(aerodynamics: ET.Element, name: str) -> ET.Element:
    """The axis of that name, which is added where it is missing."""
    for axis in aerodynamics.iter("axis"):
        if axis.get("name", "").upper() == name:
            return axis
    return ET.SubElement(aerodynamics, "axis", name=name)


def _write_forces(aerodynamics: ET.Element, functions: list[ET.Element], forces: Mapping[str, list[Term]]) -> None:
    """Write increments of lift, drag (stability axes) and side force (body axes) into wind axes, and cancel the moment that they
    get by acting at AERORP."""
    for name, parts in forces.items():
        functions.append(_function(f"delta-{name}", "sum of what was found", total(*parts)))
    dL, dD, dY = (prop(f"aero/{OURS}/delta-{c}") for c in ("CL", "CD", "CY"))
    area = product(prop("aero/qbar-psf"), prop("metrics/Sw-sqft"))
    wind_forces = {
        "LIFT": dL,
        "DRAG": total(product(dD, cos_beta()), product(-1.0, dY, sin_beta())),
        "SIDE": total(product(dD, sin_beta()), product(dY, cos_beta())),
    }
    for axis, value in wind_forces.items():
        description = "what was found of forces, turned into wind axes"
        _axis(aerodynamics, axis).append(
            _function(f"found-{axis.lower()}", description, product(copied(area), copied(value)))
        )
    for axis, arm in zip(("ROLL", "PITCH", "YAW"), about_centre(body_forces(dL, dD, dY)), strict=True):
        description = "takes off the moment that these forces have because they act at AERORP"
        _axis(aerodynamics, axis).append(
            _function(f"arm-{axis.lower()}", description, product(-1.0, copied(area), arm))
        )
