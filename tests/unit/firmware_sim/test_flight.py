"""Whole simulated flights through the real logger: reproducible, true to the truth, and accounted for under faults."""

import csv
import errno
import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from daq.contract.recordings.accounting import verify
from daq.contract.recordings.reading import Recording, read_recording
from daq.contract.scan import SensorState
from firmware_sim.hardware.sensing.sensor_models import SensorModels
from firmware_sim.hardware.sensing.truth_log import TruthFile
from firmware_sim.runs.bench_recordings import BenchRig, Pose, SimulatedBench, bench_truth
from firmware_sim.runs.flight import START_UTC_NS, FlightFiles, prepare_flight
from firmware_sim.tables import ScenarioError
from firmware_sim.world.scenario import Scenario, load_scenario, scenario_from
from firmware_sim.world.truth import TRUTH_COLUMNS, Truth
from groundstation.calibration.calibration_set import NOMINAL_DIRECTORY
from groundstation.calibration.recording import calibrate_recording
from tests.unit.firmware_sim.truth_log import TruthLog

CALIBRATION = NOMINAL_DIRECTORY / "cdfp"


def short_flight(seconds: float = 8.0, **tables: object) -> Scenario:
    return load_scenario("rich").altered(flight={"duration_s": seconds}, **tables)


def truth_of(files: FlightFiles) -> dict[str, NDArray[np.float64]]:
    with files.truth.open(encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    return dict(zip(header, np.array(rows, float).T, strict=True))


def standing(tmp_path: Path, *lines: dict[str, object], seconds: float) -> tuple[Recording, FlightFiles, int]:
    """A recording of an aircraft that stands still, and the number of frames its radio took."""
    scenario = scenario_from({"name": "still", "faults": lines, "logger": {"recorder": {"sync": False}}}, "test")
    rig = BenchRig(SimulatedBench("still", (Pose(),), ()), SensorModels())
    with prepare_flight(scenario, tmp_path, source=rig, duration_s=seconds) as flight:
        flight.each_scan = lambda now_ns: flight.radio.ground.read() and None
        files = flight.run()
        return read_recording(tmp_path / "onboard", salvage=True), files, flight.radio.down.sent


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> FlightFiles:
    folder = tmp_path_factory.mktemp("flown")
    with prepare_flight(short_flight(20.0), folder, calibration=CALIBRATION) as flight:
        return flight.run()


@pytest.fixture(scope="module")
def errors(flown: FlightFiles) -> dict[str, NDArray[np.float64]]:
    """Calibrated columns less the truth, where both are known."""
    flight, truth = calibrate_recording(flown.folder / "onboard"), truth_of(flown)
    return {n: e[np.isfinite(e)] for n in truth if n in flight.columns for e in (flight[n] - truth[n],)}


def test_leaves_what_a_flight_leaves(flown: FlightFiles) -> None:
    recording = read_recording(flown.folder / "onboard")
    assert recording.info.source == "simulated"
    assert recording.info.details["simulation.scenario"] == "rich"
    assert recording.info.config_text
    assert verify(flown.folder / "onboard").ok
    assert flown.statistics.written == len(recording.numbers)
    assert load_scenario(flown.scenario).flight.duration_s == 20.0
    assert np.allclose(truth_of(flown)["time"], [s.time for s in recording.scans()], atol=1e-9)


def test_scans_are_on_their_deadlines(flown: FlightFiles) -> None:
    scans = list(read_recording(flown.folder / "onboard").scans())
    assert np.all(np.diff([s.time_monotonic_ns for s in scans]) == 50_000_000)
    assert {s.groups["imu"].state for s in scans} == {SensorState.OK}


# Largest tolerated standard deviation and mean of (calibrated - truth), from the instruments' noise and turn-on biases.
@pytest.mark.parametrize(
    ("column", "spread", "offset"),
    [
        ("ay", 0.06, 0.08), ("az", 0.09, 0.08), ("p", 0.010, 0.004), ("q", 0.010, 0.004), ("r", 0.007, 0.004),
        ("phi", 0.02, 0.03), ("theta", 0.02, 0.03), ("alpha", 0.006, 0.001), ("beta", 0.005, 0.001), ("V", 0.18, 0.05),
        ("delta_e", 0.0015, 3e-4), ("delta_a", 0.0020, 3e-4), ("delta_r", 0.0020, 3e-4), ("thrust", 0.06, 0.02),
        ("rho", 2e-4, 5e-5), ("p_static", 2.0, 0.5), ("temperature", 0.03, 0.01), ("vn", 0.1, 0.05), ("mx", 5e-7, 1e-7),
    ],
)  # fmt: skip
def test_calibrated_columns_are_the_truth_plus_noise(
    errors: dict[str, NDArray[np.float64]], column: str, spread: float, offset: float
) -> None:
    error = errors[column]
    assert error.size > 100
    assert abs(np.mean(error)) < offset
    assert np.std(error) < spread


def test_truth_between_grid_points_is_straight_and_headings_go_the_short_way(tmp_path: Path) -> None:
    class Turning:
        """Turns through south at 0.4 rad/s while the thrust grows at 2 N/s."""

        def advance(self, to_time: float) -> Truth:
            psi = math.remainder(math.pi - 0.1 + 0.4 * to_time, 2.0 * math.pi)
            return bench_truth(to_time, Pose(load=2.0 * to_time, attitude=(0.0, 0.0, psi)), SensorModels())

    class FullDisk:
        def writerow(self, row: list[str]) -> None:
            raise OSError(errno.ENOSPC, "No space left on device")

    log, file = TruthLog(Turning()), TruthFile(Turning(), tmp_path / "truth.csv")
    for k in range(100):
        log.advance(0.005 * k)
        file.advance(0.005 * k)
    file._writer = FullDisk()  # type: ignore[assignment]
    with pytest.raises(OSError, match=r"truth\.csv"):  # which file it was
        file.write(0.3)
    times = np.array([0.0012, 0.2488, 0.2511, 0.4])
    file.close()
    together = log.at(times)
    for i, time in enumerate(times):
        row = dict(zip(TRUTH_COLUMNS, file.at(float(time)), strict=True))
        assert row["thrust"] == pytest.approx(2.0 * time)
        assert together["thrust"][i] == pytest.approx(2.0 * time)
        for psi in (row["psi"], together["psi"][i]):
            assert math.remainder(psi - (math.pi - 0.1 + 0.4 * time), 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)


def test_scans_do_not_depend_on_how_many_are_finished_together(tmp_path: Path) -> None:
    faults = [
        {"kind": "nack", "device": "analog_a", "probability": 0.2, "start_s": 1.0, "stop_s": 2.0},
        {"kind": "power_dip", "start_s": 2.5, "stop_s": 2.52},
    ]
    made = []
    for hand_over_s in (0.0, 0.1, 0.25):
        scenario = short_flight(5.0, faults=faults, logger={"scan": {"hand_over_s": hand_over_s}})
        with prepare_flight(scenario, tmp_path / str(hand_over_s)) as flight:
            assert flight.config.scan.together == round(20 * hand_over_s) or hand_over_s == 0.0
            flight.run()
        made.append(list(read_recording(tmp_path / str(hand_over_s) / "onboard").scans()))
    assert any(scan.groups["imu"].state is SensorState.FAULT for scan in made[0])
    assert made[0] == made[1] == made[2]


def test_same_seed_same_scans_whatever_the_ground_does(tmp_path: Path) -> None:
    made = []
    for name, listens, seed in (("a", True, 3), ("b", False, 3), ("c", True, 4)):
        with prepare_flight(short_flight(3.0), tmp_path / name, seed=seed) as flight:
            if listens:
                flight.each_scan = lambda now_ns, radio=flight.radio: radio.ground.read() and None
            flight.run()
        made.append(list(read_recording(tmp_path / name / "onboard").scans()))
    assert made[0] == made[1]
    assert made[0] != made[2]


def test_gps_over_a_real_pseudo_terminal(tmp_path: Path) -> None:
    with prepare_flight(short_flight(4.0), tmp_path, gnss_port="pty") as flight:
        flight.run()
    scans = list(read_recording(tmp_path / "onboard").scans())
    fixes = [s.values for s in scans if s.values.get("gnss_fix") == 3]
    assert len(fixes) > 25
    assert {f["gnss_utc_ns"] % 100_000_000 for f in fixes} == {0}
    ages = [
        START_UTC_NS + s.time_monotonic_ns - s.values["gnss_utc_ns"] for s in scans if s.values.get("gnss_fix") == 3
    ]
    # Bytes cross the terminal in real time, scans go by in simulated time: a machine with other work delivers some late.
    assert min(ages) > 0.05e9
    assert np.quantile(ages[10:], 0.7) < 0.2e9  # the first ones had to wait for each other
    assert max(ages[10:]) < 1.0e9


def test_pulse_per_second_brings_utc_to_microseconds(tmp_path: Path) -> None:
    with prepare_flight(short_flight(8.0, sensors={"gnss": {"pulse": True}}), tmp_path) as flight:
        flight.run()
    last = list(read_recording(tmp_path / "onboard").scans())[-1]
    true = START_UTC_NS + last.time_monotonic_ns * (1.0 + 4e-6)
    assert last.utc_accuracy_ns < 1_000_000
    assert last.time_utc_ns == pytest.approx(true, abs=100_000, rel=0.0)


def test_servo_widths_from_an_autopilot(tmp_path: Path) -> None:
    capture = {"driver": "mavlink_servo", "address": None, "timeout_ms": None}
    scenario = short_flight(4.0, logger={"sensors": {"capture": capture}})
    with prepare_flight(scenario, tmp_path) as flight:
        truth = truth_of(flight.run())
    scans = list(read_recording(tmp_path / "onboard").scans())
    throttle = np.array([s.values["pwm_4"] for s in scans]) * 1e-7
    assert throttle == pytest.approx(1e-3 + 1e-3 * truth["throttle"], abs=20e-6)
    assert all("digital_1" not in s.values for s in scans)


def test_radio_carries_the_downlink_and_its_losses_are_counted(tmp_path: Path) -> None:
    with prepare_flight(short_flight(10.0, radio={"drop": 0.1}), tmp_path) as flight:
        received = bytearray()

        def listen(now_ns: int) -> None:
            received.extend(flight.radio.ground.read())

        flight.each_scan = listen
        flight.run()
        flight.clock.advance(2_000_000_000)
        listen(0)
        down = flight.radio.down
    assert down.sent == down.lost + down.delivered
    assert down.lost > 0
    assert 800 < len(received) / 10.0 < 1800


def test_an_old_recording_is_not_overwritten(tmp_path: Path) -> None:
    with prepare_flight(short_flight(1.0), tmp_path) as flight:
        flight.run()
    with pytest.raises(ScenarioError, match="already holds a recording"):
        prepare_flight(short_flight(1.0), tmp_path)


def test_stalled_card_loses_nothing_and_telemetry_goes_on(tmp_path: Path) -> None:
    recording, files, sent = standing(tmp_path, {"kind": "sd_stall", "start_s": 3.0, "stop_s": 33.0}, seconds=40.0)
    statistics = files.statistics
    assert (statistics.dropped, statistics.lost, statistics.missed) == (0, 0, 0)
    assert recording.numbers == list(range(statistics.written))
    assert statistics.queue_high_water > 25 * 20
    assert sent > 40 * 11.5
    assert verify(tmp_path / "onboard").ok


@pytest.mark.parametrize("kind", ["disk_full", "card_gone"])
def test_card_that_fails_for_a_while(tmp_path: Path, kind: str) -> None:
    """Scans wait in memory and go into a new file; none is lost, and the books say what happened."""
    recording, files, sent = standing(tmp_path, {"kind": kind, "start_s": 5.0, "stop_s": 15.0}, seconds=25.0)
    statistics = files.statistics
    assert statistics.write_errors > 0
    assert (statistics.dropped, statistics.lost, statistics.missed) == (0, 0, 0)
    assert recording.numbers == list(range(statistics.written))
    assert len(files.recordings) >= 2
    found = verify(tmp_path / "onboard")
    assert (found.written, found.dropped, found.lost) == (statistics.written, 0, 0)
    assert found.missing == ()
    assert sent > 25 * 11.5


def test_card_that_never_comes_back_is_accounted_for(tmp_path: Path) -> None:
    recording, files, sent = standing(tmp_path, {"kind": "card_gone", "start_s": 5.0}, seconds=15.0)
    statistics = files.statistics
    total = statistics.written + statistics.dropped + statistics.lost + statistics.missed
    assert total == statistics.next_number - statistics.first_number
    assert statistics.lost > 0
    assert (
        len(recording.numbers) >= (5.0 - next(iter(recording.scans())).time - 2.2) * 20
    )  # a flush, and what the writer may lag
    assert sent > 15 * 11.5


def test_sensor_fault_of_a_scenario_reaches_file_and_words(tmp_path: Path) -> None:
    line = {"kind": "absent", "device": "pitot", "start_s": 2.0, "stop_s": 4.0}
    recording, _, _ = standing(tmp_path, line, seconds=8.0)
    gone = [s for s in recording.scans() if 2.2 < s.time < 4.0]
    assert {s.groups["pitot"].state for s in gone} == {SensorState.ABSENT}
    words = [entry.message for entry in recording.log]
    assert any("differential pressure: absent" in text for text in words)


def test_event_switch_of_the_pilot_is_marked(tmp_path: Path) -> None:
    with prepare_flight(short_flight(12.0), tmp_path) as flight:
        truth = truth_of(flight.run())
    presses = np.count_nonzero(np.diff(truth["digital_1"]) > 0.5)
    events = read_recording(tmp_path / "onboard").events
    assert presses > 0
    assert len([e for e in events if e.origin == "switch"]) == pytest.approx(presses, abs=1)
