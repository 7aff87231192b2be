"""From a model file to a JSBSim aircraft and from a JSBSim aircraft to a model file, each proved, for `sideslip export`."""

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from daq.utilities.constants import FOOT, SEA_LEVEL_DENSITY, SLUG
from daq.utilities.input_files import read_json
from daq.utilities.outputs import write_json
from estimation.models.base import Model
from estimation.models.load import read_model, write_model
from estimation.simulation.jsbsim.aircraft import ATTITUDES, HELD, JsbsimOracle, jsbsim_simulation
from estimation.simulation.jsbsim.as_text import (
    SUTHERLAND,
    AircraftSource,
    Imported,
    StandardTroposphere,
    arm_of,
    import_aircraft,
)
from estimation.simulation.jsbsim.export import JsbsimExport, export_aircraft
from estimation.simulation.jsbsim.increments import simulation_named
from estimation.simulation.jsbsim.library import PREFIX, aerodynamics_of, aircraft_file, knows_property
from estimation.simulation.oracle import COEFFICIENTS, VARIABLES, Array, Simulation, SimulationError, States
from estimation.simulation.own_simulations import TextOracle
from estimation.simulation.proof import ExportProof, proof_of

RATE = 120.0  # Hz: JSBSim's default
SLOWEST, FASTEST = 20.0, 2000.0  # Hz: rates at which an aircraft can sensibly be flown


@dataclass(frozen=True)
class ProvedExport:
    """The written aircraft, and how far its flight is from the model's. rate: steps per second of the proof."""

    exported: JsbsimExport
    proof: ExportProof
    rate: float

    def sentence(self) -> str:
        """The result of the proof."""
        if not self.proof.failed:
            return (
                "proof: flown by JSBSim, the aircraft stays within a tenth of sensor noise of the model in every output"
            )
        output = _worst_output(self.proof, self.proof.rms, self.proof.failed)
        return (
            f"proof failed: flown by JSBSim, {output} differs from the model by {self.proof.rms[output]:.3g} rms, allowed are"
            f" {self.proof.allowed[output]:.3g}; do not use the aircraft, and look at what the model has that no aircraft can"
        )

    def step_error_sentence(self) -> str:
        """The error of JSBSim's steps alone at the rate, in one sentence."""
        proof = self.proof
        output = _worst_output(proof, proof.steps, tuple(proof.steps))
        step_note = f"its steps alone put {output} off by {proof.steps[output]:.2g} rms in the same flight"
        if proof.steps[output] <= proof.allowed[output]:
            return f"at {self.rate:g} Hz {step_note}, within what is allowed"
        return (
            f"at {self.rate:g} Hz {step_note}, {proof.steps[output] / proof.allowed[output]:.1f} times what is allowed of"
            " aerodynamics: fly it at a higher rate where edges of surfaces matter"
        )


def _worst_output(proof: ExportProof, deviations: Mapping[str, float], among: tuple[str, ...]) -> str:
    return max(among, key=lambda n: deviations[n] / proof.allowed[n])


def export_to_jsbsim(path: Path, aircraft_from: str | None, out: Path, rate: float = RATE) -> ProvedExport:
    """Write the model file `path` as an aircraft into the folder `out` and fly both.

    aircraft_from: `jsbsim:NAME` or a folder; by default the simulation that the model was found on. rate: JSBSim steps per
    second, the unit of delays and the rate of the proof. Raises SimulationError or ModelError before anything is written.
    """
    model = read_model(path)
    spec = aircraft_from or simulation_named(model)
    if not spec.startswith(PREFIX):
        origin = f"was found on {spec!r}" if spec else "does not say on which simulation it was found"
        raise SimulationError(f"{path}: {origin}; say which aircraft to write it into with --aircraft-from jsbsim:NAME")
    if not SLOWEST <= rate <= FASTEST:
        raise SimulationError(f"--rate {rate:g}: give steps per second from {SLOWEST:g} to {FASTEST:g}")
    source = aircraft_file(spec.removeprefix(PREFIX))
    record = _lineage(model, path, spec, rate)
    exported, written_aircraft, increments = export_aircraft(
        model, source, out, json.dumps(record, sort_keys=True), rate
    )
    proof = proof_of(source, jsbsim_simulation(spec.removeprefix(PREFIX)), written_aircraft, increments, rate)
    record |= {
        "terms": list(exported.terms),
        "left_out": list(exported.left_out),
        "proof": {n: {"rms": v, "allowed": proof.allowed[n], "steps": proof.steps[n]} for n, v in proof.rms.items()},
        "proved": not proof.failed,
    }
    write_json(record, exported.file.parent / "sideslip.json")
    return ProvedExport(exported, proof, rate)


def _lineage(model: Model, path: Path, spec: str, rate: float) -> dict[str, Any]:
    """The origin of an exported aircraft: model, simulation, and the lineage that the gap workflow wrote beside the model."""
    record: dict[str, Any] = {
        "model": path.name, "digest": model.digest, "simulation": spec, "rate_hz": rate, "software": _software(),
    }  # fmt: skip
    lineage_path = path.with_name(f"{path.stem}.lineage.json")
    if lineage_path.is_file():
        try:
            lineage = read_json(lineage_path, "lineage", SimulationError)
            record["added"] = [
                {k: step[k] for k in ("effect", "confidence", "parameters")} for step in lineage["added"]
            ]
            record["flights"] = lineage["flights"]
        except (ValueError, KeyError, TypeError) as error:
            raise SimulationError(
                f"{lineage_path}: not what 'sideslip gap' writes beside a model; move it away"
            ) from error
    return record


def _software() -> str:
    try:
        return f"sideslip {version('sideslip')}"
    except PackageNotFoundError:
        return "sideslip (not installed)"


# From a JSBSim aircraft to a model file: what `sideslip export jsbsim:NAME -o MODEL.toml` does.
#
# The file is written only where every function has an exact form, and where its coefficients equal JSBSim's at random states.

SAME = 1e-9  # of the largest value of a coefficient: text and JSBSim differ by rounding only
STATES = 200  # random ones of a proof
SIZES = {"beta": 0.2, "p": 0.4, "q": 0.3, "r": 0.3, "delta_e": 0.3, "delta_a": 0.3, "delta_r": 0.3}  # rad, rad/s
ALPHAS = (-0.1, 0.3)  # rad: JSBSim's stall hysteresis does not act there
DENSITIES = (0.6, 1.2)  # kg/m3: the troposphere
CRUISE = 0.4  # lift coefficient that sets the speed, at sea level
SPEEDS = (0.7, 1.8)  # range of speeds over that
SEED = 20261123  # fixed, so that a proof is repeatable
GRAVITY = 9.81  # m/s2, rounded: it only sets the size of speeds
SAMPLED = 4  # states at which a property is read to see whether it is constant


@dataclass(frozen=True)
class ProvedImport:
    """The written model. deviation: coefficient -> largest difference from JSBSim's over its largest value; notes: which parts of
    the aircraft are not used."""

    imported: Imported
    deviation: dict[str, float]
    notes: tuple[str, ...]

    @property
    def worst(self) -> str:
        """The coefficient with the largest deviation."""
        return max(self.deviation, key=lambda c: self.deviation[c])

    def sentence(self) -> str:
        """The result of the proof."""
        return (
            f"proof: at {STATES} random states all six coefficients are JSBSim's own, {self.worst} to"
            f" {self.deviation[self.worst]:.1g} of its largest value"
        )


def import_from_jsbsim(spec: str, path: Path) -> ProvedImport:
    """Write the aircraft `spec` (jsbsim:NAME or jsbsim:FOLDER) as the model file `path`.

    Raises SimulationError, before anything is written, where a function has no exact form in our text or the proof fails.
    """
    proved_import = imported_exactly(spec)
    write_model(proved_import.imported.model, path)
    return proved_import


def imported_exactly(spec: str) -> ProvedImport:
    """The model of an aircraft with its proof. Raises SimulationError where it has no exact form or the proof fails."""
    simulation = jsbsim_simulation(spec.removeprefix(PREFIX))
    oracle, aircraft = simulation.oracle, simulation.aircraft
    assert isinstance(oracle, JsbsimOracle)
    assert aircraft is not None
    states = random_states(simulation)
    fdm = oracle.fdm
    source = AircraftSource(
        simulation.name, simulation.spec, aircraft, aerodynamics_of(aircraft_file(spec.removeprefix(PREFIX))),
        oracle.surfaces.writes, arm_of(lambda name: float(fdm[name])), _air(oracle, states), _property_reader(oracle, states),
    )  # fmt: skip
    imported_model = import_aircraft(source)
    text, jsbsim_values = _both_coefficients(oracle, TextOracle(imported_model.model), states)
    size = np.maximum(np.abs(jsbsim_values).max(axis=0), 1e-300)
    deviation = dict(zip(COEFFICIENTS, (np.abs(text - jsbsim_values).max(axis=0) / size).tolist(), strict=True))
    proved = ProvedImport(imported_model, deviation, tuple(n for n in simulation.notes if not n.endswith(HELD)))
    if not deviation[proved.worst] <= SAME:
        raise SimulationError(
            f"{spec}: its text has another {proved.worst} than JSBSim, by {deviation[proved.worst]:.2g} of its largest value, so"
            f" it is not written; run it as it is with --simulation {spec}"
        )
    return proved


def _both_coefficients(oracle: JsbsimOracle, text: TextOracle, states: States) -> tuple[Array, Array]:
    """(N, 6) coefficients of a text and of JSBSim, both at the state that JSBSim has after it was set: its density follows from a
    rounded height, and its rate of alpha from an attitude, two in turn."""
    fdm, jsbsim_values, rows = oracle.fdm, [], []
    for i in range(len(states)):
        state = {n: float(v[i]) for n, v in states.values.items()}
        coefficients, rate = oracle.at_its_own_rate(state, float(states.rho[i]), ATTITUDES[i % 2])
        jsbsim_values.append(coefficients)
        rows.append({
            "V": fdm["velocities/vt-fps"] * FOOT, "alpha": fdm["aero/alpha-rad"], "beta": fdm["aero/beta-rad"],
            "rho": fdm["atmosphere/rho-slugs_ft3"] * SLUG / FOOT**3, "alpha_dot": rate,
        })  # fmt: skip
    table = {n: np.array([row[n] for row in rows]) for n in rows[0]}
    exact = States({**states.values, **{n: table[n] for n in ("V", "alpha", "beta")}}, table["rho"], table["alpha_dot"])
    return text.coefficients(exact), np.array(jsbsim_values)


def random_states(simulation: Simulation, count: int = STATES) -> States:
    """States in which the aircraft may fly, the same at every call."""
    aircraft = simulation.aircraft
    assert aircraft is not None
    rng = np.random.default_rng(SEED)
    cruise = math.sqrt(2.0 * aircraft.mass * GRAVITY / (SEA_LEVEL_DENSITY * aircraft.area * CRUISE))
    values = {n: rng.uniform(-SIZES.get(n, 0.0), SIZES.get(n, 0.0), count) for n in VARIABLES}
    values["V"], values["alpha"] = cruise * rng.uniform(*SPEEDS, count), rng.uniform(*ALPHAS, count)
    return States(values, rng.uniform(*DENSITIES, count), np.zeros(count))


def _property_reader(oracle: JsbsimOracle, states: States) -> Callable[[str], list[float] | None]:
    """A function: name -> values of a property at several states; None where JSBSim does not know it."""

    def values_of(name: str) -> list[float] | None:
        if not knows_property(oracle.fdm, name):
            return None
        values = []
        for i in range(SAMPLED):
            oracle.coefficients(states.part(slice(i, i + 1)))
            values.append(float(oracle.fdm[name]))
        return values

    return values_of


def _air(oracle: JsbsimOracle, states: States) -> StandardTroposphere:
    """JSBSim's atmosphere, from two states far apart in height: temperature is a power of density there."""
    fdm, air_samples = oracle.fdm, []
    order = np.argsort(states.rho)
    for i in (int(order[0]), int(order[-1])):
        oracle.coefficients(states.part(slice(i, i + 1)))
        air_samples.append((fdm["atmosphere/a-fps"] * FOOT, fdm["atmosphere/rho-slugs_ft3"] * SLUG / FOOT**3))
    (other_sound, thin), (sound_speed, rho) = air_samples
    kelvin = fdm["atmosphere/T-R"] / 1.8
    speed, chord = fdm["velocities/vt-fps"] * FOOT, fdm["metrics/cbarw-ft"] * FOOT
    reynolds = fdm["aero/Re"] or 1.0
    viscosity = rho * speed * chord / reynolds * (kelvin + SUTHERLAND) / kelvin**1.5
    return StandardTroposphere(
        sound_speed, kelvin, rho, math.log(other_sound / sound_speed) / math.log(thin / rho), viscosity
    )
