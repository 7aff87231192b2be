"""From a model file to a JSBSim aircraft that is proved to fly like it: what `sideslip export --to jsbsim` does."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from daq.contract.input_files import read_json
from daq.contract.outputs import write_json
from estimation.models.base import Model
from estimation.models.load import read_model
from estimation.simulation.jsbsim.aircraft import jsbsim_simulation
from estimation.simulation.jsbsim.export import JsbsimExport, export_aircraft
from estimation.simulation.jsbsim.increments import simulation_named
from estimation.simulation.jsbsim.library import PREFIX, aircraft_file
from estimation.simulation.oracle import SimulationError
from estimation.simulation.proof import ExportProof, proof_of

RATE = 120.0  # Hz: JSBSim's own
FASTEST = 2000.0  # Hz


@dataclass(frozen=True)
class ProvedExport:
    """What was written, and how far it flies from the model. rate: steps per second it was flown at."""

    exported: JsbsimExport
    proof: ExportProof
    rate: float

    def sentence(self) -> str:
        """How the proof ended, in one sentence."""
        if not self.proof.failed:
            return (
                "proof: flown by JSBSim, the aircraft stays within a tenth of sensor noise of the model in every output"
            )
        worst = _worst(self.proof, self.proof.rms, self.proof.failed)
        return (
            f"proof failed: flown by JSBSim, {worst} differs from the model by {self.proof.rms[worst]:.3g} rms, allowed are"
            f" {self.proof.allowed[worst]:.3g}; do not use the aircraft, and look at what the model has that no aircraft can"
        )

    def of_the_steps(self) -> str:
        """What JSBSim's steps alone do at the rate, in one sentence."""
        proof = self.proof
        worst = _worst(proof, proof.steps, tuple(proof.steps))
        off = f"its steps alone put {worst} off by {proof.steps[worst]:.2g} rms in the same flight"
        if proof.steps[worst] <= proof.allowed[worst]:
            return f"at {self.rate:g} Hz {off}, within what is allowed"
        return (
            f"at {self.rate:g} Hz {off}, {proof.steps[worst] / proof.allowed[worst]:.1f} times what is allowed of aerodynamics:"
            " fly it at a higher rate where edges of surfaces matter"
        )


def _worst(proof: ExportProof, off: Mapping[str, float], among: tuple[str, ...]) -> str:
    return max(among, key=lambda n: off[n] / proof.allowed[n])


def export_to_jsbsim(path: Path, aircraft_from: str | None, out: Path, rate: float = RATE) -> ProvedExport:
    """Write the model file `path` as an aircraft into the folder `out` and fly both.

    aircraft_from: `jsbsim:NAME` or a folder; by default the simulation that the model was found on. rate: JSBSim steps per second
    for which delays are counted, and at which it is flown. Raises SimulationError or ModelError before anything is written.
    """
    model = read_model(path)
    spec = aircraft_from or simulation_named(model)
    if not spec.startswith(PREFIX):
        told = f"was found on {spec!r}" if spec else "does not say on which simulation it was found"
        raise SimulationError(f"{path}: {told}; say which aircraft to write it into with --aircraft-from jsbsim:NAME")
    if not 20.0 <= rate <= FASTEST:
        raise SimulationError(f"--rate {rate:g}: give steps per second from 20 to {FASTEST:g}")
    source = aircraft_file(spec.removeprefix(PREFIX))
    record = lineage_of(model, path, spec, rate)
    exported, written, found = export_aircraft(model, source, out, json.dumps(record, sort_keys=True), rate)
    proof = proof_of(source, jsbsim_simulation(spec.removeprefix(PREFIX)), written, found, rate)
    record |= {
        "terms": list(exported.terms),
        "left_out": list(exported.left_out),
        "proof": {n: {"rms": v, "allowed": proof.allowed[n], "steps": proof.steps[n]} for n, v in proof.rms.items()},
        "proved": not proof.failed,
    }
    write_json(record, exported.file.parent / "sideslip.json")
    return ProvedExport(exported, proof, rate)


def lineage_of(model: Model, path: Path, spec: str, rate: float) -> dict[str, Any]:
    """Where an exported aircraft comes from: model, simulation, and what the gap workflow wrote beside the model."""
    record: dict[str, Any] = {
        "model": path.name, "digest": model.digest, "simulation": spec, "rate_hz": rate, "software": _software(),
    }  # fmt: skip
    beside = path.with_name(f"{path.stem}.lineage.json")
    if beside.is_file():
        try:
            found = read_json(beside, "lineage", SimulationError)
            record["added"] = [{k: step[k] for k in ("effect", "confidence", "parameters")} for step in found["added"]]
            record["flights"] = found["flights"]
        except (ValueError, KeyError, TypeError) as error:
            raise SimulationError(f"{beside}: not what 'sideslip gap' writes beside a model; move it away") from error
    return record


def _software() -> str:
    try:
        return f"sideslip {version('sideslip')}"
    except PackageNotFoundError:
        return "sideslip (not installed)"
