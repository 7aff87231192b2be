"""A recording with a file that the logger gave up on a full card: the ordinary way to a flight, and what it says."""

from pathlib import Path

from daq.contract.recordings.accounting import verify
from firmware_sim.runs.flight import prepare_flight
from firmware_sim.world.scenario import load_scenario
from groundstation.calibration.recording import calibrate_recording


def test_a_file_given_up_on_a_full_card_needs_no_salvage(tmp_path: Path) -> None:
    with prepare_flight(load_scenario("fault_disk_full"), tmp_path, duration_s=13.0) as prepared:
        prepared.run()
    onboard = tmp_path / "onboard"
    state = verify(onboard)
    assert state.ok, state.text
    assert [p.name for p in state.given_up] == ["fault_disk_full_1_000.mcap"]
    flight = calibrate_recording(onboard, "cdfp")
    assert len(flight.time) == state.scans
    said = [note.text for note in flight.notes if "given up" in note.text]
    assert len(said) == 1
    assert said[0].startswith("fault_disk_full_1_000.mcap")
    assert said[0].endswith("no scan is missing")
