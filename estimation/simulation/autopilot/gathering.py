"""All that a simulator needs of an aircraft, from a model file and an aircraft file; missing values are listed, not invented."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from daq.utilities.input_files import parse_toml, read_text
from estimation.aircraft import Aircraft, built_in_aircraft, load_aircraft, unknown_aircraft
from estimation.errors import EstimationError
from estimation.models.base import Model
from estimation.models.load import read_model
from estimation.simulation.autopilot.linear import CONSTANT, LINES, POLAR, SLOPES, LinearAircraft
from estimation.simulation.autopilot.slopes import beyond_coefficients, derivatives_of, lines_of
from estimation.simulation.oracle import SURFACES, SimulationError

NEEDED: Mapping[str, tuple[str, ...]] = {
    "CL": ("CL_0", "CL_alpha"), "CD": ("CD_0", "CD_k"), "CY": ("CY_beta",), "Cl": ("Cl_beta", "Cl_p", "Cl_da"),
    "Cm": ("Cm_0", "Cm_alpha", "Cm_q", "Cm_de"), "Cn": ("Cn_beta", "Cn_r", "Cn_dr"),
}  # fmt: skip
"""Coefficient -> derivatives that an aircraft file must state: without these the aircraft does not trim, damp or steer."""
MINOR: Mapping[str, tuple[str, ...]] = {
    "CL": ("CL_q", "CL_de"), "CD": (), "CY": ("CY_0", "CY_p", "CY_r", "CY_da", "CY_dr"), "Cm": (),
    "Cl": ("Cl_0", "Cl_r", "Cl_dr"), "Cn": ("Cn_0", "Cn_p", "Cn_da"),
}  # fmt: skip
"""Coefficient -> derivatives that an aircraft file may leave out; they are zero then, and a note says so."""
STANDARD = frozenset(f"{line}_{ending}" for line in LINES for ending in (CONSTANT, *SLOPES)) | {POLAR}
BODY = ("m", "S", "b", "c", "Ixx", "Iyy", "Izz", "Ixz")
FIELDS = ("mass", "area", "span", "chord", "Ixx", "Iyy", "Izz", "Ixz")
KEYS = ("mass.mass", "geometry.area", "geometry.span", "geometry.chord", "mass.Ixx", "mass.Iyy", "mass.Izz", "mass.Ixz")


class MissingPartsError(EstimationError):
    """Values that a simulator needs of an aircraft are not stated."""


@dataclass(frozen=True)
class Stated:
    """Values stated beside the file. aircraft: an aircraft file or a built-in name; throws: surface -> least and greatest
    deflection [rad]; thrust: static [N]."""

    aircraft: str | None = None
    throws: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    thrust: float | None = None


@dataclass(frozen=True)
class Gathered:
    """linear: the linear aircraft. beyond: terms of the model outside its coefficients, as (name, size)."""

    linear: LinearAircraft
    beyond: tuple[tuple[str, float], ...]


def source_of(path: Path) -> Model | Aircraft:
    """The model or aircraft in a file, or the built-in aircraft of that name. Raises ModelError or AircraftError."""
    if str(path) in built_in_aircraft():
        return load_aircraft(str(path))
    tables = parse_toml(read_text(path), str(path), EstimationError)
    if {"geometry", "mass", "derivatives"} & set(tables) and "equations" not in tables:
        return load_aircraft(path)
    return read_model(path)


def model_and_body(path: Path, stated: Stated) -> tuple[Model | None, Aircraft | None, Aircraft]:
    """(model, None where the file is an aircraft's; aircraft that is stated, None where there is none; body: geometry, mass and
    inertia). Raises EstimationError where an aircraft is stated beside an aircraft file."""
    source = source_of(path)
    if isinstance(source, Aircraft):
        if stated.aircraft is not None:
            raise EstimationError(f"{path}: is an aircraft file itself; leave --aircraft {stated.aircraft} away")
        return None, source, source
    stated_aircraft = load_aircraft(stated.aircraft) if stated.aircraft else None
    return source, stated_aircraft, body_of(source, stated_aircraft)


def missing_body_keys(body: Aircraft) -> list[str]:
    """Keys of an aircraft file for the geometry, mass and inertia that a body lacks."""
    return [key for key, name in zip(KEYS, FIELDS, strict=True) if math.isnan(getattr(body, name))]


def gather_aircraft(path: Path, stated: Stated, target: str, *, needs_thrust: bool) -> Gathered:
    """The linear aircraft of a model or aircraft file. target: name of the simulator. Raises MissingPartsError with the list of
    what is missing, SimulationError for a model that is not linear."""
    model, stated_aircraft, body = model_and_body(path, stated)
    missing = missing_body_keys(body)
    frame = LinearAircraft(body.name, body.title or body.name, body, {})
    lines = () if model is None else lines_named(path, model)
    derivatives, sources = {}, {}
    if model is not None and not missing:
        derivatives = derivatives_of(model, frame)
        sources = dict.fromkeys(derivatives, f"model {model.name}")
    notes = _add_beliefs(stated_aircraft, [c for c in LINES if c not in lines], derivatives, sources, missing)
    throws = _throws(stated_aircraft, stated, missing)
    thrust = static_thrust(stated_aircraft, stated)
    if thrust is None and needs_thrust:
        missing.append("static thrust ([engine] static_thrust, or --thrust; 0 for a glider)")
    if missing:
        raise MissingPartsError(missing_parts_message(path, target, missing, stated_aircraft))
    linear = replace(frame, derivatives=derivatives, sources=sources, throws=throws, thrust=thrust, notes=tuple(notes))
    if model is not None:
        return Gathered(linear, _beyond_coefficients(model, linear))
    beliefs = {} if stated_aircraft is None else stated_aircraft.derivatives
    return Gathered(linear, tuple((n, d.value) for n, d in beliefs.items() if n not in STANDARD))


def lines_named(path: Path, model: Model) -> tuple[str, ...]:
    """Names of the coefficients for which a model has lines. Raises SimulationError where it has none."""
    lines = tuple(lines_of(model))
    if not lines:
        raise SimulationError(
            f"{path}: has none of the lines {', '.join(LINES)} (or CX, CZ) by whose names coefficients are known; add them to its"
            " equations, non-dimensional and about the centre of gravity"
        )
    return lines


def body_of(model: Model, stated_aircraft: Aircraft | None) -> Aircraft:
    """Geometry, mass and inertia: the model's own numbers, else those of the aircraft file."""
    numbers = {**model.constants, **model.starts()}
    frame = stated_aircraft or unknown_aircraft(model.name)
    model_values = {f: float(numbers[n]) for n, f in zip(BODY, FIELDS, strict=True) if n in numbers}
    if math.isnan(frame.Ixz) and "Ixz" not in model_values and not math.isnan(model_values.get("Ixx", math.nan)):
        model_values["Ixz"] = 0.0  # as in an aircraft file that does not state it
    return replace(frame.with_values(**model_values), name=model.name, title=model.title)


def _add_beliefs(
    stated_aircraft: Aircraft | None,
    lines: list[str],
    derivatives: dict[str, float],
    sources: dict[str, str],
    missing: list[str],
) -> list[str]:
    """Add derivatives of coefficients without a line in the model from the beliefs of the aircraft file; returns notes on what
    was taken or assumed zero."""
    beliefs = stated_aircraft.derivatives if stated_aircraft is not None else {}
    missing_beliefs = [n for line in lines for n in NEEDED[line] if n not in beliefs]
    missing += missing_beliefs
    for name, belief in beliefs.items():
        if name.split("_")[0] in lines and name in STANDARD:
            derivatives[name], sources[name] = belief.value, belief.source
    if missing_beliefs:
        return []
    believed_names = [n for n in derivatives if n.split("_")[0] in lines]
    zero = [n for line in lines for n in MINOR[line] if n not in beliefs]
    notes = []
    if believed_names and len(lines) < len(LINES):
        belief_list = ", ".join(f"{n} = {derivatives[n]:.4g} ({sources[n]})" for n in believed_names)
        notes.append(f"not in the model, from the aircraft file: {belief_list}")
    if zero:
        notes.append(f"not stated, so zero: {', '.join(zero)}")
    return notes


def _throws(stated_aircraft: Aircraft | None, stated: Stated, missing: list[str]) -> dict[str, tuple[float, float]]:
    throws = {
        **_servo_limits(stated_aircraft),
        **(stated_aircraft.throws if stated_aircraft is not None else {}),
        **stated.throws,
    }
    missing_throws = [n for n in SURFACES if n not in throws]
    if missing_throws:
        missing.append(f"throws of {', '.join(missing_throws)} ([throws], or --throw {missing_throws[0]}=25deg)")
    return throws


def _servo_limits(stated_aircraft: Aircraft | None) -> dict[str, tuple[float, float]]:
    if stated_aircraft is None or stated_aircraft.servos is None:
        return {}
    elevon, rudder = stated_aircraft.servos.elevon_limit, stated_aircraft.servos.rudder_limit
    return {"delta_e": (-elevon, elevon), "delta_a": (-elevon, elevon), "delta_r": (-rudder, rudder)}


def static_thrust(stated_aircraft: Aircraft | None, stated: Stated) -> float | None:
    """Static thrust [N]: as stated, else of the aircraft's engine; None where neither is known."""
    if stated.thrust is not None or stated_aircraft is None or stated_aircraft.engine is None:
        return stated.thrust
    return stated_aircraft.engine.static_thrust


def missing_parts_message(path: Path, target: str, missing: list[str], stated_aircraft: Aircraft | None) -> str:
    """What a target needs and is not stated, and where to state it."""
    place = "its file" if stated_aircraft is not None else "an aircraft file and give it with --aircraft FILE"
    return (
        f"{path}: {target} needs values that are not stated: {', '.join(missing)}; state them in {place}"
        " (docs/aircraft.md), a derivative as 0 where the aircraft has none"
    )


def _beyond_coefficients(model: Model, linear: LinearAircraft) -> tuple[tuple[str, float], ...]:
    """Terms of a model outside its coefficients, as (name, size)."""
    try:
        accelerations = beyond_coefficients(model, linear)
    except SimulationError as error:
        raise SimulationError(f"{error}, and no simulator of an autopilot has that") from error
    beyond_terms = [(f"{line} beyond coefficients", share) for line, share in accelerations.items()]
    numbers = model.starts()
    beyond_terms += [(f"{t.kind} of {t.input}", numbers.get(t.parameters[0], math.nan)) for t in model.transforms]
    return tuple(beyond_terms)


def symmetric_throws(linear: LinearAircraft, target: str) -> dict[str, float]:
    """Surface -> throw [rad]. Raises SimulationError for a throw that differs in the two directions."""
    for name, (lowest, greatest) in linear.throws.items():
        if not math.isclose(-lowest, greatest, rel_tol=1e-6):
            raise SimulationError(
                f"{linear.name}: {name} goes from {math.degrees(lowest):.3g} to {math.degrees(greatest):.3g} deg, and in {target}"
                " a throw is the same both ways; limit it in the autopilot to the smaller one and state that,"
                f" --throw {name}={min(-lowest, greatest):.4g}"
            )
    return {name: greatest for name, (_, greatest) in linear.throws.items()}
