"""Flights, recordings and models for other programs: the functions behind `export` and `ss.export`."""

import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from estimation.answers.files import FileAnswer
from estimation.errors import EstimationError

if TYPE_CHECKING:
    from estimation.simulation.autopilot.writing import ExportedSimulator

SIMULATORS = ("ardupilot", "gazebo", "neutral")
TARGETS = (*SIMULATORS, "jsbsim", "model")
_MODELS = (".toml", ".json")
_JSBSIM = "jsbsim:"
JSBSIM_RATE = 120.0  # Hz, JSBSim's default
SURFACES = ("delta_e", "delta_a", "delta_r")
_ANGLE = re.compile(r"\s*([+-]?[0-9.]+(?:e[+-]?[0-9]+)?)\s*(deg|rad|)\s*\Z", re.IGNORECASE)
LARGEST_DEFLECTION = math.pi  # rad


def _throws_of(words: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Surface -> smallest and largest deflection [rad], from `delta_e=25deg` or `delta_e=-25deg:20deg`. Raises
    EstimationError."""
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
        if not -LARGEST_DEFLECTION <= low < 0.0 < high <= LARGEST_DEFLECTION:
            raise EstimationError(f"--throw {word}: a surface goes from below zero to above, 180 deg at most")
        throws[name] = (low, high)
    return throws


def _radians(text: str) -> float | None:
    """An angle [rad] from `25deg`, `0.4rad` or `0.4`; None where the text is none."""
    match = _ANGLE.match(text)
    try:
        value = float(match[1]) if match else math.nan
    except ValueError:
        return None
    if not math.isfinite(value) or match is None:
        return None
    return math.radians(value) if match[2].lower() == "deg" else value


def export(
    file: str | Path,
    output: str | Path | None = None,
    *,
    target: str | None = None,
    out: str | Path | None = None,
    aircraft_from: str | None = None,
    rate: float = JSBSIM_RATE,
    aircraft: str | None = None,
    throws: Sequence[str] = (),
    thrust: float | None = None,
    alpha_stall: float | None = None,
    force: bool = False,
    prove: bool = False,
    units_row: bool = False,
    raw: bool = False,
    calibration: str | Path | None = None,
) -> FileAnswer:
    """Write a flight, recording or model for another program.

    Args:
        file: the flight, recording or model.
        output: its ending chooses the format; of target gazebo a folder.
        target: as `--to`: ardupilot, gazebo, neutral, jsbsim or model.
        out: of target jsbsim: the folder to write into.
        aircraft_from: of target jsbsim: the aircraft on which the model was estimated.
        rate: of target jsbsim: its integration steps a second [Hz].
        aircraft: file with values that the model lacks: derivatives, throws, thrust.
        throws: deflections at full stick, texts like delta_e=25deg.
        thrust: static [N]; 0 for a glider.
        alpha_stall: angle of attack of the stall [rad].
        force: replace files that exist.
        prove: write nothing, compare the existing output with the file.
        units_row: of a CSV: a second line with the units.
        raw: of a recording: counts, not calibrated columns.
        calibration: directory in place of the embedded set.

    Raises:
        UserError: one sentence, for a file that cannot be written.

    `passed` is False where the written file does not reproduce the model.

    Example::

        ss.export("ld4.mcap", "ld4.parquet")
    """
    if target in SIMULATORS:
        if output is None or out is not None or aircraft_from is not None:
            raise EstimationError(f"--to {target} writes one place: give -o, neither --out nor --aircraft-from")
        return _to_simulator(str(target), Path(file), Path(output), aircraft, throws, thrust, alpha_stall, force, prove)
    if aircraft or throws or thrust is not None or alpha_stall is not None or force or prove:
        raise EstimationError(
            "--aircraft, --throw, --thrust, --alpha-stall, --force and --prove belong to --to ardupilot, gazebo, neutral"
        )
    output, out = (None if path is None else Path(path) for path in (output, out))
    if target == "model" or (target is None and str(file).startswith(_JSBSIM)):
        return _from_jsbsim(str(file), output, out)
    if target == "jsbsim":
        return _to_jsbsim(Path(file), output, out, aircraft_from, rate)
    if target is not None:
        raise EstimationError(f"--to {target}: give one of {', '.join(TARGETS)}")
    if out is not None or aircraft_from is not None:
        raise EstimationError("--out and --aircraft-from belong to --to jsbsim")
    if output is None:
        raise EstimationError("export: give the file to write: -o OUTPUT, whose ending chooses the format")
    if Path(file).suffix.lower() in _MODELS:
        return _model_table(Path(file), output)
    from groundstation.export.run import export_file

    folder = None if calibration is None else Path(calibration)
    exported = export_file(Path(file), output, units_row=units_row, raw=raw, calibration=folder)
    return _file_answer(file, output.suffix[1:], [exported.path], notes=exported.notes)


def _model_table(file: Path, output: Path) -> FileAnswer:
    """A model as .json, .tex or .csv."""
    from estimation.report.model_export import export_model

    export_model(file, output)
    return _file_answer(file, output.suffix[1:], [output])


def _file_answer(
    file: object,
    kind: str,
    files: Sequence[Path],
    lines: Sequence[str] = (),
    notes: Sequence[str] = (),
    passed: bool = True,
) -> FileAnswer:
    """The answer on written files. kind: of the output. lines: to print. notes: the same, marked as notes."""
    content = {
        "version": 1, "from": str(file), "to": kind, "files": [str(f) for f in files], "notes": [*lines, *notes]
    }  # fmt: skip
    return FileAnswer(content, (*(f"{f}: written" for f in files), *lines, *(f"  note: {n}" for n in notes)), passed)


def _to_simulator(
    target: str, file: Path, out: Path, aircraft: str | None, throws: Sequence[str], thrust: float | None,
    stall: float | None, force: bool, prove: bool,
) -> FileAnswer:  # fmt: skip
    from estimation.simulation.autopilot import writing
    from estimation.simulation.autopilot.gathering import Stated

    for option, number in (("--thrust", thrust), ("--alpha-stall", stall)):
        if number is not None and not (math.isfinite(number) and number >= 0.0):
            raise EstimationError(f"{option} {number:g}: give a number, zero or above")
    writers: dict[str, Callable[..., ExportedSimulator]] = {
        "ardupilot": writing.to_ardupilot,
        "gazebo": writing.to_gazebo,
        "neutral": writing.to_neutral,
    }
    request = writing.Request(Stated(aircraft, _throws_of(throws), thrust), stall, force, prove)
    exported = writers[target](file, out, request)
    content = {
        "version": 1, "from": str(file), "to": target, "files": [str(f) for f in exported.files],
        "proof": exported.proof.to_json(), "notes": list(exported.lines),
    }  # fmt: skip
    return FileAnswer(content, tuple(_proof_lines(exported)), not exported.proof.failed)


def _proof_lines(exported: "ExportedSimulator") -> list[str]:
    proof = exported.proof
    lines = [f"{f}: written" for f in exported.files]
    lines.append(f"  {'axis':<8}{'deviation':>11}{'allowed':>11}")
    lines += [f"  {axis:<8}{value:>11.2g}{proof.limit:>11.2g}" for axis, value in proof.deviation.items()]
    lines += [f"  left out: {term.sentence()}" for term in proof.left_out]
    lines.append(proof.sentence())
    # a model that failed its proof must not be flown: no instructions
    return lines if proof.failed else [*lines, *exported.lines]


def _to_jsbsim(file: Path, output: Path | None, out: Path | None, aircraft_from: str | None, rate: float) -> FileAnswer:
    """Write an aircraft of JSBSim and prove it; `passed` is False where it does not fly like the model."""
    from estimation.simulation.conversion import export_to_jsbsim

    if out is None or output is not None:
        raise EstimationError("--to jsbsim writes a folder: give --out DIR, and no --output")
    proved = export_to_jsbsim(file, aircraft_from, out, rate)
    exported, proof = proved.exported, proved.proof
    lines = [
        f"  added: {', '.join(exported.terms) or 'nothing'}",
        *(f"  left out: {term}" for term in exported.left_out),
        f"  {'output':<8}{'rms':>11}{'allowed':>11}{'by steps':>11}",
        *(
            f"  {name:<8}{rms:>11.3g}{proof.allowed[name]:>11.3g}{proof.steps[name]:>11.3g}"
            for name, rms in proof.rms.items()
        ),
        proved.sentence(),
        proved.step_error_sentence(),
    ]
    return _file_answer(file, "jsbsim", [exported.file], lines, passed=not proof.failed)


def _from_jsbsim(spec: str, output: Path | None, out: Path | None) -> FileAnswer:
    from estimation.simulation.conversion import import_from_jsbsim

    if not spec.startswith(_JSBSIM):
        raise EstimationError("--to model takes a JSBSim aircraft: jsbsim:NAME or jsbsim:FOLDER for FILE")
    if out is not None or output is None or output.suffix.lower() != ".toml":
        raise EstimationError("a JSBSim aircraft becomes one file: give -o MODEL.toml")
    proved = import_from_jsbsim(spec, output)
    sentences = (*proved.imported.sentences(), *proved.notes)
    return _file_answer(spec, "model", [output], [*(f"  {line}" for line in sentences), proved.sentence()])
