"""From the simulated aircraft to the estimate: what is recorded on board, received and estimated must agree."""

import json
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from daq.contract.recordings.reading import read_recording
from estimation.aircraft import load_aircraft
from estimation.models import load_model
from estimation.session import runner
from firmware_sim.world.scenario import load_scenario
from firmware_sim.world.simulation import derivatives_of
from groundstation.calibration.recording import calibrate_recording
from groundstation.flight import Flight, read_flight
from groundstation.live.replay import Replay, replay_into
from sideslip import Flown
from sideslip.chain import fly_onboard

STRONG = ("CY_beta", "CY_dr", "Cl_beta", "Cl_p", "Cl_da", "Cn_beta", "Cn_r", "Cn_dr")


def common(one: Flight, two: Flight) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the samples that both flights have."""
    _, i, j = np.intersect1d(one.time, two.time, return_indices=True)
    return i, j


def test_sent_is_received_plus_lost_exactly(lossy: tuple[Path, Flown]) -> None:
    _, flown = lossy
    session = flown.summary["sessions"][0]
    lost = sum(b - a + 1 for a, b in session["scans_lost"])
    assert lost > 5
    assert session["scans_unknown"] == []
    assert session["scans_sent"] == session["scans_received"] + lost
    assert flown.summary["backfilled"] == 0


def test_telemetry_and_onboard_agree_sample_for_sample(lossy: tuple[Path, Flown]) -> None:
    folder, _ = lossy
    received = next((folder / "ground").glob("aircraft*.mcap"))
    ground = calibrate_recording(received, "cdfp", align=False)
    onboard = calibrate_recording(folder / "onboard", align=False)
    i, j = common(ground, onboard)
    assert len(i) == len(ground) > 300
    for name in (
        "ax",
        "ay",
        "az",
        "p",
        "q",
        "r",
        "phi",
        "theta",
        "alpha",
        "beta",
        "V",
        "delta_e",
        "delta_a",
        "delta_r",
    ):
        both = np.isfinite(ground[name][i]) & np.isfinite(onboard[name][j])
        assert both.sum() > 250, name
        np.testing.assert_allclose(ground[name][i][both], onboard[name][j][both], rtol=0, atol=1e-12, err_msg=name)


def test_after_backfill_the_ground_has_the_flight_bit_for_bit(complete: tuple[Path, Flown]) -> None:
    folder, flown = complete
    assert flown.agreed
    assert flown.ground is not None
    onboard, ground = read_flight(flown.onboard), read_flight(flown.ground)
    assert np.array_equal(onboard.time, ground.time)
    for name in onboard.columns:
        assert np.array_equal(onboard[name], ground[name], equal_nan=True), name
    received = read_recording(next((folder / "ground").glob("aircraft*.mcap")))
    on_board = read_recording(folder / "onboard")
    assert list(received.scans()) == list(on_board.scans())
    of_sensors = {k: v for k, v in on_board.info.details.items() if not k.startswith("simulation.")}
    assert received.info.details == of_sensors
    assert {"static.nvm", "pitot.scale_pa"} <= of_sensors.keys()


def test_recording_opens_in_the_stock_reader_with_names_in_it(complete: tuple[Path, Flown]) -> None:
    from mcap_protobuf.decoder import DecoderFactory

    folder, _ = complete
    with next((folder / "onboard").glob("*.mcap")).open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()], validate_crcs=True)
        _, _, _, scan = next(iter(reader.iter_decoded_messages(topics=["/scan"])))
    assert scan.HasField("accel_z")
    assert scan.time_monotonic_ns >= 0


def test_replayed_telemetry_makes_the_same_flight(lossy: tuple[Path, Flown], tmp_path: Path) -> None:
    from groundstation.live.config import GroundConfig
    from groundstation.live.station import Station
    from groundstation.receiver.receive import Receiver

    folder, flown = lossy
    source = Replay()
    quiet = GroundConfig().link.model_copy(update={"ports": (), "transmit": False, "backfill": "off"})
    receiver = Receiver(quiet, {"replay": source.port}, source.clock, folder=tmp_path)
    station = Station(GroundConfig(), receiver, source.clock, tmp_path)
    replay_into(station, source, folder / "ground" / "telemetry.tlog", None)
    station.close()
    summary = receiver.summary()
    assert summary["scans_received"] == flown.summary["scans_received"]
    assert summary["frames_damaged"] == flown.summary["frames_damaged"]


@pytest.mark.parametrize("seed", [3, 4])
def test_estimates_from_the_onboard_recording_lie_within_three_bounds_of_truth(seed: int, tmp_path: Path) -> None:
    scenario = load_scenario("rich")
    onboard = fly_onboard(scenario, tmp_path, seed=seed)
    aircraft = load_aircraft("cdfp")
    session = runner.estimate(load_model("lateral", aircraft), [read_flight(onboard)], aircraft)
    result = session.flights[0].results["ml"]
    truth = derivatives_of(scenario, seed)
    assert result.converged
    for name in STRONG:
        e = result.parameters[name]
        assert e.identifiable, name
        assert abs(e.estimate - truth[name]) < 3 * e.std_coloured, (
            f"{name}: {e.estimate} +- {e.std_coloured}, truth {truth[name]}"
        )
        assert abs(e.estimate / truth[name] - 1) < 0.12, name


def test_files_are_where_the_interface_says(complete: tuple[Path, Flown]) -> None:
    folder, _ = complete
    for name in ("ground/telemetry.tlog", "ground/flight.mcap", "flight.mcap", "truth.csv", "scenario.toml"):
        assert (folder / name).is_file(), name
    assert list((folder / "onboard").glob("*.mcap"))
    handed = json.loads((folder / "ground" / "flight.json").read_text())
    assert handed["manoeuvres"]
    again = load_scenario(str(folder / "scenario.toml"))
    assert again.flight.seed == 12
