"""`sideslip export --to ardupilot|gazebo|neutral`: what is asked on the command line, and what a person reads."""

import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from estimation.errors import EstimationError

if TYPE_CHECKING:
    from estimation.simulation.autopilot.writing import ExportedSimulator

TARGETS = ("ardupilot", "gazebo", "neutral")
SURFACES = ("delta_e", "delta_a", "delta_r")
_ANGLE = re.compile(r"\s*([+-]?[0-9.]+(?:e[+-]?[0-9]+)?)\s*(deg|rad|)\s*\Z", re.IGNORECASE)
MOST = math.pi  # rad of deflection


def throws_of(words: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Surface -> least and greatest deflection [rad], of `delta_e=25deg` or `delta_e=-25deg:20deg`. Raises EstimationError."""
    throws = {}
    for word in words:
        name, sign, text = word.partition("=")
        ends = [_radians(part) for part in text.split(":")]
        if name not in SURFACES or not sign or len(ends) > 2 or None in ends:
            raise EstimationError(
                f"--throw {word}: write delta_e=25deg (delta_a, delta_r; rad without deg), or delta_e=-25deg:20deg where both"
                " ways differ"
            )
        angles = [a for a in ends if a is not None]
        low, high = (-angles[0], angles[0]) if len(angles) == 1 else angles
        if not -MOST <= low < 0.0 < high <= MOST:
            raise EstimationError(f"--throw {word}: a surface goes from below zero to above, 180 deg at most")
        throws[name] = (low, high)
    return throws


def _radians(text: str) -> float | None:
    found = _ANGLE.match(text)
    try:
        value = float(found[1]) if found else math.nan
    except ValueError:
        return None
    if not math.isfinite(value) or found is None:
        return None
    return math.radians(value) if found[2].lower() == "deg" else value


def to_simulator(
    target: str,
    file: Path,
    out: Path,
    *,
    aircraft: str | None,
    throws: Sequence[str],
    thrust: float | None,
    stall: float | None,
    force: bool,
    prove: bool,
    json_path: Path | None,
) -> int:
    """Write and prove; 1 where what was written is not the model."""
    from daq.contract.outputs import write_json
    from estimation.simulation.autopilot import writing
    from estimation.simulation.autopilot.gathering import Stated

    for option, number in (("--thrust", thrust), ("--alpha-stall", stall)):
        if number is not None and not (math.isfinite(number) and number >= 0.0):
            raise EstimationError(f"{option} {number:g}: give a number, zero or above")
    does: dict[str, Callable[..., ExportedSimulator]] = {
        "ardupilot": writing.to_ardupilot,
        "gazebo": writing.to_gazebo,
        "neutral": writing.to_neutral,
    }
    request = writing.Request(Stated(aircraft, throws_of(throws), thrust), stall, force, prove)
    done = does[target](file, out, request)
    for line in report_lines(done):
        click.echo(line)
    if json_path is not None:
        write_json(json_of(target, file, done), json_path)
    return 1 if done.proof.failed else 0


def report_lines(done: "ExportedSimulator") -> list[str]:
    """What a person reads."""
    proof = done.proof
    lines = [f"{f}: written" for f in done.files]
    lines.append(f"  {'axis':<8}{'deviation':>11}{'allowed':>11}")
    lines += [f"  {axis:<8}{value:>11.2g}{proof.limit:>11.2g}" for axis, value in proof.deviation.items()]
    lines += [f"  left out: {term.sentence()}" for term in proof.left_out]
    lines.append(proof.sentence())
    return [*lines, *done.lines]


def json_of(target: str, file: Path, done: "ExportedSimulator") -> dict[str, Any]:
    """What `--json` writes."""
    return {
        "version": 1, "from": str(file), "to": target, "files": [str(f) for f in done.files], "proof": done.proof.to_json(),
        "notes": list(done.lines),
    }  # fmt: skip
