"""The logs of the study: however an aeroplane is wired, the same flight is read from them."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from groundstation.flight import Flight
from groundstation.flight.contradictions import contradictions
from groundstation.importers.run import import_data
from tests.studies.arduplane_logs import AEROPLANES, WIRINGS, flown, surfaces, tables
from tests.unit.groundstation.importers.autopilots import dataflash

NAME = "foam"


@pytest.fixture(scope="module")
def truth() -> Mapping[str, np.ndarray]:
    return flown(AEROPLANES[NAME], legs=1)


def read(truth: Mapping[str, np.ndarray], wiring: str, folder: Path) -> Flight:
    messages = tables(truth, AEROPLANES[NAME], np.random.default_rng(4), 25.0, wiring=WIRINGS[wiring])
    (folder / "log.bin").write_bytes(dataflash(messages))
    (folder / "map.toml").write_text(surfaces(AEROPLANES[NAME].lag, WIRINGS[wiring]))
    return import_data(folder / "log.bin", folder / "map.toml")


@pytest.fixture(scope="module")
def usual(truth: Mapping[str, np.ndarray], tmp_path_factory: pytest.TempPathFactory) -> Flight:
    return read(truth, "usual", tmp_path_factory.mktemp("usual"))


@pytest.mark.parametrize("wiring", [w for w in WIRINGS if w != "usual"])
def test_however_servos_and_pitots_are_wired_the_flight_is_the_same(
    truth: Mapping[str, np.ndarray], usual: Flight, tmp_path: Path, wiring: str
) -> None:
    flight = read(truth, wiring, tmp_path)
    assert not [c.text for c in contradictions(flight) if c.stops]
    for name, within in (("delta_a", 0.001), ("delta_e", 0.001), ("delta_r", 0.001), ("V", 0.5), ("phi", 0.04)):
        difference = flight[name] - np.interp(flight.time, usual.time, usual[name])
        assert np.nanmax(np.abs(difference)) < within, name
    assert np.nanmin([np.nanstd(flight[n]) for n in ("delta_a", "delta_e", "delta_r")]) > 0.005
    assert flight.channels["phi"]["from"] == "ATT.Roll"
    assert np.nanmedian(flight["p_dynamic"]) == pytest.approx(np.nanmedian(usual["p_dynamic"]), rel=0.02)
