"""Sideslip in a notebook: five lines from a recording to derivatives with bounds.

    import sideslip as ss
    flight = ss.open("ld1.mcap")
    result = ss.estimate(flight, "lateral")
    result.to_pandas()
    result.plot()

Every function does what the verb of its name does, with the same numbers; what it returns prints shortly, shows a table in a
notebook, and gives pandas frames, figures and files when asked.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sideslip.results import Check, Estimates, GapAnswer, Match

if TYPE_CHECKING:
    from estimation.aircraft import Aircraft
    from estimation.design.design import Design
    from estimation.models import Model
    from estimation.simulation.attach import Attached
    from groundstation.flight import Flight

    Flights = Flight | str | Path | Sequence[Flight | str | Path]
    AnyModel = str | Path | Model | type
    AnyAircraft = str | Path | Aircraft | None


__all__ = [
    "Check", "Estimates", "GapAnswer", "Match", "check", "design", "estimate", "gap", "import_log", "match", "open", "simulate",
]  # fmt: skip


def open(path: str | Path) -> "Flight":
    """A flight file (.mcap, .csv, .parquet), or a raw recording, calibrated with the set it carries."""
    from groundstation.export.run import open_flight

    return open_flight(Path(path))


def import_log(
    path: str | Path,
    mapping: str | Path | None = None,
    rate_hz: float | None = None,
    *,
    aircraft: str | Path | None = None,
) -> "Flight":
    """Somebody else's log as a flight: CSV, Parquet, MATLAB, ULog, ArduPilot .bin, .tlog.

    mapping: a file as for `import --map`. aircraft: a built-in name, or a file, which then travels with the flight.
    """
    from groundstation.importers.aircraft import with_aircraft
    from groundstation.importers.run import import_data

    flight = import_data(Path(path), None if mapping is None else Path(mapping), rate_hz=rate_hz)
    return flight if aircraft is None else with_aircraft(flight, str(aircraft))


def check(flights: "Flights", factors: Sequence[str] = (), joint: bool = False) -> "Check":
    """Data compatibility and quality; factors: as for `check --factors`, the standard ones where none is given."""
    from estimation.compatibility.reconstruction import compatibility
    from estimation.models.kinematic import STANDARD_FACTORS
    from estimation.session.flights import unique_names
    from groundstation.flight.quality.report import quality_report

    read = unique_names(read_flights(flights))
    wanted = tuple(factors) or STANDARD_FACTORS
    results = {flight.name: compatibility(flight, wanted) for flight in read}
    if joint:
        results["joint"] = compatibility(read, wanted)
    return Check(results, {flight.name: tuple(quality_report(flight)) for flight in read}, tuple(read))


def estimate(
    flights: "Flights",
    model: "AnyModel" = "lateral",
    method: str | Sequence[str] = "ml",
    *,
    aircraft: "AnyAircraft" = None,
    joint: bool = False,
    seed: int = 0,
    simulation: str | None = None,
    structure: str = "test",
) -> "Estimates":
    """Aerodynamic parameters with bounds; method: names as for `estimate --method`, comma-separated or a list. simulation: one of
    your own as base, as for `--simulation`; then model is a built-in name or a model file found on a simulation. structure:
    off, test or auto, as for
    `--structure`."""
    from estimation.estimators.estimator import Extras
    from estimation.session import runner
    from estimation.session.flights import unique_names
    from estimation.session.structured import Wish

    read = unique_names(read_flights(flights))
    if simulation is None:
        chosen, craft = model_of(model, read, aircraft)
    else:
        attached = _on_simulation(simulation, model, read, aircraft, estimating=True)
        chosen, craft, read = attached.model, attached.aircraft, list(attached.flights)
    methods = [m.strip() for m in method.split(",")] if isinstance(method, str) else list(method)
    session = runner.estimate(chosen, read, craft, methods, joint=joint, extras=Extras(seed=seed), structure=Wish(structure))
    return Estimates(session)


def match(
    model: "AnyModel",
    flights: "Flights",
    free: Sequence[str] = (),
    *,
    aircraft: "AnyAircraft" = None,
    simulation: str | None = None,
) -> "Match":
    """Predict flights with the model's parameters frozen, but those named in `free`. simulation: as for `estimate`."""
    from estimation.session.flights import unique_names
    from estimation.session.proof_of_match import predict

    read = unique_names(read_flights(flights))
    if simulation is None:
        chosen, _ = model_of(model, read, aircraft)
    else:
        attached = _on_simulation(simulation, model, read, aircraft, predicting=True)
        chosen, read = attached.model, list(attached.flights)
    return Match(tuple(predict(chosen, flight, free=tuple(free)) for flight in read))


def gap(
    model: "AnyModel",
    flights: "Flights",
    holdout: "Flights" = (),
    *,
    aircraft: "AnyAircraft" = None,
    seed: int = 1,
    nulls: int = 200,
    simulation: str | None = None,
) -> "GapAnswer":
    """Find what the model of the flights is missing; holdout: flights kept out of every fit. simulation: as for `estimate`."""
    from estimation.gap.workflow import Options, run_gap
    from estimation.session.flights import unique_names

    given = read_flights(flights)
    read = unique_names([*given, *read_flights(holdout)])
    training, held = read[: len(given)], read[len(given) :]
    if simulation is None:
        chosen, _ = model_of(model, [*training, *held], aircraft)
    else:
        attached = _on_simulation(simulation, model, [*training, *held], aircraft)
        chosen = attached.model
        training, held = attached.training(len(training)), attached.holdout(len(training))
    return GapAnswer(run_gap(chosen, training, held, options=Options(seed=seed, nulls=nulls)))


def design(
    model: "AnyModel", time: float, aircraft: "str | Path | Aircraft", kind: str = "optimal", **task: Any
) -> "Design":
    """An input of `time` seconds that tells most; further arguments are those of `estimation.design.design.Task`."""
    import math

    from estimation.design.design import Task
    from estimation.design.design import design as designed

    chosen, craft = model_of(model, [], aircraft)
    density = task.setdefault("density", 1.17)
    task.setdefault("speed", math.sqrt(2 * craft.mass * 9.80665 / (density * craft.area * 0.3)))
    return designed(chosen, craft, Task(kind, time, **task))


def simulate(model: "AnyModel", flight: "Flight | str | Path", *, aircraft: "AnyAircraft" = None) -> "Flight":
    """The flight with what the model shows on its measured inputs, as columns `<output>_model`."""
    from estimation.engine.simulate import simulate as simulated

    (read,) = read_flights(flight)
    chosen, _ = model_of(model, [read], aircraft)
    y = simulated(chosen, read)
    return read.with_columns(**{f"{name}_model": y[:, i] for i, name in enumerate(chosen.output_names)})


def read_flights(flights: "Flights") -> "list[Flight]":
    """Flights that are given as such or as files."""
    from groundstation.flight import Flight

    listed = [flights] if isinstance(flights, Flight | str | Path) else list(flights)
    return [f if isinstance(f, Flight) else open(f) for f in listed]


def _on_simulation(
    spec: str, model: "AnyModel", flights: "Sequence[Flight]", aircraft: "AnyAircraft", **purpose: bool
) -> "Attached":
    """Flights and model on a simulation; purpose: as of `estimation.commands.simulation.attached_to`."""
    from estimation.commands.simulation import attached_to

    return attached_to(spec, str(model), flights, None if aircraft is None else str(aircraft), **purpose)


def model_of(which: "AnyModel", flights: "Sequence[Flight]", aircraft: "AnyAircraft") -> "tuple[Model, Aircraft]":
    """The model, and the aircraft it is of: the given one, the one the flights carry or name, else unknown where it may be."""
    from estimation.aircraft import Aircraft, unknown_aircraft
    from estimation.aircraft.of_flight import aircraft_of
    from estimation.models import load_model
    from estimation.models.load import asks_for_aircraft

    if isinstance(aircraft, Aircraft):
        return load_model(which, aircraft), aircraft
    if aircraft is None and not (isinstance(which, str | Path) and asks_for_aircraft(str(which))):
        craft = unknown_aircraft(flights[0].provenance.aircraft if flights else "not stated")
        return load_model(which, None), craft
    craft = aircraft_of(flights, aircraft)
    return load_model(which, craft), craft
