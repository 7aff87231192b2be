"""The usual configurations, all sensors, an autopilot with vanes, an autopilot alone: flown, recorded, handed over, estimated."""

import json
from pathlib import Path
from typing import Any

from click.testing import CliRunner

from firmware_sim.world.scenario import load_scenario
from firmware_sim.world.simulation import derivatives_of
from sideslip.cli import cli
from tests.support.paths import ROOT

CONFIGS = ROOT / "daq" / "configs"
BELIEVED = 3.0
"""Corrected bounds that a derivative may be off by: of 15 in three flights none is further with a chance of 0.9."""
WIDER = 3.0
"""Bounds of an autopilot alone against those of all sensors, the pitot's calibration in both."""
SCENARIO = """
[flight]
duration_s = 60.0
manoeuvres = "rich"
seed = 53
"""


def run(*arguments: str) -> None:
    result = CliRunner().invoke(cli, list(arguments), catch_exceptions=False)
    assert result.exit_code in (0, 1), result.output


def identify(folder: Path, config: str, calibration: str) -> dict[str, Any]:
    """Estimates of the flight as handed over at the ground."""
    scenario = folder / "rich.toml"
    scenario.write_text(SCENARIO)
    out = folder / config
    chosen = ("--config", str(CONFIGS / f"{config}.toml"), "--calibration", calibration)
    run("fly", str(scenario), "--out", str(out), *chosen)
    flight = out / "ground" / "flight.mcap"
    if config == "autopilot":
        run("reconstruct", str(flight), "-o", str(out / "with_angles.mcap"))
        flight = out / "with_angles.mcap"
    answer = out / "estimate.json"
    run("estimate", str(flight), "--method", "ml", "--json", str(answer))
    found: dict[str, Any] = json.loads(answer.read_text())["flights"][0]["methods"]["ml"]
    assert found["converged"], found["status"]
    return found["parameters"]


def test_each_configuration_identifies(tmp_path: Path) -> None:
    sets = {"cdfp": "cdfp", "autopilot_vanes": "autopilot", "autopilot": "autopilot"}
    found = {config: identify(tmp_path, config, calibration) for config, calibration in sets.items()}
    truth = derivatives_of(load_scenario(str(tmp_path / "rich.toml")), 53)
    wrong = {}
    for config, parameters in found.items():
        for name, p in parameters.items():
            if name not in truth:  # a delay of a channel, not of the aircraft
                continue
            off = abs(p["estimate"] - truth[name]) / p["std_coloured"]
            if not name.endswith("_0") and p["identifiable"] and off > BELIEVED:
                wrong[config, name] = (p["estimate"], truth[name], p["std_coloured"])
    assert not wrong
    for name, p in found["autopilot"].items():
        if not name.endswith("_0") and name in found["cdfp"] and name in truth:
            assert p["std_coloured"] <= WIDER * found["cdfp"][name]["std_coloured"], name
