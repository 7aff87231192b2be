"""Sensors beside those of the CDFP, at register level through bus, logger, recording and calibration, with their faults."""

import csv
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daq.contract.recordings.reading import read_recording
from daq.contract.scan import SensorState
from firmware_sim.hardware.registers.as5600 import As5600Chip
from firmware_sim.hardware.registers.sdp3x import Sdp3xChip
from firmware_sim.runs.flight import SimulatedFlightRun, prepare_flight
from firmware_sim.world.scenario import load_scenario
from groundstation.calibration.calibration_set import NOMINAL_DIRECTORY
from groundstation.calibration.recording import calibrate_recording
from groundstation.calibration.schema import CalibrationError

SECOND = 1_000_000_000
FITTED = {
    "pitot": {"driver": "sdp3x", "address": 0x21, "output": "A"},
    "vane_alpha": {"address": 0x36},
    "vane_beta": {"address": 0x37},
}
IMU = {"driver": "icm42688", "accel_lowpass_hz": 12.5, "gyro_lowpass_hz": 12.5}
ENCODERS = ("pitot.toml", "alpha_vane.toml", "beta_vane.toml")


def calibration_in(folder: Path) -> Path:
    """The CDFP's set with curves of the other sensors in it."""
    mixed = folder / "calibration"
    shutil.copytree(NOMINAL_DIRECTORY / "cdfp", mixed)
    for name in ENCODERS:
        shutil.copy(NOMINAL_DIRECTORY / "autopilot" / name, mixed / name)
    return mixed


def flight_in(folder: Path, sensors: dict[str, Any], calibration: Path, duration_s: float = 15.0) -> SimulatedFlightRun:
    scenario = load_scenario("rich").altered(flight={"duration_s": duration_s, "seed": 12}, logger={"sensors": sensors})
    return prepare_flight(scenario, folder / "flight", calibration=calibration)


def truth_of(folder: Path, column: str) -> np.ndarray:
    with (folder / "flight" / "truth.csv").open() as file:
        return np.array([float(row[column]) for row in csv.DictReader(file)])


def test_thermal_pitot_and_magnetic_vanes_measure_the_flight(tmp_path: Path) -> None:
    with flight_in(tmp_path, FITTED, calibration_in(tmp_path)) as run:
        run.run()
    flight = calibrate_recording(tmp_path / "flight" / "onboard")
    for column, limit in (("V", 0.1), ("alpha", 0.008), ("beta", 0.007)):
        error = flight.columns[column] - truth_of(tmp_path, column)[: len(flight.time)]
        assert np.isfinite(error).mean() > 0.98, column
        assert np.sqrt(np.nanmean(error**2)) < limit, (column, np.sqrt(np.nanmean(error**2)))
        assert abs(np.nanmean(error)) < limit / 4, (column, np.nanmean(error))


@pytest.mark.parametrize(
    ("pitot", "static"),
    [
        ({"driver": "dlvr", "chip": "l20d", "address": 0x28}, {"driver": "bmp581", "address": 0x47}),
        ({"driver": "ms5525", "address": 0x77}, {"driver": "bmp581", "address": 0x46, "rate_hz": 100}),
    ],
)
def test_other_pitots_barometer_and_imu_measure_the_flight(
    tmp_path: Path, pitot: dict[str, Any], static: dict[str, Any]
) -> None:
    mixed = tmp_path / "calibration"
    shutil.copytree(NOMINAL_DIRECTORY / "cdfp", mixed)
    shutil.copy(NOMINAL_DIRECTORY / "autopilot" / "pitot.toml", mixed / "pitot.toml")
    sensors = {"pitot": pitot, "static": static, "imu": IMU, "mag": None}
    away = {"kind": "absent", "device": "static", "start_s": 5.0, "stop_s": 6.0}
    scenario = load_scenario("rich").altered(
        flight={"duration_s": 12.0, "seed": 31}, logger={"sensors": sensors}, faults=[away]
    )
    with prepare_flight(scenario, tmp_path / "flight", calibration=mixed) as run:
        run.run()
        assert run.assembly.sampler.health().ready
    flight = calibrate_recording(tmp_path / "flight" / "onboard")
    gone = (flight.time > flight.time[0] + 4.2) & (flight.time < flight.time[0] + 7.0)
    for column, limit in (("V", 0.15), ("p_static", 12.0), ("p", 0.02), ("q", 0.02), ("az", 0.3)):
        error = (flight.columns[column] - truth_of(tmp_path, column)[: len(flight.time)])[~gone]
        assert np.isfinite(error).mean() > 0.97, column
        assert np.sqrt(np.nanmean(error**2)) < limit, (column, np.sqrt(np.nanmean(error**2)))
    assert np.isnan(flight.columns["p_static"][gone]).any()


def test_counts_of_another_pitot_are_refused(tmp_path: Path) -> None:
    with flight_in(tmp_path, FITTED, NOMINAL_DIRECTORY / "cdfp", 3.0) as run:
        run.run()
    with pytest.raises(CalibrationError, match=r"pitot is a curve over counts of 1.05 Pa, and the sensor .* 0.05 Pa"):
        calibrate_recording(tmp_path / "flight" / "onboard")


def test_faults_of_chips_are_named_and_put_right(tmp_path: Path) -> None:
    with flight_in(tmp_path, FITTED, calibration_in(tmp_path), 14.0) as run:
        chips = run.aircraft.bus.chips
        pitot, alpha, beta = chips[0x21], chips[0x36], chips[0x37]
        assert isinstance(pitot, Sdp3xChip)
        assert isinstance(alpha, As5600Chip)
        assert isinstance(beta, As5600Chip)
        origin = run.clock.monotonic_ns()
        alpha.field_mt = lambda now_ns: 3.0 if 4 * SECOND < now_ns - origin < 7 * SECOND else 50.0
        done = []

        def each(now_ns: int) -> None:
            seconds = (now_ns - origin) / SECOND
            pitot.broken_bit = 3 if 8.0 < seconds < 10.0 else None
            if seconds > 11.0 and not done:
                done.append(beta.upset())

        run.each_scan = each
        run.run()
        summary = run.assembly.sampler.health()
    assert summary.group("vane_beta").upsets == 1
    assert summary.ready
    states: dict[str, set[tuple[int, SensorState]]] = {"vane_alpha": set(), "pitot": set(), "vane_beta": set()}
    first = None
    for scan in read_recording(tmp_path / "flight" / "onboard").scans():
        first = scan.time if first is None else first
        for group, found in states.items():
            found.add((int(scan.time - first), scan.groups[group].state))
    assert (5, SensorState.OUT_OF_RANGE) in states["vane_alpha"]
    assert (5, SensorState.OK) not in states["vane_alpha"]
    assert (8, SensorState.OK) in states["vane_alpha"]
    assert {s for t, s in states["pitot"] if t in (8, 9)} & {SensorState.ABSENT, SensorState.FAULT}
    assert (12, SensorState.OK) in states["pitot"]
    assert (12, SensorState.OK) in states["vane_beta"]
