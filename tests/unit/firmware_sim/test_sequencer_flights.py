"""Whole simulated flights through the onboard sequencer: what the recording and the truth then show."""

import math
from pathlib import Path

import numpy as np
import pytest

from daq.contract.manoeuvre import load_manoeuvre
from daq.contract.recordings.messages import SequencerFrame
from daq.contract.recordings.reading import Recording, read_recording
from daq.contract.recordings.recording import MANOEUVRE_ATTACHMENT
from daq.contract.sequencing import Exit, Reason, State
from firmware_sim.runs.flight import MANOEUVRE_FILE, prepare_flight
from firmware_sim.world.scenario import Scenario, built_in_scenarios, load_scenario

SCENARIOS = {
    "sequencer": Reason.COMPLETE,
    "sequencer_switch": Reason.SWITCH,
    "sequencer_stick": Reason.STICK,
    "sequencer_too_early": Reason.TOO_EARLY,
    "sequencer_bank": Reason.BANK,
    "sequencer_load_factor": Reason.LOAD_FACTOR,
    "sequencer_airspeed": Reason.AIRSPEED,
    "sequencer_alpha": Reason.ALPHA,
    "sequencer_height": Reason.HEIGHT,
    "sequencer_sensor_stale": Reason.SENSOR,
    "sequencer_receiver_lost": Reason.PILOT_SIGNALS,
    "sequencer_late": Reason.LATE,
    "sequencer_bus_held": Reason.CHIP,
    "sequencer_driver_gone": Reason.CHIP,
    "sequencer_heartbeat": Reason.NOT_FOLLOWED,
    "sequencer_oscillator": Reason.FREQUENCY,
    "sequencer_link": Reason.LINK,
    "sequencer_ardupilot": Reason.COMPLETE,
    "sequencer_ardupilot_mode": Reason.AUTOPILOT,
}
"""Every built-in scenario with a sequencer, and what ends its manoeuvre."""
IN_SUITE = ("sequencer_bank", "sequencer_driver_gone", "sequencer_heartbeat", "sequencer_ardupilot_mode")


def flown(scenario: Scenario, folder: Path) -> Recording:
    with prepare_flight(scenario, folder) as flight:
        flight.run()
    return read_recording(folder / "onboard")


def ended_by(recording: Recording) -> Reason:
    frames = recording.sequencer
    left = [b for a, b in zip(frames, frames[1:], strict=False) if a.state != b.state and b.state == State.RELEASED]
    return Reason(left[0].reason)


def test_every_scenario_with_a_sequencer_is_in_this_table() -> None:
    with_one = {name for name in built_in_scenarios() if load_scenario(name).sequencer is not None}
    assert with_one == set(SCENARIOS)


@pytest.mark.parametrize("name", IN_SUITE)
def test_scenario(name: str, tmp_path: Path) -> None:
    _scenario(name, tmp_path)


@pytest.mark.study
@pytest.mark.parametrize("name", sorted(set(SCENARIOS) - set(IN_SUITE) - {"sequencer", "sequencer_link"}))
def test_other_scenario(name: str, tmp_path: Path) -> None:
    _scenario(name, tmp_path)


def _scenario(name: str, folder: Path) -> None:
    recording = flown(load_scenario(name), folder)
    reason = SCENARIOS[name]
    assert ended_by(recording) is reason
    assert any(reason.words in e.text for e in recording.events if e.origin == "sequencer")
    ramped = any(f.state == State.RAMPING for f in recording.sequencer)
    assert ramped is (reason.exit is Exit.RAMP)
    _accounted(recording.sequencer)


def _accounted(frames: tuple[SequencerFrame, ...]) -> None:
    """From the first frame that beats to the last, no gap is longer than the heartbeat allows."""
    beating = [f.time_monotonic_ns for f in frames if f.beating]
    if beating:
        inside = [f.time_monotonic_ns for f in frames if beating[0] <= f.time_monotonic_ns <= beating[-1]]
        assert max((b - a for a, b in zip(inside, inside[1:], strict=False)), default=0) <= 60_000_000


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("sequencer")


@pytest.fixture(scope="module")
def recording(folder: Path) -> Recording:
    scenario = load_scenario("sequencer").altered(
        flight={"duration_s": 15.0}, sequencer={"switch": [[0.0, "off"], [2.0, "arm"], [4.0, "go"], [14.5, "off"]]}
    )
    return flown(scenario, folder)


class TestComplete:
    def test_it_is_flown_to_its_end(self, recording: Recording) -> None:
        assert ended_by(recording) is Reason.COMPLETE
        running = [f for f in recording.sequencer if f.state == State.RUNNING]
        assert len(running) == pytest.approx(501, abs=3)
        assert not any(f.limited for f in running)
        _accounted(recording.sequencer)

    def test_increments_of_the_recording_are_those_of_the_file(self, recording: Recording) -> None:
        increments = load_manoeuvre(MANOEUVRE_FILE).increments
        grid = 0.02 * np.arange(len(increments["delta_a"]))
        for f in recording.sequencer:
            if f.state == State.RUNNING:
                wanted = [np.interp(f.elapsed_us * 1e-6, grid, increments[name]) for name in ("delta_a", "delta_r")]
                assert f.increments == pytest.approx((0.0, *wanted), abs=1e-5)

    def test_the_recording_carries_the_file(self, recording: Recording) -> None:
        assert recording.info.attachments[MANOEUVRE_ATTACHMENT] == MANOEUVRE_FILE.read_bytes()

    def test_the_aircraft_moved_as_was_put_out(self, recording: Recording, folder: Path) -> None:
        """Truth of the surfaces' commands against the frames: a cycle of the driver late, and steps of 0.24 deg."""
        truth = np.genfromtxt(folder / "truth.csv", delimiter=",", names=True)
        running = [f for f in recording.sequencer if f.state == State.RUNNING][10:-5]
        times = np.array([f.time_monotonic_ns * 1e-9 for f in running])
        wanted = np.array([f.increments[2] for f in running])
        for late in (0.01, 0.02, 0.03, 0.04):
            commanded = np.interp(times + late, truth["time"], truth["cmd_r"])
            error = np.sqrt(np.mean((commanded - commanded.mean() - wanted + wanted.mean()) ** 2))
            if error < math.radians(0.25):
                return
        pytest.fail(f"rudder commanded differs by {math.degrees(error):.2f} deg rms from what was put out")

    def test_nothing_moves_without_the_section(self, tmp_path: Path) -> None:
        scenario = load_scenario("quiet").altered(flight={"duration_s": 2.0})
        recording = flown(scenario, tmp_path)
        assert recording.sequencer == ()
        with prepare_flight(scenario, tmp_path / "again") as flight:
            assert flight.assembly.actuation is None
            assert 0x41 not in flight.aircraft.bus.chips


def test_a_ground_that_is_wanted_and_silent(tmp_path: Path) -> None:
    """With nobody on the ground it does not even start."""
    recording = flown(load_scenario("sequencer_link").altered(flight={"duration_s": 8.0}), tmp_path)
    assert ended_by(recording) is Reason.LINK
    assert not any(f.state == State.RUNNING for f in recording.sequencer)


@pytest.mark.study
def test_a_ground_that_falls_silent(tmp_path: Path) -> None:
    from sideslip.chain import fly_scenario

    made = fly_scenario(load_scenario("sequencer_link"), tmp_path)
    assert any("link to the ground lost" in words for _, words in made.sequencer)
    frames = read_recording(tmp_path / "onboard").sequencer
    assert any(f.state == State.RUNNING for f in frames)
    assert any(f.state == State.RAMPING for f in frames)
