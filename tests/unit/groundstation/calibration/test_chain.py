"""The whole sensor chain: simulated flight, instruments, chips, drivers, recording, calibration, against the truth."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from daq.contract.recordings.reading import read_recording
from firmware_sim.runs.flight import prepare_flight
from firmware_sim.world.scenario import load_scenario
from groundstation.calibration.apply import calibrate
from groundstation.calibration.calibration_set import NOMINAL_DIRECTORY
from groundstation.calibration.recording import calibrate_recording, embedded_calibration
from groundstation.calibration.schema import CalibrationError
from groundstation.cli.data import calibrate as calibrate_verb
from groundstation.flight import Flight, read_flight, write_flight

# column: largest mean error, and largest rms error, after the first 8 s. Biases are those the logger's power-up draws.
LIMITS = {
    "ax": (0.08, 0.09), "ay": (0.08, 0.09), "az": (0.08, 0.12), "p": (0.004, 0.012), "q": (0.004, 0.010), "r": (0.004, 0.008),
    "phi": (0.02, 0.03), "theta": (0.03, 0.03), "alpha": (0.0015, 0.007), "beta": (0.0015, 0.006), "V": (0.03, 0.20),
    "delta_e": (2e-4, 0.0015), "delta_a": (2e-4, 0.0020), "delta_r": (2e-4, 0.0020), "p_static": (1.0, 3.0),
    "p_dynamic": (0.5, 4.0), "rho": (1e-4, 3e-4), "temperature": (0.05, 0.05), "thrust": (0.02, 0.09),
    "vn": (0.1, 0.15), "ve": (0.1, 0.15),
}  # fmt: skip


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("chain")
    nominal = NOMINAL_DIRECTORY / "cdfp"
    with prepare_flight(load_scenario("rich"), folder, seed=3, calibration=nominal, duration_s=40.0) as prepared:
        prepared.run()
    return folder


@pytest.fixture(scope="module")
def flight(flown: Path) -> Flight:
    return calibrate_recording(flown / "onboard")


def test_calibrated_flight_is_unbiased(flown: Path, flight: Flight) -> None:
    truth = read_flight(flown / "truth.csv")
    assert len(flight) == len(truth)
    settled = flight.time - flight.time[0] > 8.0
    wrong = []
    for column, (mean, rms) in LIMITS.items():
        error = (flight[column] - truth[column])[settled]
        error = error[np.isfinite(error)]
        if not (error.size > 200 and abs(error.mean()) < mean and np.sqrt(np.mean(error**2)) < rms):
            wrong.append(
                f"{column}: {error.size} samples, mean {error.mean():.4g}, rms {np.sqrt(np.mean(error**2)):.4g}"
            )
    assert wrong == []


def test_alignment_takes_out_the_imu_filter(flown: Path, flight: Flight) -> None:
    """Regressed on the truth's rate of change the roll rate lags by 14 ms unaligned, by less than 2 ms aligned."""
    truth = read_flight(flown / "truth.csv")
    plain = calibrate_recording(flown / "onboard", align=False)
    slope = np.gradient(truth["p"], truth.time)

    def lag(p: np.ndarray) -> float:
        good = np.isfinite(p) & (np.abs(slope) > 0.3)
        return float(-np.sum((p - truth["p"])[good] * slope[good]) / np.sum(slope[good] ** 2))

    assert 0.010 < lag(plain["p"]) < 0.018
    assert abs(lag(flight["p"])) < 0.002
    assert flight.provenance.detail["aligned"] is True


def test_recalibrating_is_bit_exact_and_needs_only_the_file(flown: Path, flight: Flight, tmp_path: Path) -> None:
    write_flight(flight, tmp_path / "first.mcap")
    write_flight(calibrate_recording(flown / "onboard"), tmp_path / "second.mcap")
    assert (tmp_path / "first.mcap").read_bytes() == (tmp_path / "second.mcap").read_bytes()
    assert flight.provenance.source == "simulated"
    assert set(flight.provenance.calibration) == {p.name for p in (NOMINAL_DIRECTORY / "cdfp").glob("*.toml")}


def test_thinned_stream_equals_the_recording_where_both_exist(flown: Path) -> None:
    """What a 11.5 Hz downlink keeps, without the facts of the recording, unaligned: the same bits as the whole."""
    recording = read_recording(flown / "onboard")
    scans = list(recording.scans())
    kept = [s for i, s in enumerate(scans) if int(i * 0.575) != int((i - 1) * 0.575)]
    whole = calibrate_recording(flown / "onboard", align=False)
    thin = calibrate(kept, embedded_calibration(recording), align=False)
    assert thin.provenance.detail["aligned"] is False
    rows = np.flatnonzero(np.isin(whole.time, thin.time))
    assert rows.size == len(thin)
    for column in whole.columns:
        np.testing.assert_array_equal(thin[column], whole[column][rows], err_msg=column)


def test_thinned_stream_can_be_aligned_at_its_own_rate(flown: Path, flight: Flight) -> None:
    """Between samples 50 or 100 ms apart: the gyro's filter is taken out, what is left is interpolation of noise."""
    recording = read_recording(flown / "onboard")
    kept = [s for i, s in enumerate(recording.scans()) if int(i * 0.575) != int((i - 1) * 0.575)]
    thin = calibrate(kept, embedded_calibration(recording))
    assert thin.provenance.detail["aligned"] is True
    rows = np.isin(flight.time, thin.time)
    error = thin["p"] - flight["p"][rows]
    assert np.isfinite(error).mean() > 0.85
    assert np.nanstd(error) < 0.006
    plain = calibrate(kept, embedded_calibration(recording), align=False)
    assert np.nanstd(plain["p"] - flight["p"][rows]) > 1.5 * np.nanstd(error)


def test_complete_stream_without_facts_equals_the_recording_aligned(flown: Path, flight: Flight) -> None:
    recording = read_recording(flown / "onboard")
    again = calibrate(recording.scans(), embedded_calibration(recording))
    for column in flight.columns:
        np.testing.assert_array_equal(again[column], flight[column], err_msg=column)


def test_verb_writes_the_flight_and_says_what_it_did(flown: Path, tmp_path: Path) -> None:
    result = CliRunner().invoke(calibrate_verb, [str(flown / "onboard"), "-o", str(tmp_path / "f.csv")])
    assert result.exit_code == 0, result.output
    assert "20.0 Hz" in result.output
    assert "beta" in (tmp_path / "f.csv").read_text().splitlines()[0]


def test_recording_without_calibration_asks_for_one(tmp_path: Path) -> None:
    with prepare_flight(load_scenario("rich"), tmp_path, duration_s=1.5) as prepared:
        prepared.run()
    with pytest.raises(CalibrationError, match="--calibration"):
        calibrate_recording(tmp_path / "onboard")
    assert len(calibrate_recording(tmp_path / "onboard", "cdfp")) > 10
