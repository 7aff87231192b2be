"""The coefficient file of ArduPilot's SITL model `plane`: written with the real values as comments, and read within bounds.

SITL takes JSON between the first `{` and the last `}` of a file, in which `#` begins a comment. A brace in a comment before the
object makes it stop, so that ours have none.
"""

import json
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from daq.contract.input_files import DEEPEST, LARGEST_TEXT, read_bytes
from estimation.simulation.autopilot.ardupilot_equations import BUILT_IN, CLAMP, FULL, OFFSET, SitlPlane
from estimation.simulation.oracle import SimulationError

FLOAT_EXPONENT = 88.0  # beyond it a float is infinite; SITL's own file has 87
UNUSED = ("aero_moment_inertia",)  # read by nobody before ArduPilot's pull 34011
MULTICOPTER = ("mass", "moment_inertia")  # of a quadplane's frame, in the same file
ABOVE_ZERO = ("s", "b", "c", "mcoeff", *FULL.values())
REAL = ("mass", "area", "span", "chord", "Ixx", "Iyy", "Izz", "Ixz")
_REAL_LINE = re.compile(r"^# real (\w+) = (\S+)", re.MULTILINE)
NUMBER_LIMIT = 1e9  # of a coefficient: SITL reads floats, and one beyond is a mistake
SIZES = (1e-6, 1e6)  # of an area, length, sharpness or throw


def file_text(values: Mapping[str, float], comments: Sequence[str]) -> str:
    """The text of a file: comments above, one key a line; CGOffset at the centre of gravity."""
    plain = [re.sub(r"[{}\r\n]", " ", line).strip() for line in comments]
    rows = [f'    "{key}": {_number(value)}' for key, value in values.items()]
    rows.append('    "CGOffset": [0.0, 0.0, 0.0]')
    return "\n".join([*(f"# {line}".rstrip() for line in plain), "{", ",\n".join(rows), "}", ""])


def _number(value: float) -> str:
    if not math.isfinite(value):
        raise SimulationError(f"{value} is no coefficient that SITL can fly with")
    return repr(float(value))


def read_sitl_plane(path: Path) -> SitlPlane:
    """A file as SITL takes it. Raises SimulationError where SITL would stop, or where it is longer or deeper than is read."""
    text = read_bytes(path, "file of coefficients", SimulationError, LARGEST_TEXT).decode("utf-8", errors="replace")
    content = _object(text, path)
    unknown = [k for k in content if k not in BUILT_IN and k not in (*UNUSED, *MULTICOPTER, "CGOffset")]
    notes = [] if not unknown else [f"{path.name}: SITL does not read {', '.join(map(_short, unknown))}"]
    given = {k: _value(k, content[k], path) for k in BUILT_IN if k in content}
    absent = [k for k in BUILT_IN if k not in content]
    if len(absent) == len(BUILT_IN):
        raise SimulationError(
            f"{path}: has none of the keys of SITL's plane (s, b, c, c_lift_a, ...); is it another file?"
        )
    throws = [k for k in FULL.values() if k in absent]
    others = [k for k in absent if k not in throws]
    if others:
        notes.append(f"{path.name} does not say {', '.join(others)}: SITL's own values stand")
    if throws:
        notes.append(
            f"{path.name} does not say {', '.join(throws)}: throws of 20 deg are taken, as SITL's own file says"
        )
    offset = _offset(content.get("CGOffset"), path)
    plane = SitlPlane({**BUILT_IN, **given}, offset, _real(text), tuple(notes))
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
        content = json.loads(body, parse_constant=_refused)
    except (ValueError, RecursionError) as error:
        raise SimulationError(f"{path}: no JSON, and SITL would stop here ({error}); correct it") from error
    assert isinstance(content, dict)
    return content


def _refused(word: str) -> float:
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
    """Mass, geometry and inertia of the real aircraft, of comments that we wrote; nothing where they are not all there."""
    found: dict[str, float] = {}
    for name, number in _REAL_LINE.findall(text):
        try:
            found[name] = float(number)
        except ValueError:
            continue
    above_zero = all(0.0 < found.get(n, math.nan) < NUMBER_LIMIT for n in REAL if n != "Ixz")
    possible = above_zero and found.get("Ixz", math.nan) ** 2 < found["Ixx"] * found["Izz"]
    return {n: found[n] for n in REAL} if possible else {}


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
