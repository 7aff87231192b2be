"""Bench recordings of an individual simulated unit, fitted: the instruments' truth comes back within its uncertainty."""

from pathlib import Path

import numpy as np
import pytest

from daq.contract.channels import CHANNEL_BY_NAME
from firmware_sim.hardware.sensing.sensor_models import SensorModels
from firmware_sim.hardware.sensing.units import calibration_truth
from firmware_sim.runs.bench_recordings import record_bench
from groundstation.calibration.bench import fit_bench, fitted_set
from groundstation.calibration.bench_plan import load_plan, parse_plan
from groundstation.calibration.calibration_set import NOMINAL_DIRECTORY, load_calibration
from groundstation.calibration.curves import fit_sphere, fit_vectors
from groundstation.calibration.schema import CalibrationError
from tests.studies.calibration_coverage import scores

UNIT = 5


def recorded(folder: Path, *names: str) -> Path:
    for name in names:
        record_bench(name, folder / name, seed=UNIT, sensors={"unit": UNIT}, calibration=NOMINAL_DIRECTORY / "cdfp")
    return folder


@pytest.fixture(scope="module")
def benches(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("bench"), "bench_angles", "bench_tunnel")


@pytest.mark.parametrize("name", ["bench_angles", "bench_tunnel"])
def test_truth_comes_back_within_the_stated_uncertainty(benches: Path, name: str) -> None:
    assert_truth_comes_back(benches, name)


@pytest.mark.study
@pytest.mark.parametrize("name", ["bench_faces", "bench_swing"])
def test_truth_of_the_triads_comes_back_within_the_stated_uncertainty(tmp_path: Path, name: str) -> None:
    """The fits themselves are tested below on made readings."""
    assert_truth_comes_back(recorded(tmp_path, name), name)


def assert_truth_comes_back(benches: Path, name: str) -> None:
    truth = calibration_truth(SensorModels().altered(unit=UNIT))
    found: list[float] = []
    for fit in fit_bench(benches / name / "onboard", load_plan(benches / name / "plan.toml")):
        found += scores(fit.instrument, truth[fit.instrument.instrument]).values()
    assert np.max(np.abs(found)) < 4.5
    assert np.sqrt(np.mean(np.square(found))) < 1.6  # the units' tolerances are tens of these sigmas


def test_fitted_files_replace_the_nominal_ones(benches: Path) -> None:
    plan = load_plan(benches / "bench_angles" / "plan.toml")
    base = load_calibration("cdfp")
    fits = fit_bench(benches / "bench_angles" / "onboard", plan, base)
    new = fitted_set(base, fits)
    vane = new.instruments["beta_vane"]
    assert vane.bench is not None
    assert len(vane.bench.sha256) == 64
    assert vane.vane == base.instruments["beta_vane"].vane  # mounting is not the bench's business
    assert vane.ratiometric is not None
    assert vane.points is not None
    assert len(vane.points.reading) == 13
    assert vane.date.isoformat() == "2026-06-01"
    assert new.instruments["pitot"] == base.instruments["pitot"]
    assert all(fit.text.startswith(fit.instrument.instrument) for fit in fits)


def test_a_pitot_curve_over_pascal_is_fitted_over_pascal(benches: Path) -> None:
    plan = load_plan(benches / "bench_tunnel" / "plan.toml")
    over_pascal = load_calibration("autopilot").texts["pitot.toml"]
    base = load_calibration("cdfp").with_texts({"pitot.toml": over_pascal})
    fits = {f.instrument.instrument: f.instrument for f in fit_bench(benches / "bench_tunnel" / "onboard", plan, base)}
    curve = fits["pitot"].curve
    assert curve is not None
    assert curve.input_unit == "Pa"
    assert curve.coefficients[1] == pytest.approx(1.0, abs=0.05)  # a curve over counts has 1.05 Pa a count, about 8191
    assert abs(curve.centre) < 2000.0


def test_plan_that_does_not_match_the_recording_says_so(benches: Path) -> None:
    raw = benches / "bench_tunnel" / "onboard"
    text = (benches / "bench_tunnel" / "plan.toml").read_text()
    late = parse_plan(text.replace("start = ", "start = 1").replace("stop = ", "stop = 1"), "late.toml")
    with pytest.raises(CalibrationError, match=r"no scans|only 0 readings"):
        fit_bench(raw, late)
    with pytest.raises(CalibrationError, match="does not fit a file of kind triad"):
        fit_bench(raw, parse_plan(text.replace('"pitot"', '"gyro"'), "x"))
    with pytest.raises(CalibrationError, match="lever: not in calibration set"):
        fit_bench(raw, parse_plan(text.replace('"pitot"', '"lever"'), "x"))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("reference = 0.1", "needs a vector"),
        ("stop = 1.0", "not after start"),
        ("speeed = 1", "speeed"),
    ],
)
def test_plan_mistakes_are_named(change: str, words: str) -> None:
    dwell = {"start": "start = 1.0", "stop": "stop = 3.0", "reference": "reference = [0.0, 0.0, -9.8]"}
    dwell[change.split(" = ", maxsplit=1)[0]] = change
    text = 'format = 1\n[[fit]]\ninstrument = "accelerometer"\nprocedure = "vectors"\n[[fit.dwell]]\n' + "\n".join(
        dwell.values()
    )
    with pytest.raises(CalibrationError, match=words):
        parse_plan(text, "plan.toml")


def test_vectors_that_do_not_span_space_are_refused(rng: np.random.Generator) -> None:
    flat = np.column_stack([rng.standard_normal((10, 2)), np.zeros(10)])
    with pytest.raises(CalibrationError, match="do not span"):
        fit_vectors(flat, flat, np.full((10, 3), 0.01), 0.01)
    with pytest.raises(CalibrationError, match="at least 5"):
        fit_vectors(flat[:4], flat[:4], np.full((4, 3), 0.01), 0.01)


def test_sphere_that_was_not_turned_enough_is_refused(rng: np.random.Generator) -> None:
    vectors = rng.standard_normal((100, 3))
    vectors /= np.linalg.norm(vectors, axis=1)[:, None]
    vectors[:, 2] *= 0.1
    with pytest.raises(CalibrationError, match="axis z saw only"):
        fit_sphere(vectors * 5e-5, 5e-5, 1e-7)


def test_scatter_of_triad_fits_is_as_they_state(rng: np.random.Generator) -> None:
    """Six faces with a wrong sensitivity and bias, and a field turned about with hard and soft iron; white noise on both."""
    sensitivity, bias = np.eye(3) + 0.02 * rng.standard_normal((3, 3)), np.array([0.3, -0.2, 0.1])
    faces = np.repeat(9.8 * np.concatenate([np.eye(3), -np.eye(3)]), 3, axis=0)
    sigma, found = 0.02, []
    for _ in range(20):
        readings = faces @ sensitivity.T + bias + sigma * rng.standard_normal(faces.shape)
        fit = fit_vectors(readings, faces, np.full(faces.shape, sigma), 0.0)
        correction = np.linalg.inv(sensitivity)
        found.append(((fit.matrix - correction) / fit.matrix_std).ravel())
        found.append((fit.bias - bias) / fit.bias_std)
    assert 0.8 < np.sqrt(np.mean(np.concatenate(found) ** 2)) < 1.2
    soft = np.array([[1.04, 0.02, 0.0], [0.02, 0.97, -0.01], [0.0, -0.01, 1.01]])
    hard, field, found = np.array([4e-6, -7e-6, 2e-6]), 5e-5, []
    for _ in range(20):
        turned = rng.standard_normal((200, 3))
        turned *= field / np.linalg.norm(turned, axis=1)[:, None]
        readings = turned @ np.linalg.inv(soft).T + hard + 2e-7 * rng.standard_normal(turned.shape)
        fit = fit_sphere(readings, field, 2e-7)
        found.append(((fit.matrix - soft) / fit.matrix_std)[np.triu_indices(3)])
        found.append((fit.bias - hard) / fit.bias_std)
    assert 0.8 < np.sqrt(np.mean(np.concatenate(found) ** 2)) < 1.2


def test_vector_fit_is_exact_without_noise(rng: np.random.Generator) -> None:
    sensitivity, bias, slope = (
        np.eye(3) + 0.01 * rng.standard_normal((3, 3)),
        rng.standard_normal(3),
        rng.standard_normal(3) * 0.01,
    )
    references, warmth = rng.standard_normal((20, 3)) * 9, rng.uniform(-10, 20, 20)
    readings = references @ sensitivity.T + bias + np.outer(warmth, slope)
    fit = fit_vectors(readings, references, np.zeros((20, 3)), 0.0, warmth)
    np.testing.assert_allclose(fit.matrix @ sensitivity, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(fit.bias, bias, atol=1e-12)
    np.testing.assert_allclose(fit.bias_per_kelvin, slope, atol=1e-12)


def test_pitot_counts_are_not_scaled_by_the_table() -> None:
    assert CHANNEL_BY_NAME["pitot_pressure"].scale is None  # the curve's input is the count itself
