"""Samples that were not measured: a channel that holds its values, noise and nulls where a part of a channel is missing."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.gap.answer.result import Gap
from estimation.gap.answer.shape import HeldInstrument
from estimation.gap.answer.words import describe_step
from estimation.gap.criteria import AS_SET
from estimation.gap.decision.unnamed import held_instrument, held_step
from estimation.gap.fit.baseline import fit_baseline
from estimation.gap.fit.noise import NoisePart, NoiseSource, Shapes, as_seen, channel_noise, estimate_noise, whitener
from estimation.gap.fit.whitener import spectrum_of
from estimation.gap.records.candidate_model import with_nuisance
from estimation.gap.records.flight_records import command_times, prepare_flights
from estimation.gap.records.sampling import flown_apart
from estimation.gap.significance.instruments import late_commands
from estimation.gap.workflow import Options, run_gap
from estimation.models.load import load_model
from groundstation.flight import Flight, Provenance
from tests.studies import fourth_simulator as fourth
from tests.studies import second_truth as truth
from tests.unit.estimation.gap.candidates_by_hand import stub

COUNT, STEP = 1200, 0.05
GUST = NoisePart(NoiseSource.RATE, "p")


def shapes() -> Shapes:
    """Two outputs, of which the second also shows a slow motion that one gust makes."""
    s = 2j * np.pi * np.fft.rfftfreq(COUNT, STEP)
    slow = 4.0 / (s + 4.0)
    return Shapes({GUST: np.column_stack([np.zeros_like(slow), slow])}, COUNT, STEP)


def residuals(rng: np.random.Generator, held: int) -> np.ndarray:
    """Noise of 2 and 3 and motion of strength 4; the first output new every `held` samples only."""
    white = np.fft.rfft(rng.standard_normal(COUNT)) * 2.0
    gust = np.fft.irfft(white * shapes().parts[GUST][:, 1], n=COUNT)
    made = rng.standard_normal((COUNT, 2)) * (2.0, 3.0) + np.column_stack([np.zeros(COUNT), gust])
    made[np.arange(COUNT) % held != 0, 0] = np.nan
    return made


@pytest.mark.parametrize("held", [1, 2, 6])
def test_the_noise_of_a_channel_is_known_from_the_samples_it_has(held: int) -> None:
    rng = np.random.default_rng(3)
    records = [residuals(rng, held) for _ in range(6)]
    seen = [as_seen(shapes(), np.isfinite(r)) for r in records]
    found = estimate_noise(records, seen, np.full(2, 5.0), np.full(2, 1e-3))
    assert np.sqrt(found.measurement) == pytest.approx([2.0, 3.0], rel=0.06)
    energy = [whitener(found, s).energy(r) for s, r in zip(seen, records, strict=True)]
    assert np.mean(energy) == pytest.approx(2 * COUNT, rel=0.03)  # zeros and all: the mean power is that of the matrix
    rows = whitener(found, seen[0]).strict(spectrum_of(records[0]))[:, 0]
    assert rows @ rows == pytest.approx(energy[0])


def test_a_channel_measured_in_a_part_is_seen_in_a_part() -> None:
    measured = np.ones((COUNT, 2), bool)
    one = replace(shapes(), louder=np.array([1.0, 2.0]))
    assert as_seen(one, measured) is one
    measured[:300, 1] = False
    part = as_seen(one, measured)
    assert part.louder == pytest.approx([1.0, 1.5])
    np.testing.assert_allclose(part.parts[GUST], one.parts[GUST] * (1.0, 0.75))


def test_a_channel_that_was_never_measured_shows_nothing() -> None:
    measured = np.ones((COUNT, 2), bool)
    measured[:, 1] = False
    absent = as_seen(replace(shapes(), louder=np.array([1.0, 2.0])), measured)
    assert absent.louder == pytest.approx([1.0, 2.0])
    assert not absent.parts[GUST].any()


@pytest.mark.parametrize("column", ["ax", "az"])
def test_flights_without_a_channel_are_fitted_like_a_model_without_its_output(column: str) -> None:
    kind = fourth.Kind(axes="longitudinal", gust=0.3 * fourth.DEG, duration=15.0)
    flights = [without(f, column) for f in fourth.fly(7, kind, (16.0, 18.0))]
    base = load_model("longitudinal", "cdfp")
    fits = []
    for model in (base, base.without_outputs(column)):
        prepared = prepare_flights(model, (), flights, (), AS_SET)
        fits.append(fit_baseline(model, model, prepared, channel_noise(prepared.records)).fit)
    absent, none = fits
    bounds = none.std()
    for name in none.free:
        assert absent.values[name] == pytest.approx(none.values[name], abs=0.05 * bounds[name]), name


def without(flight: Flight, column: str) -> Flight:
    """A flight that lacks a column."""
    columns = {n: v for n, v in flight.columns.items() if n != column}
    return Flight.build(flight.name, flight.time, columns, provenance=flight.provenance)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_flights_without_accelerometers_along_two_axes_get_an_answer() -> None:
    """Both were taken for measured without any noise: a singular matrix ended the run."""
    kind = fourth.Kind(axes="longitudinal", duration=20.0)
    flights = [without(without(f, "ax"), "az") for f in fourth.fly(7, kind, (15.0, 16.5, 18.0, 17.0))]
    result = run_gap(load_model("longitudinal", "cdfp"), flights[:3], flights[3:], (), Options(seed=1, nulls=10))
    assert not result.steps
    assert {*result.views[0].channels} == {"V", "alpha", "theta", "q"}


@pytest.mark.parametrize(("times", "told"), [(1.7, False), (2.3, True)])
def test_a_channel_twice_as_far_from_the_model_where_it_repeats_holds_its_values(times: float, told: bool) -> None:
    rng = np.random.default_rng(1)
    near = rng.standard_normal(200)
    far = rng.standard_normal(600)
    far *= times * np.sqrt(np.mean(near**2) / np.mean(far**2))
    held = held_instrument("beta", far, near, STEP, AS_SET)
    assert (held is not None) is told
    if held is not None:
        assert (held.every, held.share, held.ratio) == pytest.approx((4 * STEP, 0.75, times))


@pytest.mark.parametrize(("far", "near"), [([], [1.0, 2.0]), ([1.0, 2.0], []), ([1.0, 2.0], [0.0, 0.0])])
def test_nothing_is_said_of_a_channel_without_both(far: list[float], near: list[float]) -> None:
    assert held_instrument("beta", np.array(far), np.array(near), STEP, AS_SET) is None


def test_an_instrument_that_holds_its_values_is_an_unknown_and_no_term_of_the_model() -> None:
    step = held_step(HeldInstrument("beta", 0.3, 0.83, 4.7, 2.0), Gap(1.4, 1.4, 1.4))
    assert step.effect == "unknown"
    assert step.to_json()["form"] == {
        "kind": "held", "nameless": True, "channel": "beta", "every": 0.3, "share": 0.83, "ratio": 4.7, "threshold": 2.0,
    }  # fmt: skip
    text = describe_step(step)
    assert "beta holds its values: a new one comes every 0.3 s" in text
    assert "83%" in text
    assert "no model term is wrong" in text


def test_a_command_may_have_moved_within_the_interval_of_its_record() -> None:
    """Against moves that are drawn anew by hand: each edge, drawn out by a servo's lag, at a time of its own."""
    step, lag, rng = 0.04, 0.05, np.random.default_rng(81)
    time = step * np.arange(200)

    def flown(starts: tuple[float, float]) -> np.ndarray:
        moves = zip((0.1, -0.2), starts, strict=True)
        return np.asarray(sum(a * (1.0 - np.exp(-np.maximum(time - t, 0.0) / lag)) for a, t in moves))

    starts = (2.011, 5.003)
    errors = command_times(flown(starts), step, step, 400, rng)
    by_hand = np.array([flown((starts[0] - a, starts[1] - b)) for a, b in rng.uniform(-step / 2, step / 2, (400, 2))])
    scatter = np.sqrt(np.mean((by_hand - flown(starts)) ** 2, axis=0))
    assert np.sqrt(np.mean(errors**2, axis=0)).sum() == pytest.approx(scatter.sum(), rel=0.25)
    first, second = errors[:, (time > 1.9) & (time < 2.6)], errors[:, (time > 4.9) & (time < 5.6)]
    assert np.corrcoef(first[:, 4], first[:, 6])[0, 1] > 0.95, "one move is early or late as a whole"
    assert abs(np.corrcoef(first[:, 4], second[:, 4])[0, 1]) < 0.15, "two moves each by themselves"
    assert not command_times(np.full(50, 0.1), step, step, 3, rng).any()


def logged(interval: float) -> Flight:
    """A flight at 25 Hz whose ailerons are a command that the log has every `interval` and the import dated half of it back."""
    channel = {
        "from": "RCOU.C1",
        "kind": "computed",
        "held": True,
        "interval_s": interval,
        "dated_back_s": 0.5 * interval,
    }
    columns = {n: np.zeros(50) for n in ("delta_a", "delta_r", "p")}
    detail = {"channels": {"delta_a": channel}}
    return Flight.build("f", np.linspace(0.0, 1.96, 50), columns, provenance=Provenance(detail=detail))


def test_commands_recorded_late_are_told_with_their_time_by_the_gyros() -> None:
    model = with_nuisance(load_model("lateral", "cdfp"), {}, 0.04, AS_SET)
    values = dict.fromkeys(model.parameter_names, 0.0) | {
        "timing_controls": 0.011, "timing_delta_a": 0.001, "timing_gyros": 0.008,
    }  # fmt: skip
    free = ("Cl_p", "timing_controls", "timing_delta_a", "timing_gyros")
    fit = stub(values=values, free=free, hessian=np.diag([1.0, 1e6, 1e6, 2e6]))
    said = late_commands([logged(0.04)], stub(clean=model, fit=fit))
    assert said.startswith("delta_a is a command that the log has every 40 ms, recorded 16 +- 2 ms after it moved"), (
        said
    )
    assert late_commands([logged(0.01)], stub(clean=model, fit=fit)) == "", "new in every sample"
    assert late_commands([replace(logged(0.04), provenance=Provenance())], stub(clean=model, fit=fit)) == ""


def test_records_know_when_a_command_may_have_moved() -> None:
    """An edge of a held command is a tenth of a radian off for part of an interval; where the aileron rests nothing is."""
    columns = truth.fly([truth.Request(811, 16.0, gust=0.0, duration=12.0)])[0]
    time = columns["time"]
    columns = {n: c for n, c in columns.items() if n != "time"}
    columns["delta_a"] = np.where((time > 4.0) & (time < 6.0), 0.1, 0.0)
    channel = {"from": "RCOU.C1", "kind": "computed", "held": True, "interval_s": 0.05, "dated_back_s": 0.025}
    detail = {"channels": {"delta_a": channel}}
    sensed = Flight.build("a", time, columns)
    commanded = Flight.build("b", time, columns, provenance=Provenance(detail=detail))
    wrong = {}
    for flight in (sensed, commanded):
        record = prepare_flights(load_model("lateral", "cdfp"), (), [flight], (), AS_SET).records[0]
        wrong[flight.name] = record.errors["delta_a"].std(axis=0)
    edges = np.abs(record.time - 4.0) < 0.08
    assert wrong["b"][edges].max() > 0.01
    assert wrong["b"][edges].max() > 5.0 * wrong["a"][edges].max()
    assert wrong["b"][record.time < 3.5].max() < 0.002


def test_what_was_flown_minutes_apart_is_asked_to_repeat_itself() -> None:
    """Five stretches of one recording, at Mach 0.45 to 0.91 with minutes between, were taken for one flight that swings."""
    begins, each = (
        (0.0, 65.0, 500.0, 900.0, 1000.0),
        0.05 * np.arange(1200),
    )  # pauses of 5 s, 6 min, 6 min and, to a scrap, 40 s
    time = np.concatenate([b + (each if b < 1000.0 else each[:15]) for b in begins])
    flight = Flight.build("f", time, {"p": np.sin(time)})
    parts = flown_apart(flight, AS_SET)
    assert [(p.name, len(p.time), len(p.segments)) for p in parts] == [
        ("f from 0 s", 2400, 2), ("f from 500 s", 1200, 1), ("f from 900 s", 1215, 2),
    ]  # fmt: skip
    near = flight.part(time < 500.0)
    assert flown_apart(near, AS_SET) == [near]
