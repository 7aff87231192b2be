"""One simulated flight through the whole chain, flown once for all tests here."""

from pathlib import Path

import pytest

import sideslip
from firmware_sim.world.scenario import load_scenario
from sideslip import Flown


@pytest.fixture(scope="session")
def lossy(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Flown]:
    """A flight over a radio that loses 5 % of its packets; nothing fetched afterwards."""
    folder = tmp_path_factory.mktemp("lossy")
    scenario = load_scenario("rich").altered(radio={"drop": 0.05})
    return folder, sideslip.fly_scenario(scenario, folder, seed=11, backfill=False)


@pytest.fixture(scope="session")
def complete(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Flown]:
    """The same with everything fetched after landing."""
    folder = tmp_path_factory.mktemp("complete")
    scenario = load_scenario("rich").altered(radio={"drop": 0.05})
    return folder, sideslip.fly_scenario(scenario, folder, seed=12)
