"""Controls that a converter of few bits has rounded: what is known of them, and what follows for estimates and `gap`.

The right answer is known here: the course before it was measured.
"""

import numpy as np
import pytest

from estimation.engine.kernel import Array
from estimation.estimators.output_error import output_error
from estimation.gap.criteria import AS_SET
from estimation.gap.effects import catalogue
from estimation.gap.records.flight_records import prepare_flights
from estimation.gap.significance import measured_again as again
from estimation.gap.workflow import Options, run_gap
from estimation.models import load_model
from estimation.prepare.pipeline import prepare
from estimation.signals.controls import noise_between_steps
from estimation.signals.denoise import finest_noise_level, noise_level
from estimation.signals.rounding import Grid, draw_level_errors, grid_of, without_stairs
from groundstation.flight import Flight
from tests.studies import fourth_simulator as fourth
from tests.studies.gap_benchmark import outcome
from tests.unit.estimation.gap.roll import ROLL

NOISE, STEP = 0.07, 0.35  # deg, of a potentiometer before its converter, and of that
TIME = np.arange(600) / 20.0
UNIFORM = STEP / 12.0**0.5


def course(rng: np.random.Generator) -> Array:
    """(600,) a control [deg] that rests between four doublets behind a servo, and follows a slow motion."""
    time, arm, rows = np.arange(30_000) * 1e-3, 0.0, np.empty(30_000)
    wanted = 0.5 * np.sin(0.7 * time + rng.uniform(0.0, 6.3))
    for start in (3.0, 10.0, 17.0, 24.0):
        wanted += rng.uniform(2.0, 4.0) * ((time > start) & (time < start + 0.8))
        wanted -= rng.uniform(2.0, 4.0) * ((time > start + 0.8) & (time < start + 1.6))
    for k, value in enumerate(wanted):
        rows[k] = arm
        arm += 1e-3 / 0.035 * (value - arm)
    return rows[::50]


def measured(true: Array, rng: np.random.Generator, step: float = STEP) -> Array:
    return np.asarray(step * np.round((true + NOISE * rng.standard_normal(true.size)) / step))


def test_the_grid_of_a_rounded_signal_is_found() -> None:
    rng = np.random.default_rng(1)
    rounded = measured(course(rng), rng)
    grid = grid_of(rounded)
    assert grid is not None
    assert grid.step == pytest.approx(STEP)
    np.testing.assert_allclose(grid.rounded(rounded), rounded, atol=1e-12)
    with_holes = rounded.copy()
    with_holes[::7] = np.nan
    assert grid_of(with_holes) == grid
    stretched = rounded * (1.0 + 0.01 * rounded)  # by a calibration of second order
    found = grid_of(stretched)
    assert found is not None
    assert found.step == pytest.approx(STEP, rel=0.1)


@pytest.mark.parametrize(
    "values",
    [
        np.random.default_rng(1).standard_normal(600),
        np.full(50, np.nan),
        np.zeros(50),
        np.zeros(0),
        np.resize([0.0, 2.0, -2.0, 1.0, -1.0], 600),  # exact steps of a command
        np.interp(np.arange(600), np.arange(0, 601, 20), np.resize([0.0, 3.0, 3.0, -3.0, 0.0], 31)),  # exact ramps
        np.resize([0.0, 0.1, 0.25, 0.4, 0.7, 0.9, 1.3], 600),
    ],
)
def test_other_signals_have_no_grid(values: Array) -> None:
    assert grid_of(values) is None


def test_a_rounded_control_at_rest_has_the_noise_of_its_rounding() -> None:
    rng = np.random.default_rng(2)
    rounded = measured(course(rng), rng, step=0.7)
    assert np.median(np.abs(np.diff(rounded, 3))) == 0.0  # it shows none
    least = 0.7 / 12.0**0.5
    assert noise_level(rounded) == pytest.approx(least)
    assert finest_noise_level(rounded) == pytest.approx(least)
    assert noise_between_steps(rounded, np.zeros(600, bool), 0.0) >= least


def test_errors_stay_while_a_control_stays_on_a_level() -> None:
    values = np.repeat([0.0, STEP, 3 * STEP], [3, 20, 40])
    errors = np.full((63, 400), np.float32(9.0))
    draw_level_errors(errors, values, Grid(STEP, 0.0), np.random.default_rng(3))
    assert (errors[:3] == 9.0).all()  # a short stay keeps the draws of the de-noising
    for a, b in ((3, 23), (23, 63)):
        assert (errors[a:b] == errors[a]).all()
        assert np.abs(errors[a]).max() <= 0.5 * STEP
        assert np.std(errors[a]) == pytest.approx(UNIFORM, rel=0.1)
    assert abs(np.corrcoef(errors[3], errors[23])[0, 1]) < 0.2


def test_stairs_are_smoothed_only_where_samples_are_closer_than_a_servo_moves() -> None:
    stairs = np.repeat(np.arange(20.0), 3)
    np.testing.assert_array_equal(without_stairs(stairs, 0.05), stairs)
    smooth = without_stairs(stairs, 0.01)
    assert np.abs(np.diff(smooth)).max() < 0.5
    ramp = np.arange(60.0)
    np.testing.assert_allclose(without_stairs(ramp, 0.01)[2:-2], ramp[2:-2])  # neither late nor early
    holed = np.where(np.arange(60) == 30, np.nan, stairs)
    assert np.isnan(without_stairs(holed, 0.01)).sum() == 1


def rolled(step: float) -> Flight:
    rng = np.random.default_rng(4)
    true = course(rng)
    columns = {"delta_a": np.radians(measured(true, rng, step)), "p": 0.1 * rng.standard_normal(true.size)}
    return Flight.build("f", TIME, columns)


def test_a_coarsely_rounded_control_is_said_and_its_draws_have_the_size_of_its_error() -> None:
    data = prepare(ROLL, rolled(STEP))
    assert data.grids["delta_a"].step == pytest.approx(np.radians(STEP))
    (note,) = [n for n in data.notes if n.columns == ("delta_a",)]
    assert note.text == "delta_a is recorded in steps of 0.35 deg: between two it is not known"
    assert data.errors is not None
    rng = np.random.default_rng(4)
    error = np.std(data.segments[0].u[:, 0] - np.radians(course(rng)))
    assert 0.9 < np.std(data.errors[:, 0]) / error < 2.0


def test_rounding_below_the_noise_changes_nothing() -> None:
    data = prepare(ROLL, rolled(0.05))
    assert data.grids == {}
    assert not [n for n in data.notes if n.columns == ("delta_a",)]


COARSE = 0.57 * fourth.DEG


@pytest.fixture(scope="module")
def pitching() -> tuple[Flight, ...]:
    """Four flights of one aircraft whose elevator is recorded in steps of 0.57 deg."""
    flown = fourth.fly(3403, fourth.Kind(axes="longitudinal", pots=COARSE), (14.5, 16.5, 19.0, 17.0))
    assert all(grid_of(f["delta_e"]) is not None for f in flown)
    return flown


def test_bounds_of_estimates_know_a_coarsely_rounded_elevator(pitching: tuple[Flight, ...]) -> None:
    """Taken for exact, 2.4 bounds off on the average; `Cm_alpha` 3.4."""
    rng = np.random.default_rng(3403)
    truth = {n: v * (1.0 + fourth.SPREAD * rng.standard_normal()) for n, v in fourth.USUAL.items()}
    model, distances = load_model("longitudinal", "cdfp"), []
    for flight in pitching:
        estimates = output_error(model, prepare(model, flight)).parameters
        distances += [
            (e.estimate - truth[n]) / e.std_coloured
            for n, e in estimates.items()
            if n.startswith(("Cm_a", "Cm_q", "Cm_d"))
        ]
    assert len(distances) == 12
    assert np.sqrt(np.mean(np.square(distances))) < 1.6


def test_a_coarsely_rounded_elevator_is_no_late_or_sticking_one(pitching: tuple[Flight, ...]) -> None:
    """`elevator_lag` at 13.6 and `elevator_backlash` at 18.3 before."""
    model = load_model("longitudinal", "cdfp")
    result = run_gap(model, pitching[:3], pitching[3:], catalogue(model=model), Options(seed=1, nulls=20))
    assert outcome(result)["steps"] == []
    assert any("recorded in steps of 0.57 deg" in note for note in result.notes)


def test_a_control_measured_again_moves_smoothly_and_is_rounded_again(pitching: tuple[Flight, ...]) -> None:
    """From stairs, rounded again, nothing could be gained; from the flights' course something can."""
    model = load_model("longitudinal", "cdfp")
    record = prepare_flights(model, (), pitching[:1], (), AS_SET).records[0]
    rng, grid, prepared = np.random.default_rng(5), record.grids["delta_e"], record.inputs["delta_e"]
    noise = record.input_noise["delta_e"]
    true = again.course(record, "delta_e", again.smooth_control(record, "delta_e", prepared, noise), rng)
    assert np.std(np.diff(true, 3)) < 0.5 * np.std(np.diff(prepared, 3))
    assert 0.0 < np.abs(np.mean(true - prepared)) < 0.5 * grid.step
    recorded = again.measured_control(record, "delta_e", true, noise, rng)
    np.testing.assert_allclose(grid.rounded(recorded), recorded, atol=1e-12)
    assert np.std(recorded - true) == pytest.approx(noise, rel=0.15)
