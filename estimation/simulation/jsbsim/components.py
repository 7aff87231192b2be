"""Effects on surfaces, and states of effects, as components of a JSBSim flight control."""

import ast
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

from estimation.models.base import InputTransform
from estimation.models.expressions import parse
from estimation.simulation.jsbsim.forces import OURS
from estimation.simulation.jsbsim.functions import PROPERTIES, Term, Translator, node, product, prop, total
from estimation.simulation.jsbsim.increments import Increments
from estimation.simulation.jsbsim.library import SIGNS, surfaces_of
from estimation.simulation.oracle import SURFACES, SimulationError

Maker = Callable[..., ET.Element]
USUAL = {"delta_e": "fcs/elevator-pos-rad", "delta_a": "fcs/left-aileron-pos-rad", "delta_r": "fcs/rudder-pos-rad"}
"""Positions that stand for a surface where the aerodynamics reads none."""


def surfaces_read(source: Path, chains: Mapping[str, str]) -> dict[str, ET.Element]:
    """Our column -> the position that the aerodynamics reads, with our sign."""
    chained_names = {old: new for new, old in chains.items()}
    read = surfaces_of(source).writes
    surface_properties = {}
    for column in SURFACES:
        name = next(
            (n for n, (c, _) in read.items() if c == column and n.endswith("-rad") and "mag-" not in n), USUAL[column]
        )
        sign = SIGNS[name.removeprefix("fcs/").removesuffix("-pos-rad")][1]
        surface_properties[column] = prop(chained_names.get(name, name), sign)
    return surface_properties


def chains_of(
    increments: Increments, values: Mapping[str, float], source: Path, rate: float
) -> tuple[dict[str, str], list[ET.Element]]:
    """(new property -> the position before the components, components) for all surfaces that an effect changes."""
    chains: dict[str, str] = {}
    components: list[ET.Element] = []
    for column in SURFACES:
        acting = [t for t in increments.transforms if t.input == column and not _changes_nothing(t, values)]
        names = [n for n, (c, _) in surfaces_of(source).writes.items() if c == column] or [USUAL[column]]
        for name in names if acting else ():
            if not name.endswith("-rad") or "mag-" in name:
                raise SimulationError(
                    f"{source}: its aerodynamics reads {name}, after which a {acting[0].kind} of {column} cannot be written; only"
                    " positions in rad can"
                )
            sign = SIGNS[name.removeprefix("fcs/").removesuffix("-pos-rad")][1]
            position = name
            for t in acting:
                new_components = _component(
                    t, values[t.parameters[0]], position, sign, f"fcs/{OURS}/{name.removeprefix('fcs/')}-{t.kind}", rate
                )
                components += new_components
                position = new_components[-1].get("name", "") if new_components else position
            chains[position] = name
    return chains, components


def _changes_nothing(transform: InputTransform, values: Mapping[str, float]) -> bool:
    return values[transform.parameters[0]] == (1.0 if transform.kind == "scale" else 0.0)


def _component(t: InputTransform, size: float, position: str, sign: float, name: str, rate: float) -> list[ET.Element]:
    """Components that do to a position what a transform does to a column. Widths of a deadband and of a play are full widths."""

    def make(tag: str, ending: str, *inside: ET.Element, inputs: tuple[str, ...] = (position,)) -> ET.Element:
        element = ET.Element(tag, name=f"{name}{ending}")
        element.extend([node("input", i) for i in inputs])
        element.extend(inside)
        return element

    match t.kind:
        case "lag":
            return [make("lag_filter", "", node("c1", repr(1.0 / size)))]
        case "deadzone":
            return [make("deadband", "", node("width", repr(2.0 * abs(size))), node("gain", "1"))]
        case "backlash":
            return [make("actuator", "", node("hysteresis_width", repr(abs(size))))]
        case "scale":
            return [make("pure_gain", "", node("gain", repr(size)))]
        case "bias":
            return [make("summer", "", node("bias", repr(sign * size)))]
    if size < 0.0:
        raise SimulationError(f"{t.input}: a delay of {size:g} s is none that a simulation can have")
    whole_frames, part = divmod(size * rate, 1.0)
    delays = [_frame_delay(make, "-early", int(whole_frames)), _frame_delay(make, "-late", int(whole_frames) + 1)]
    gains = [
        _gain(f"{name}{end}-share", source.get("name", ""), share)
        for end, source, share in (("-early", delays[0], 1.0 - part), ("-late", delays[1], part))
    ]
    return [*delays, *gains, make("summer", "", inputs=tuple(g.get("name", "") for g in gains))]


def _frame_delay(make: Maker, ending: str, frames: int) -> ET.Element:
    """A delay by whole frames. JSBSim's actuator delays by one frame less than it is told."""
    if frames == 0:
        return make("pure_gain", ending, node("gain", "1"))
    delay = node("delay", str(frames + 1))
    delay.set("type", "frames")
    return make("actuator", ending, delay)


def _gain(name: str, source: str, gain: float) -> ET.Element:
    element = ET.Element("pure_gain", name=name)
    element.extend([node("input", source), node("gain", repr(gain))])
    return element


def states_of(increments: Increments, translator: Translator, rate: float, known: dict[str, Term]) -> list[ET.Element]:
    """Lag filters for states of effects of the form x_dot = (input - x)/tau. Their properties are added to `known`."""
    filters: list[ET.Element] = []
    # the flight control reads the motion of the step before, which is extrapolated by its rate
    extrapolated = {
        n: total(prop(PROPERTIES[n][0]), product(1.0 / rate, prop(PROPERTIES[f"{n}_dot"][0])))
        for n in ("alpha", "beta", "p", "q", "r")
    }
    input_translator = replace(translator, known={**translator.known, **extrapolated})
    for state in increments.states:
        match parse(increments.physical.definitions[f"{state}_dot"]):
            case ast.BinOp(
                left=ast.BinOp(left=given, op=ast.Sub(), right=ast.Name(id=name)), op=ast.Div(), right=tau
            ) if name == state:
                seconds = translator.translated(tau, ())
            case _:
                seconds = math.nan
        if not isinstance(seconds, float | int) or not seconds > 0.0:
            raise SimulationError(
                f"model {increments.physical.name}: the state {state} is no lag of first order, and only these"
                " can be written for JSBSim"
            )
        function = ET.Element("fcs_function", name=f"fcs/{OURS}/{state}-input")
        function.append(node("function", input_translator.translated(given, ())))
        lag = ET.Element("lag_filter", name=f"fcs/{OURS}/{state}")
        lag.extend([node("input", f"fcs/{OURS}/{state}-input"), node("c1", repr(1.0 / seconds))])
        filters += [function, lag]
        known[state] = prop(f"fcs/{OURS}/{state}")
    return filters
