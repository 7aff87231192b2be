"""Simulated flights for campaigns: scenarios of a plan's [[simulate]] as data, and the function that flies them."""

from collections.abc import Mapping
from typing import Any

from estimation.campaign.keys import digest_of_files
from estimation.campaign.tasks import FlightMaker

IGNORED_TABLES = ("sensors", "faults", "radio", "logger", "sequencer")
"""Tables of a scenario that have no effect here, without bus, chips and radio."""


def describe_scenario(scenario: str, changes: Mapping[str, Any]) -> Mapping[str, Any]:
    """A scenario as JSON-able data. changes: dotted key -> value. Raises ScenarioError for an unknown name or key, and for a key
    without effect."""
    from estimation.aircraft import load_aircraft
    from firmware_sim.physics.aerodynamics import true_derivatives
    from firmware_sim.tables import ScenarioError
    from firmware_sim.world.scenario import load_scenario

    tables: dict[str, Any] = {}
    for key, value in changes.items():
        table, dot, name = key.partition(".")
        if table in IGNORED_TABLES:
            raise ScenarioError(
                f"{key}: flights are made without bus, chips and radio, so it changes nothing; leave it out"
            )
        if key == "flight.seed":
            raise ScenarioError("flight.seed: each flight has a seed of its own; give seed beside the scenario")
        if dot:
            tables.setdefault(table, {})[name] = value
        else:
            tables[key] = value
    altered_scenario = load_scenario(scenario).altered(**tables)
    true_derivatives(load_aircraft(altered_scenario.flight.aircraft), altered_scenario.derivatives)
    return altered_scenario.model_dump(mode="json")


def fly_description(description: Mapping[str, Any]) -> bytes:
    """The CSV of a flight, simulated with the direct sensor model, without bus and chips. description: `scenario`, as from
    `describe_scenario`, and `seed`."""
    import tempfile
    from pathlib import Path

    from firmware_sim.runs.direct import direct_flights, write_csv
    from firmware_sim.world.scenario import scenario_from

    scenario = scenario_from(dict(description["scenario"]), "campaign")
    columns = direct_flights([scenario], [int(description["seed"])])[0]
    with tempfile.TemporaryDirectory(prefix="sideslip-") as folder:
        path = Path(folder) / "flight.csv"
        write_csv(path, columns)
        return path.read_bytes()


def simulator() -> FlightMaker:
    """The simulator in the form that `estimation.campaign` needs."""
    return FlightMaker(describe_scenario, fly_description, digest_of_files(("firmware_sim", "estimation/aircraft")))
