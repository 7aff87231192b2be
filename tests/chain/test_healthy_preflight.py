"""A healthy aircraft of each configuration, standing on the ground, is GO without a caution; an unzeroed pitot is not."""

from pathlib import Path

import pytest

import daq
from daq.service.checks import PreflightVerdict
from daq.service.preflight import Preflight, run_preflight
from firmware_sim.hardware.card import SimulatedCard
from firmware_sim.runs.flight import prepare_flight
from firmware_sim.world.scenario import load_scenario

CONFIGS = Path(daq.__file__).parent / "configs"


def table_of(folder: Path, config: str, **sensors: object) -> Preflight:
    scenario = load_scenario("rich").altered(
        flight={"duration_s": 20.0, "seed": 71}, ground={"before_s": 20.0, "after_s": 5.0}, sensors=sensors
    )
    with prepare_flight(scenario, folder, config_file=CONFIGS / config) as run:
        run.clock.drive()
        card = SimulatedCard(run.aircraft.faults, run.clock)
        return run_preflight(run.config, run.clock, run.assembly.sampler, card)


@pytest.mark.parametrize("config", ["cdfp.toml", "autopilot.toml", "autopilot_vanes.toml"])
def test_go_without_a_caution(tmp_path: Path, config: str) -> None:
    table = table_of(tmp_path, config)
    assert [c for c in table.checks if c.verdict is not PreflightVerdict.GO] == [], table.text()
    assert {"level", "pitot zero", "clock", "timing"} <= {c.name for c in table.checks}


def test_an_offset_is_told_with_its_figure(tmp_path: Path) -> None:
    table = table_of(tmp_path, "cdfp.toml", pitot={"offset_pa": 57.0})
    (row,) = [c for c in table.checks if c.name == "pitot zero"]
    assert row.verdict is not PreflightVerdict.GO
    assert "+57 Pa" in row.text
    assert "zero it" in row.text
