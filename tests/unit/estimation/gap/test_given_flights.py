"""A stranger's flights: controls logged more rarely than the motion, channels that an import drew, one record twice."""

from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import sideslip
from estimation.engine.kernel import Array
from estimation.errors import DataError
from estimation.gap.criteria import AS_SET
from estimation.gap.decision.location import spans_of
from estimation.gap.effects import catalogue
from estimation.gap.records.channels import doubts_of, refuse_twice
from estimation.gap.records.flight_records import prepare_flights, unseen_paths
from estimation.gap.records.sampling import (
    at_own_rates,
    clock_step,
    find_slow_control,
    unseen_moves,
    with_lost_rows,
    without_unseen_moves,
)
from estimation.gap.significance.omnibus import restless_times
from estimation.gap.workflow import Options, run_gap
from estimation.models.load import load_model
from groundstation.flight import RECONSTRUCTED, Flight, Provenance, write_flight
from groundstation.flight.quality.repeats import one_record_twice
from sideslip.verbs.gap import gap as gap_verb
from tests.studies import second_truth as truth
from tests.studies.gap_benchmark import flights, requests

COUNT = 600
TIME: Array = np.arange(COUNT) / 50.0
Drawn = Callable[[Array, int], Array]


def noisy(seed: int, count: int = COUNT) -> Array:
    """A pot on a surface that moves slowly."""
    return 0.1 * np.sin(0.05 * np.arange(count)) + 0.002 * np.random.default_rng(seed).standard_normal(count)


def empty(values: Array, every: int) -> Array:
    return np.where(np.arange(values.size) % every == 0, values, np.nan)


def held(values: Array, every: int) -> Array:
    return values[np.arange(values.size) // every * every]


def lines(values: Array, every: int) -> Array:
    at = np.arange(values.size)
    return np.interp(at, at[::every], values[::every])


def between(values: Array, every: int) -> Array:
    """Lines whose ends lie between samples, as an import draws them."""
    at = np.arange(values.size)
    return np.interp(at, at[::every] + 0.4, values[::every])


def coarse(values: Array) -> Array:
    step = np.ptp(values) / 32 or 1.0
    return np.round(values / step) * step


def named(name: str, columns: Mapping[str, Array], provenance: Provenance | None = None) -> Flight:
    return Flight.build(name, TIME, columns, provenance=provenance)


def built(**columns: Array) -> Flight:
    return named("f", columns)


@pytest.mark.parametrize("drawn", [empty, held, lines, between])
@pytest.mark.parametrize("every", [3, 5])
def test_a_control_logged_more_rarely_than_the_motion_is_read_at_its_own_rate(drawn: Drawn, every: int) -> None:
    given = built(delta_a=drawn(noisy(1), every), p=noisy(2), beta=noisy(3))
    (read,) = at_own_rates([given], ["delta_a"], ["p", "beta"], AS_SET)
    assert read.sample_interval == pytest.approx(0.02 * every)
    assert np.isfinite(read["delta_a"]).sum() >= len(read) - 1
    assert set(read["p"]) <= set(given["p"])
    assert f"values of delta_a come at {50 / every:.3g} Hz only" in read.notes[-1].text


def test_its_values_are_those_that_were_measured() -> None:
    whole = noisy(1)
    for drawn in (empty, held, lines, between):
        (read,) = at_own_rates([built(delta_a=drawn(whole, 5), p=noisy(2))], ["delta_a"], ["p"], AS_SET)
        np.testing.assert_allclose(read["delta_a"][1:-1], whole[::5][1:-1], atol=1e-12)


def test_a_control_that_is_new_in_every_sample_is_left_as_it_is() -> None:
    rng = np.random.default_rng(4)
    steps = np.where(TIME % 2.0 < 1.0, 0.1, -0.1)
    ramps = np.interp(TIME, np.cumsum(rng.uniform(0.2, 1.5, 20)), rng.standard_normal(20))
    holes = np.where(rng.uniform(size=COUNT) < 0.3, np.nan, noisy(1))
    coarse = np.round(noisy(1) / 0.02) * 0.02
    for values in (noisy(1), steps, ramps, holes, coarse, 0.1 * np.sin(TIME), np.zeros(COUNT)):
        given = built(delta_a=values, p=noisy(2))
        assert at_own_rates([given], ["delta_a"], ["p"], AS_SET) == (given,)


@pytest.mark.parametrize(("hz", "thinned"), [(40.0, False), (25.0, True)])
def test_what_an_import_says_of_its_log_counts_where_the_samples_do_not_show_it(hz: float, thinned: bool) -> None:
    """Half the rate of the samples, ends between them: no three samples lie on one line."""
    about = Provenance(detail={"native_hz": {"delta_a": hz}})
    (read,) = at_own_rates([named("f", {"delta_a": noisy(1), "p": noisy(2)}, about)], ["delta_a"], ["p"], AS_SET)
    assert (len(read) < COUNT) is thinned


@pytest.mark.parametrize(
    "stated", ["fast", {"delta_a": "x"}, {"delta_a": 0.0}, {"delta_a": 1e-300}, {"delta_a": np.nan}]
)
def test_what_cannot_be_a_rate_counts_for_nothing(stated: object) -> None:
    given = named("f", {"delta_a": noisy(1), "p": noisy(2)}, Provenance(detail={"native_hz": stated}))
    assert at_own_rates([given], ["delta_a"], ["p"], AS_SET) == (given,)


def test_a_column_that_nobody_asks_for_decides_nothing() -> None:
    given = built(delta_a=empty(noisy(1), 5), p=noisy(2), vn=np.roll(empty(noisy(3), 50), 2))
    assert len(at_own_rates([given], ["delta_a"], ["p"], AS_SET)[0]) == COUNT // 5


def test_a_hole_in_a_slow_control_stays_one() -> None:
    values = empty(noisy(1), 5)
    values[200:260] = np.nan
    found = find_slow_control(built(delta_a=values, p=noisy(2)), "delta_a")
    assert found is not None
    assert np.isnan(found.values[200:256]).all()
    assert np.isfinite(found.values[:196]).all()


def test_sensors_keep_their_own_new_values_and_none_is_lost_to_the_control() -> None:
    rare = empty(noisy(3), 5)
    odd = np.roll(rare, 2)
    (read,) = at_own_rates([built(delta_a=empty(noisy(1), 5), beta=rare)], ["delta_a"], ["beta"], AS_SET)
    assert np.isfinite(read["beta"]).all()
    assert len(read) == COUNT // 5
    given = built(delta_a=empty(noisy(1), 5), beta=odd)
    assert len(at_own_rates([given], ["delta_a"], ["beta"], AS_SET)[0]) == COUNT


def test_an_output_is_compared_at_the_ends_of_drawn_lines_only() -> None:
    whole = noisy(3)
    (read,) = at_own_rates([built(delta_a=noisy(1), beta=lines(whole, 5))], ["delta_a"], ["beta"], AS_SET)
    seen = np.isfinite(read["beta"])
    assert seen.sum() == pytest.approx(COUNT / 5, abs=2)
    np.testing.assert_allclose(read["beta"][seen], whole[seen])
    assert "beta lies on straight lines between values at 10 Hz" in read.notes[-1].text


def motion(seed: int) -> dict[str, Array]:
    return {c: noisy(10 * seed + k) for k, c in enumerate(("p", "r", "phi", "beta", "ay"))}


def test_one_record_given_twice_is_refused() -> None:
    one, two = named("one", motion(1)), named("two", motion(2))
    again = named("again", {c: v.astype(np.float32) for c, v in motion(1).items()})
    half = named("half", motion(1)).part(slice(250, 600), "half")
    assert one_record_twice([one, two]) is None
    assert one_record_twice([two, one, half]) == (1, 2)
    with pytest.raises(DataError, match="again is of the same record as one: give every flight once"):
        refuse_twice([one, again, two], [])
    with pytest.raises(DataError, match="half, held out, is of the same record as one"):
        refuse_twice([one, two], [half])


def test_a_copy_with_fewer_digits_and_a_clock_of_its_own_is_the_same_record() -> None:
    """A second export of one flight had been taken for another, and confirmed what the first had shown."""
    one = named("one", motion(1))
    copy = Flight.build("copy", TIME + 1000.0, {c: np.round(v, 6) for c, v in motion(1).items()})
    assert one_record_twice([one, named("two", motion(2)), copy]) == (0, 2)
    other = Flight.build("other", TIME, {c: v + 2e-3 * noisy(9) for c, v in motion(1).items()})
    assert one_record_twice([one, other]) is None, "a tenth of the noise apart"


@pytest.mark.filterwarnings("error")
def test_a_simulation_that_ran_away_is_compared_without_a_word() -> None:
    """Its values beyond single precision had shown the user an overflow before the sentence on what is wrong with them."""
    away = {c: np.where(np.arange(COUNT) < COUNT - 20, v, 1e300) for c, v in motion(1).items()}
    assert one_record_twice([named("one", away), named("two", motion(2))]) is None
    assert one_record_twice([named("one", away), named("two", motion(2)), named("again", away)]) == (0, 2)


def test_aircraft_at_rest_and_flights_that_begin_alike_are_not_one_record() -> None:
    rest = {c: np.full(COUNT, 0.01) for c in motion(1)}
    assert one_record_twice([named("one", rest), named("two", rest)]) is None
    begun = {c: np.concatenate([motion(1)[c][:100], motion(2)[c][100:]]) for c in motion(1)}
    assert one_record_twice([named("one", motion(1)), named("two", begun)]) is None


def test_a_channel_of_another_unit_is_told_where_the_model_needs_it() -> None:
    size = {"ax": 0.0, "ay": 0.0, "az": -1.0}
    given = named("f", {c: v + 0.01 * noisy(k) for k, (c, v) in enumerate(size.items())})
    (told,) = doubts_of([given], load_model("lateral", "cdfp"))
    assert told.startswith("f: ax, ay, az: the median specific force")
    assert "are ax, ay, az in g?" in told
    assert doubts_of([built(p=noisy(1), psi=np.full(COUNT, 7.0))], load_model("lateral", "cdfp")) == []


def test_air_data_that_nobody_measured_are_told() -> None:
    about = Provenance(detail={RECONSTRUCTED: {"columns": ["alpha", "beta", "V"]}})
    columns = {c: noisy(k) for k, c in enumerate(("alpha", "beta", "V", "p", "ay"))}
    lateral = load_model("lateral", "cdfp")
    (told,) = doubts_of([named("f", columns, about)], lateral)
    assert told.startswith("f: alpha, beta, V not measured but found from the motion")
    sure = {f"{c}_std": np.full(COUNT, 0.02) for c in ("alpha", "beta", "V")}
    assert doubts_of([named("f", {**columns, **sure}, about)], lateral) == []


# What a servo seen too rarely looks like; all are asked by the benchmark.
NEAR = ("servo_lag", "servo_delay", "rudder_lag", "rudder_delay", "aileron_lag", "Cn_da", "Cl_betadot", "beta_lag")


@pytest.fixture(scope="module")
def flown() -> list[dict[str, Array]]:
    """Columns of three flights and one to hold out with nothing hidden."""
    return truth.fly(requests({}, 7112, 0.15, "rich"))


def test_flights_with_servos_at_half_the_rate_have_nothing_hidden(flown: list[dict[str, Array]]) -> None:
    """Servos at 10 Hz in flights of 20 Hz, drawn as lines, had given `servo_lag` at 1.7 times its threshold."""
    four = flights(
        [{n: lines(np.asarray(v), 2) if n.startswith("delta") else v for n, v in one.items()} for one in flown]
    )
    model = load_model("lateral", "cdfp")
    near = [e for e in catalogue(model=model) if e.name in NEAR]
    result = run_gap(model, four[:3], four[3:], near, Options(seed=1, nulls=20))
    assert result.verdict.value == "no_gap"
    assert any("the flight is read at 10 Hz" in note for note in result.notes)


def test_flights_too_coarse_for_their_noise_to_be_taken_off_everywhere_are_answered(
    flown: list[dict[str, Array]],
) -> None:
    """Every channel of 5 bits: the noise of the ailerons is found on one flight and not on the next, which had ended in a
    KeyError."""
    four = flights([{n: v if n == "time" else coarse(np.asarray(v)) for n, v in one.items()} for one in flown])
    model = load_model("lateral", "cdfp")
    near = [e for e in catalogue(model=model) if e.name in NEAR[:2]]
    assert run_gap(model, four[:3], four[3:], near, Options(seed=1, nulls=20)).verdict


@pytest.mark.parametrize("finer", [1, 2])
def test_lost_rows_are_put_back_as_not_measured(finer: int) -> None:
    """A third of the rows, or all but every second or third of them as where 11.5 Hz are read from 20."""
    rng = np.random.default_rng(2)
    kept = (
        rng.random(COUNT) > 1 / 3
        if finer == 1
        else np.isin(np.arange(COUNT), np.arange(0, COUNT, 20 / 11.5).astype(int))
    )
    kept[[0, -1]] = True
    kept[300:320] = False
    given = built(p=noisy(1), beta=noisy(2)).part(kept)
    assert clock_step(given) == pytest.approx(0.02)
    read = with_lost_rows(given)
    at = np.round(read.time / 0.02).astype(int)
    np.testing.assert_allclose(read.time, TIME[at], atol=1e-9)
    assert np.array_equal(np.isfinite(read["p"]), kept[at])
    np.testing.assert_array_equal(read["beta"][kept[at]], given["beta"])
    assert len(read.segments) == 1 + np.sum(np.diff(np.flatnonzero(kept)) > 4) > 1  # more than three in a row are a gap
    assert "rows lost here and there" in read.notes[-1].text


def test_a_flight_whose_sensors_were_not_brought_to_one_time_says_so() -> None:
    """As the ground has it after a radio that sent every second scan: a vane 9 ms late had been `vane_position`."""
    model = load_model("lateral", "cdfp")
    for aligned in (True, False):
        given = Flight.build("f", TIME, {"p": noisy(1)}, provenance=Provenance(detail={"aligned": aligned}))
        told = doubts_of([given], model)
        assert len(told) == (0 if aligned else 1)
    assert "sampled some ms apart" in told[0]


def test_flights_of_one_name_are_told_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A ground station writes each as `flight`, and the answer said that 'flight and flight' do not repeat the others."""
    paths = []
    for k in range(3):
        paths.append(tmp_path / str(k) / "flight.csv")
        paths[-1].parent.mkdir()
        write_flight(named("flight", {"p": noisy(k)}), paths[-1])
    seen: list[str] = []

    def looked_at(model: object, training: list[Flight], holdout: list[Flight], *rest: object, **more: object) -> None:
        seen.extend([*(f.name for f in training), *(f.name for f in holdout)])
        raise DataError("seen")

    monkeypatch.setattr("estimation.gap.workflow.run_gap", looked_at)
    command = [*map(str, paths[:2]), "--holdout", str(paths[2]), "--aircraft", "cdfp", "--nulls", "20"]
    assert "seen" in str(CliRunner().invoke(gap_verb, command).exception)
    with pytest.raises(DataError, match="seen"):
        sideslip.gap("lateral", paths[:2], paths[2:], aircraft="cdfp")
    assert seen == 2 * ["flight", "flight#2", "flight#3"]


@pytest.mark.parametrize("after", [[], ["--aircraft", "cdfp"]])
def test_holdout_without_a_flight_after_it_is_a_mistake(after: list[str]) -> None:
    """It had been passed over: an empty pattern of the shell, and nothing was held out."""
    answer = CliRunner().invoke(gap_verb, ["f0.csv", "f1.csv", "--holdout", *after])
    assert answer.exit_code == 2
    assert "--holdout has no flight after it" in answer.output


def stepping(seed: int) -> Array:
    """A surface that goes up and down again, and its pot."""
    course = np.where((np.arange(COUNT) >= 100) & (np.arange(COUNT) < 200), 0.1, 0.0)
    return course + 0.002 * np.random.default_rng(seed).standard_normal(COUNT)


def test_a_control_is_unseen_where_it_lacks_samples_and_moves() -> None:
    control = stepping(5)
    control[[50, 99, 150, 200, 201]] = np.nan  # at rest, before a step up, at rest, through a step down
    control[300:310] = np.nan  # no few in a row: a gap
    control[[0, -1]] = np.nan
    assert np.flatnonzero(unseen_moves(control, AS_SET)).tolist() == [99, 200, 201]
    paths = unseen_paths(control, 4000, np.random.default_rng(6), AS_SET)
    assert np.flatnonzero(np.abs(paths).max(axis=0)).tolist() == [99, 200, 201]
    # the step is in the first or in the second interval: half of it up or down, as often
    np.testing.assert_allclose(np.abs(paths[:, 99]), 0.5 * abs(control[100] - control[98]), rtol=1e-12)
    assert np.mean(paths[:, 99] > 0.0) == pytest.approx(0.5, abs=0.05)
    # through two samples: over neither, one, or both of them, each a third of the time, and one path for both
    down = control[202] - control[199]
    np.testing.assert_allclose(np.unique(np.round(paths[:, 200] / down, 9)), [-1 / 3, 2 / 3])
    assert np.mean(paths[:, 200] / down > 0.0) == pytest.approx(1 / 3, abs=0.05)
    assert np.mean(paths[:, 201] / down > 0.0) == pytest.approx(2 / 3, abs=0.05)
    assert not ((paths[:, 200] / down > 0.0) & (paths[:, 201] / down < 0.0)).any()


def test_nothing_is_compared_where_a_control_moves_unseen() -> None:
    control = stepping(5)
    control[[50, 99]] = np.nan
    given = built(delta_a=control, p=noisy(1), beta=noisy(2))
    read = without_unseen_moves(given, ["delta_a", "delta_r"], ["p", "beta", "r"], AS_SET)
    for column in ("p", "beta"):
        assert np.flatnonzero(np.isnan(read[column])).tolist() == [99]
    assert read.notes[-1].text == "delta_a not measured at 1 samples while it moved: nothing is compared there"
    assert without_unseen_moves(given, ["p"], ["beta"], AS_SET) is given


@pytest.mark.parametrize("lost", [pytest.param("elevator", marks=pytest.mark.study), "rows"])
def test_a_third_of_an_elevators_samples_lost_is_nothing(lost: str) -> None:
    """Straight lines across them had made it swing, or late."""
    made = []
    for columns in truth.fly(requests({}, 31, 0.15, "longitudinal")):
        absent = np.random.default_rng(31).random(columns["time"].size) < 0.3
        absent[[0, -1]] = False
        some = {"delta_e": np.where(absent, np.nan, columns["delta_e"])}
        made.append(columns | some if lost == "elevator" else {n: v[~absent] for n, v in columns.items()})
    given = flights(made)
    model = load_model("longitudinal", "cdfp")
    prepared = prepare_flights(model, (), given, (), AS_SET)
    assert prepared.records[0].errors["delta_e"].std() > 0.0
    near = [
        e for e in catalogue(model=model) if e.name.startswith(("elevator", "Cm_")) or e.name in ("alpha_lag", "gust")
    ]
    assert run_gap(model, given[:3], given[3:], near, Options(seed=1, nulls=20)).verdict == "no_gap"


def test_rows_on_no_grid_and_whole_flights_are_left_as_they_are() -> None:
    whole = built(p=noisy(1))
    assert with_lost_rows(whole) is whole
    rng = np.random.default_rng(3)
    late = Flight.build("late", TIME + rng.uniform(-0.002, 0.002, COUNT), {"p": noisy(1)})
    assert with_lost_rows(late) is late
    uneven = Flight.build("uneven", np.sort(TIME + rng.uniform(-0.006, 0.006, COUNT)), {"p": noisy(1)})
    assert with_lost_rows(uneven) is uneven
    (told,) = doubts_of([uneven], load_model("lateral", "cdfp"))
    assert told.startswith("uneven: its rows are 1")
    assert "give even times" in told
    assert doubts_of([late], load_model("lateral", "cdfp")) == []
    rounded = Flight.build("rounded", np.round(np.arange(COUNT) / 30.0, 2), {"p": noisy(1)})  # 30, 30, 40 ms
    assert with_lost_rows(rounded) is rounded
    (told,) = doubts_of([rounded], load_model("lateral", "cdfp"))
    assert "30 to 40 ms" in told


def test_a_stretch_shorter_than_a_window_of_energy_is_one_window() -> None:
    """Lost rows leave stretches of half a second: looking for restless times in one had ended in a ValueError."""
    model = load_model("lateral", "cdfp")
    rng = np.random.default_rng(4)
    series = [rng.standard_normal((n, len(model.outputs), 1 + 40)) for n in (600, 9)]
    series[1][:, 2, 0] *= 30.0
    problem: Any = SimpleNamespace(
        criteria=AS_SET,
        model=model,
        coarse=[SimpleNamespace(time=0.05 * np.arange(len(s))) for s in series],
        records=[SimpleNamespace(flight=k) for k in range(2)],
    )
    signals, largest = restless_times(problem, series, 40)
    worst = max(signals, key=lambda s: s.score)
    assert (worst.flight, worst.span) == (1, (0.0, pytest.approx(0.4)))
    assert worst.score > 2.0 * largest.max()


def test_where_an_effect_shows_may_be_a_stretch_shorter_than_what_it_is_smoothed_over() -> None:
    time = 0.05 * np.arange(9)
    assert spans_of(time, np.ones(9), AS_SET) == [(0.0, pytest.approx(0.4))]


def test_accelerometers_behind_a_filter_of_their_own_are_late_and_not_the_gyros() -> None:
    """An autopilot filters its accelerometers more slowly than its gyros."""
    late = 0.03
    made = [
        columns | {"ay": np.interp(columns["time"] - late, columns["time"], columns["ay"])}
        for columns in truth.fly(requests({}, 7731, 0.15, "rich"))
    ]
    given, model = flights(made), load_model("lateral", "cdfp")
    near = [
        e for e in catalogue(model=model) if e.name in ("time_skew", "servo_lag", "beta_lag", "CY_da", "Cn_betadot")
    ]
    result = run_gap(model, given[:3], given[3:], near, Options(seed=1, nulls=20))
    assert [(s.effect, s.form) for s in result.steps] == [("time_skew", "accelerometers")]
    value, bound = result.steps[0].estimates["time_skew_accelerometers"]
    assert abs(value - late) < 3.0 * bound + 0.005  # straight lines through samples 50 ms apart take some of it
