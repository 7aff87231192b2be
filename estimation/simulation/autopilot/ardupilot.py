"""A linear aircraft as a file of ArduPilot's SITL model `plane`. SITL flies 2 kg and 1 kg m2, so the coefficients absorb mass and
inertia and give the real accelerations.

With k = 2 kg / m the area is k S; rolling and yawing moments are solved for angular accelerations with Ixz. Forces in SITL's own
log are then k times the real ones.
"""

import json
import math
import re
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from daq.utilities.input_files import DEEPEST, LARGEST_TEXT, read_bytes
from estimation.simulation.autopilot.equations import BUILT_IN, CLAMP, FULL, MASS, OFFSET, SitlPlane
from estimation.simulation.autopilot.gathering import symmetric_throws
from estimation.simulation.autopilot.linear import LINES, SLOPES, LinearAircraft
from estimation.simulation.oracle import SimulationError

OPTIONS = (
    "-heavy", "-jet", "-revthrust", "-elevon", "-vtail", "-dspoilers", "-redundant", "-elevrev", "-catapult", "-bungee", "-throw",
    "-tailsitter", "-steering", "-3d", "-ice", "-soaring",
)  # fmt: skip
"""Options that SITL recognises anywhere in the name of a model, files and folders included."""
HAS_KEY = {
    "CL": ("0", "alpha", "q", "de"), "CD": ("0", "q"), "CY": ("0", "beta", "p", "r", "da", "dr"),
    "Cl": ("0", "beta", "p", "r", "da", "dr"), "Cm": ("0", "alpha", "q", "de"), "Cn": ("0", "beta", "p", "r", "da", "dr"),
}  # fmt: skip
"""Endings of the derivatives for which a file has keys."""
INDUCED = ("0", "alpha")
"""Endings of the terms of lift in its induced drag."""
STALL = 0.55  # rad, where none is stated: as late as possible without clamping alpha above -0.2 rad
LEAST_STALL, MOST_STALL = 0.35, 0.6  # rad: outside, the blend or the clamp changes lift where the aircraft flies
SHARPEST = 50.0  # 1/rad, SITL's default
LARGEST_EXPONENT = 85.0  # of the blend, in SITL's floats
CLEAR = 0.33  # rad below the stall where the blend is less than 1e-6 of lift
FULL_THROTTLE = 14.0  # m/s2, SITL's thrust over mass at full throttle: g / 0.7
NO_POLAR = 1e12  # oswald without induced drag


def sitl_values(linear: LinearAircraft, stall: float | None) -> dict[str, float]:
    """Key -> value of a file. stall: angle of attack [rad] or None. Raises SimulationError for throws that are not symmetric."""
    a, throw = linear.aircraft, symmetric_throws(linear, "ArduPilot's SITL")
    share = MASS / a.mass
    inertia = a.Ixx * a.Izz - a.Ixz**2
    stall_angle = STALL if stall is None else stall
    oswald = share * a.area / (math.pi * a.span**2 * linear["CD_k"]) if linear["CD_k"] else NO_POLAR
    lift = {"c_lift_0": linear["CL_0"], "c_lift_deltae": -linear["CL_de"] * throw["delta_e"],
            "c_lift_a": linear["CL_alpha"], "c_lift_q": linear["CL_q"]}  # fmt: skip
    drag = {"c_drag_q": linear["CD_q"], "c_drag_deltae": 0.0, "c_drag_p": linear["CD_0"]}
    scale = {"0": 1.0, "b": 1.0, "p": 1.0, "r": 1.0, "deltaa": -throw["delta_a"], "deltar": -throw["delta_r"]}
    ending_by_key = {"0": "0", "b": "beta", "p": "p", "r": "r", "deltaa": "da", "deltar": "dr"}
    side, roll, yaw = {}, {}, {}
    for key, ending in ending_by_key.items():
        CY, Cl, Cn = (linear[f"{c}_{ending}"] for c in ("CY", "Cl", "Cn"))
        side[f"c_y_{key}"] = CY * scale[key]
        roll[f"c_l_{key}"] = (a.Izz * Cl + a.Ixz * Cn) / (share * inertia) * scale[key]
        yaw[f"c_n_{key}"] = (a.Ixx * Cn + a.Ixz * Cl) / (share * inertia) * scale[key]
    pitch_values = {"c_m_0": linear["Cm_0"], "c_m_a": linear["Cm_alpha"], "c_m_q": linear["Cm_q"],
           "c_m_deltae": -linear["Cm_de"] * throw["delta_e"]}  # fmt: skip
    pitch = {key: value / (share * a.Iyy) for key, value in pitch_values.items()}
    sharpness = min(SHARPEST, LARGEST_EXPONENT / (2.0 * stall_angle + CLAMP))
    return {
        "s": share * a.area, "b": a.span, "c": a.chord, **lift, "mcoeff": sharpness, "oswald": oswald,
        "alpha_stall": stall_angle, **drag, **side, **roll, **pitch, **yaw,
        "deltaa_max": throw["delta_a"], "deltae_max": throw["delta_e"], "deltar_max": throw["delta_r"],
    }  # fmt: skip


def left_out(linear: LinearAircraft) -> tuple[str, ...]:
    """Names of the non-zero derivatives without a key."""
    return tuple(f"{c}_{e}" for c in LINES for e in ("0", *SLOPES) if e not in HAS_KEY[c] and linear[f"{c}_{e}"] != 0.0)


def check_stall(stall: float | None) -> None:
    """Raise SimulationError for a stall that SITL's lift cannot have."""
    if stall is not None and not LEAST_STALL <= stall <= MOST_STALL:
        raise SimulationError(
            f"--alpha-stall {stall:g}: SITL's lift needs {LEAST_STALL} to {MOST_STALL} rad (20 to 34 deg): its blend begins"
            " 0.14 rad earlier, and it holds angles of attack that are more than 0.8 rad from it"
        )


def check_name(path: Path) -> None:
    """Raise SimulationError for a name that SITL would not load, or in which it would recognise an option."""
    if path.suffix != ".json":
        raise SimulationError(
            f"{path}: SITL flies its built-in aircraft unless the name ends in .json; give such a name"
        )
    given_name = f"{path.parent.name}/{path.name}" if path.is_absolute() else str(path)
    options_in_name = [option for option in OPTIONS if option in given_name]
    if options_in_name:
        raise SimulationError(
            f"{path}: SITL would read the option {options_in_name[0]} in this name and fly another aircraft; give a"
            " name without it"
        )
    if any(mark in path.name for mark in "'\"\\ \t\n"):
        raise SimulationError(f"{path}: SITL's scripts take such a name apart; leave out blanks and quotes")


def command_lines(path: Path, thrust: float | None, mass: float) -> list[str]:
    """How to fly the file with SITL, which takes its path relative to the working directory. thrust [N] or None; mass [kg]."""
    lines = []
    folder = path.resolve().parent
    lines.append(f"fly it: cd {shlex.quote(str(folder))} && sim_vehicle.py -v Plane --model plane:{path.name}"
                 " --custom-location=-35.363261,149.165230,0,353 --add-param-file=YOURS.parm")  # fmt: skip
    lines.append(
        f"or: arduplane --model plane:{path.name} --home -35.363261,149.165230,0,353 --defaults plane.parm,YOURS.parm"
    )
    lines.append("  SITL says 'Loaded plane aero coefficients from' on its console; without that line it flies its own aircraft"
                 " (it needs ArduPilot of 22 Apr 2025 or later)")  # fmt: skip
    lines.append(
        "  home at height 0, for SITL takes equivalent airspeed for true; YOURS.parm: the real aircraft's parameters"
    )
    if thrust is None:
        lines.append(f"  thrust: not stated, so SITL has its own, {FULL_THROTTLE * mass:.3g} N for {mass:g} kg at"
                     " full throttle; --thrust N says how to limit it")  # fmt: skip
    else:
        share = thrust / (FULL_THROTTLE * mass)
        throttle_advice = (f"limit the throttle to {share:.3f} of its range (THR_MAX {100.0 * share:.0f})" if share <= 1.0
                else f"more than SITL has at any throttle ({FULL_THROTTLE * mass:.3g} N); it will fly weaker")  # fmt: skip
        lines.append(f"  thrust {thrust:g} N of {mass:g} kg: {throttle_advice}")
    return lines


def comments(linear: LinearAircraft, origin: str, omitted: list[tuple[str, float]], stall: float | None) -> list[str]:
    """The comments above the object: real values, signs, omitted terms as (name, value)."""
    a = linear.aircraft
    units = {"mass": "kg", "area": "m2", "span": "m", "chord": "m"}
    real = [f"real {n} = {getattr(a, n)!r} {units.get(n, 'kg m2')}" for n in
            ("mass", "area", "span", "chord", "Ixx", "Iyy", "Izz", "Ixz")]  # fmt: skip
    values = [
        f"real {n} = {linear[n]!r}" + (f" ({linear.sources[n]})" if n in linear.sources else "") for n in linear.stated
    ]
    throws = [f"real throw {n} = {high!r} rad" for n, (_, high) in linear.throws.items()]
    note = "the stall is not stated, so it is as late as SITL allows" if stall is None else "stall as stated"
    return [
        f"ArduPilot SITL, model plane: {linear.title}, from {origin}, written by sideslip export --to ardupilot",
        "Mass and inertia are absorbed: SITL flies 2 kg and 1 kg m2, the keys below make the real accelerations with these.",
        "Do not add aero_moment_inertia (it would divide twice). Coefficients per full throw; + is right, nose up, nose right.",
        *real, *throws, "Derivatives per rad, + trailing edge down (right minus left) or to port, rates as pb/2V, qc/2V, rb/2V:",
        *values, *(f"left out: {n} ({v:.4g})" for n, v in omitted), f"alpha_stall: {note}",
        *linear.notes,
    ]  # fmt: skip


# The coefficient file of ArduPilot's SITL model `plane`: written with the real values as comments, and read within limits.
#
# SITL reads the JSON between the first `{` and the last `}` of a file, in which `#` begins a comment. A brace in a comment before
# the object would stop it, so our comments have none.

FLOAT_EXPONENT = 88.0  # a larger exponent makes a float infinite; SITL's own file has 87
UNUSED = ("aero_moment_inertia",)  # not read by ArduPilot before pull 34011
MULTICOPTER = ("mass", "moment_inertia")  # of a quadplane's frame, in the same file
ABOVE_ZERO = ("s", "b", "c", "mcoeff", *FULL.values())
REAL = ("mass", "area", "span", "chord", "Ixx", "Iyy", "Izz", "Ixz")
_REAL_LINE = re.compile(r"^# real (\w+) = (\S+)", re.MULTILINE)
NUMBER_LIMIT = 1e9  # magnitude of a coefficient: more is a mistake
SIZES = (1e-6, 1e6)  # least and greatest area, length, sharpness or throw
MOST_SHOWN = 40  # characters of a value in a message


def file_text(values: Mapping[str, float], comments: Sequence[str]) -> str:
    """The text of a file: comments above, one key a line; CGOffset at the centre of gravity."""
    safe_comments = [re.sub(r"[{}\r\n]", " ", line).strip() for line in comments]
    rows = [f'    "{key}": {_number(value)}' for key, value in values.items()]
    rows.append('    "CGOffset": [0.0, 0.0, 0.0]')
    return "\n".join([*(f"# {line}".rstrip() for line in safe_comments), "{", ",\n".join(rows), "}", ""])


def _number(value: float) -> str:
    if not math.isfinite(value):
        raise SimulationError(f"{value} is no coefficient that SITL can fly with")
    return repr(float(value))


def read_sitl_plane(path: Path) -> SitlPlane:
    """A file as SITL reads it. Raises SimulationError where SITL would stop, or where the file is beyond our limits."""
    text = read_bytes(path, "file of coefficients", SimulationError, LARGEST_TEXT).decode("utf-8", errors="replace")
    content = _object(text, path)
    unknown = [k for k in content if k not in BUILT_IN and k not in (*UNUSED, *MULTICOPTER, "CGOffset")]
    notes = [] if not unknown else [f"{path.name}: SITL does not read {', '.join(map(_short, unknown))}"]
    file_values = {k: _value(k, content[k], path) for k in BUILT_IN if k in content}
    absent = [k for k in BUILT_IN if k not in content]
    if len(absent) == len(BUILT_IN):
        raise SimulationError(
            f"{path}: has none of the keys of SITL's plane (s, b, c, c_lift_a, ...); is it another file?"
        )
    throws = [k for k in FULL.values() if k in absent]
    absent_coefficients = [k for k in absent if k not in throws]
    if absent_coefficients:
        notes.append(f"{path.name} does not say {', '.join(absent_coefficients)}: SITL's own values stand")
    if throws:
        notes.append(
            f"{path.name} does not say {', '.join(throws)}: throws of 20 deg are taken, as SITL's own file says"
        )
    offset = _offset(content.get("CGOffset"), path)
    plane = SitlPlane({**BUILT_IN, **file_values}, offset, _real(text), tuple(notes))
    k = plane.values
    if abs(k["oswald"]) < SIZES[0]:
        raise SimulationError(f"{path}: oswald is {k['oswald']:g}, by which SITL divides; give a number")
    exponent = k["mcoeff"] * (2.0 * abs(k["alpha_stall"]) + CLAMP)
    if exponent > FLOAT_EXPONENT:
        raise SimulationError(
            f"{path}: mcoeff {k['mcoeff']:g} with alpha_stall {k['alpha_stall']:g} is beyond a float in SITL's blend (exp of"
            f" {exponent:.0f}); give a smaller mcoeff"
        )
    return plane


def _object(text: str, path: Path) -> dict[str, Any]:
    """The JSON object in a file's text. Raises SimulationError where there is none, or it is nested too deeply."""
    first, last = text.find("{"), text.rfind("}")
    if first < 0 or last < first:
        raise SimulationError(f"{path}: no JSON object between braces; SITL's plane is described by one")
    body = re.sub(r"#[^\n]*", "", text[first : last + 1])
    depth = deepest = 0
    for mark in re.findall(r"[\[\]{}]", body):
        depth += 1 if mark in "[{" else -1
        deepest = max(deepest, depth)
    if deepest > DEEPEST:
        raise SimulationError(
            f"{path}: nested {deepest} deep, at most {DEEPEST} are read; SITL's keys stand side by side"
        )
    try:
        content = json.loads(body, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise SimulationError(f"{path}: no JSON, and SITL would stop here ({error}); correct it") from error
    assert isinstance(content, dict)
    return content


def _refuse_constant(word: str) -> float:
    raise ValueError(f"{word} is no number")


def _value(key: str, value: Any, path: Path) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < NUMBER_LIMIT:
        raise SimulationError(f"{path}: {key} is {_short(value)}, and SITL stops at anything but a number; correct it")
    if key in ABOVE_ZERO and not SIZES[0] <= value <= SIZES[1]:
        raise SimulationError(f"{path}: {key} is {value:g}; give a number above zero, {SIZES[1]:g} at most")
    return float(value)


def _offset(value: Any, path: Path) -> tuple[float, float, float]:
    if value is None:
        return OFFSET
    if not isinstance(value, list) or len(value) != len(OFFSET):
        raise SimulationError(f"{path}: CGOffset is {_short(value)}, and SITL stops at anything but three numbers")
    x, y, z = (_value("CGOffset", v, path) for v in value)
    return x, y, z


def _real(text: str) -> dict[str, float]:
    """Mass, geometry and inertia of the real aircraft from comments that we wrote; empty unless all are there."""
    real_values: dict[str, float] = {}
    for name, number in _REAL_LINE.findall(text):
        try:
            real_values[name] = float(number)
        except ValueError:
            continue
    above_zero = all(0.0 < real_values.get(n, math.nan) < NUMBER_LIMIT for n in REAL if n != "Ixz")
    possible = above_zero and real_values.get("Ixz", math.nan) ** 2 < real_values["Ixx"] * real_values["Izz"]
    return {n: real_values[n] for n in REAL} if possible else {}


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= MOST_SHOWN else f"{text[: MOST_SHOWN - 3]}..."
