"""Rules that decide before and within every fit, each at its limit: samples, priors, noise, steps of surfaces."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from estimation.engine.kernel import Array
from estimation.engine.simulate import Segment
from estimation.gap.criteria import AS_SET
from estimation.gap.effects import catalogue
from estimation.gap.fit.baseline import estimated_noise, noise_parts
from estimation.gap.fit.closed_loop import ClosedLoop, only_following, without_hardware_of
from estimation.gap.fit.linear_motion import Linear
from estimation.gap.fit.noise import (
    NoiseModel,
    NoisePart,
    NoiseSource,
    Shapes,
    estimate_noise,
    shapes_of,
    spectral_matrix,
)
from estimation.gap.fit.problem import LikelihoodProblem
from estimation.gap.fit.surface_steps import SurfaceSteps, find_surface_steps, freedom_of
from estimation.gap.records import flight_records, sampling
from estimation.gap.records.candidate_model import with_nuisance
from estimation.gap.records.channels import sample_notes
from estimation.gap.records.flight_records import (
    FlightRecord,
    controls_outdo_gyros,
    prepare_flights,
    stretches,
    with_own_noise,
)
from estimation.gap.records.sampling import at_own_rates, with_attitudes_between
from estimation.gap.significance.nulls import NullFlyer
from estimation.models.base import Parameter, ParameterRole
from estimation.models.load import load_model
from groundstation.flight import Flight, Provenance
from tests.studies import second_truth as truth
from tests.unit.estimation.gap.roll import ROLL

STEP = 0.05


# ------------------------------------------------------------------------------------------------ sample faults
def notes(values: Array) -> list[str]:
    flight = Flight.build("f", STEP * np.arange(values.size), {"p": np.asarray(values, dtype=np.float64)})
    return sample_notes([flight], ["p"], AS_SET)


def wave(count: int) -> Array:
    return np.sin(0.7 * np.arange(count)) + 0.001 * np.arange(count)


@pytest.mark.parametrize(("repeats", "stale"), [(140, False), (160, True)])
def test_a_channel_that_repeats_a_seventh_of_its_samples_is_stale(repeats: int, stale: bool) -> None:
    values = wave(1001)
    at = 4 * np.arange(repeats) + 2
    values[at] = values[at - 1]
    assert bool(notes(values)) is stale


@pytest.mark.parametrize(("run", "clipped"), [(3, False), (4, True)])
def test_four_samples_at_the_end_of_the_range_are_clipped(run: int, clipped: bool) -> None:
    values = wave(200)
    values[50 : 50 + run] = 5.0
    assert bool(notes(values)) is clipped


@pytest.mark.parametrize(("holes", "told"), [(18, False), (22, True)])
def test_a_channel_that_lacks_two_samples_in_a_hundred_is_named(holes: int, told: bool) -> None:
    values = wave(1000)
    values[100 : 100 + holes] = np.nan
    assert bool(notes(values)) is told


@pytest.mark.parametrize(("ratio", "marked"), [(1.4, False), (1.6, True)])
def test_a_channel_half_as_noisy_again_has_a_noise_of_its_own(ratio: float, marked: bool) -> None:
    noise = np.random.default_rng(0).standard_normal((300, 1))
    records = [
        FlightRecord(i, 0, STEP * np.arange(300), {}, size * noise, np.zeros(1), {})
        for i, size in enumerate((1.0, 1.0, ratio))
    ]
    louder = with_own_noise(records, 2, AS_SET)[2].louder
    assert (louder is not None) is marked
    if louder is not None:
        assert louder[0] == pytest.approx(ratio**2)


# ------------------------------------------------------------------------------------------------ nuisances
def test_nuisances_are_as_wide_as_what_no_flight_is_free_of() -> None:
    noise = dict.fromkeys(("beta", "p", "r", "phi", "ay"), 0.02)
    believed = Parameter("Cl_p", start=-0.4, reference=-0.4, reference_std=0.1)
    base = load_model("lateral", "cdfp")
    base = replace(base, parameters=tuple(believed if p.name == "Cl_p" else p for p in base.parameters))
    made = with_nuisance(base, noise, STEP, AS_SET, ("phi",))
    widths = {
        n: made.parameter(n).prior_std
        for n in (
            "bias_beta",
            "timing_controls",
            "timing_delta_a",
            "timing_delta_r",
            "timing_phi",
            "timing_gyros",
            "timing_moments",
            "plumb_phi",
            "Cl_p",
        )
    }
    assert widths == pytest.approx(
        {
            "bias_beta": 0.02,
            "timing_controls": 0.005,
            "timing_delta_a": 0.0015,
            "timing_delta_r": 0.0015,
            "timing_phi": 0.005,
            "timing_gyros": 0.005,
            "timing_moments": 0.005,
            "plumb_phi": 0.02,
            "Cl_p": 0.3,
        }
    )
    alone = with_nuisance(ROLL, {}, STEP, AS_SET)
    assert alone.parameter("timing_delta_a").prior_std == pytest.approx(0.005)
    assert "timing_controls" not in alone.parameter_names, "one surface has no others"
    late = [t.parameters[0] for t in made.transforms if t.input == "delta_r" and t.kind == "delay"]
    assert late == ["timing_controls", "timing_delta_r"]
    assert made.parameter("rounding_phi").prior_std == pytest.approx(STEP**2 / 12)


def test_a_user_s_own_parameter_of_that_name_is_the_user_s() -> None:
    own = replace(
        ROLL,
        parameters=(*ROLL.parameters, Parameter("bias_p"), Parameter("timing_x")),
        equations=("p_dot = L_p*p + L_a*delta_a + bias_p + timing_x",),
    )
    made = with_nuisance(own, {"p": 0.01}, STEP, AS_SET)
    problem = LikelihoodProblem(made, own, (), (), AS_SET)
    assert made.parameter("bias_p").role is ParameterRole.DERIVATIVE
    assert [n for n in problem.free if problem.nuisance(n)] == ["timing_delta_a", "curvature_delta_a"]


def test_how_a_surface_moves_between_samples_is_believed_and_limited() -> None:
    problem = LikelihoodProblem(ROLL, ROLL, (), (), AS_SET)
    assert problem.prior("curvature_delta_a") == (0.0, 1.5)
    assert problem.limits("curvature_delta_a") == (-6.0, 6.0)
    assert problem.prior("L_p") is None


# ------------------------------------------------------------------------------------------------ noise
def linear(outputs: int, states: int) -> Linear:
    """A motion that decays in a second and shows nothing of its controls."""
    return Linear(
        A=-np.eye(states),
        B=np.zeros((states, 0)),
        C=np.ones((outputs, states)),
        D=np.zeros((outputs, 0)),
        inputs=(),
        dt=STEP,
        scale=np.ones(outputs),
    )


def test_the_error_of_an_attitude_filter_is_forgotten_in_three_seconds() -> None:
    shapes = shapes_of(load_model("lateral", "cdfp"), linear(5, 4), 1200, AS_SET, ())
    s = 2j * np.pi / (1200 * STEP)  # the lowest frequency of the record
    slowest = np.abs(shapes.parts[NoisePart(NoiseSource.WANDERING, "phi")][1, 3])
    assert slowest == pytest.approx(np.abs(1.0 / (s + 1.0 / 3.0)), rel=0.02)


def test_gusts_have_a_memory_of_a_second() -> None:
    shapes = shapes_of(ROLL, linear(1, 1), 1200, AS_SET, ("p",))
    coloured = NoisePart(NoiseSource.RATE, "p", 1.0)
    s = 2j * np.pi * 10 / (1200 * STEP)
    ratio = shapes.parts[coloured][10, 0] / shapes.parts[NoisePart(NoiseSource.RATE, "p")][10, 0]
    assert ratio == pytest.approx(s / (s + 1.0))


def test_gusts_across_the_span_have_a_memory_of_a_seventh_of_a_second_and_grow_with_its_root() -> None:
    s = 2j * np.pi * 10 / (1200 * STEP)
    for span, memory in ((None, 0.15), (1.5, 0.15), (6.0, 0.3)):
        model = ROLL if span is None else replace(ROLL, constants={**ROLL.constants, "b": span})
        shapes = shapes_of(model, linear(1, 1), 1200, AS_SET, ("p",))
        fading = next(part for part in shapes.parts if part.source is NoiseSource.TWIST)
        assert fading.memory == pytest.approx(memory)
        ratio = shapes.parts[fading][10, 0] / shapes.parts[NoisePart(NoiseSource.RATE, "p")][10, 0]
        assert ratio == pytest.approx(1.0 / (1.0 + s * memory))


def test_nulls_fly_through_gusts_that_fade_and_through_the_rates_of_those_that_last() -> None:
    """Both of white noise that is twice its strength at every half sample: the one as a first-order lag leaves it, the other
    what that takes away."""
    model = SimpleNamespace(inputs=(), criteria=AS_SET)
    for source, memory in ((NoiseSource.TWIST, 0.15), (NoiseSource.RATE, 1.0), (NoiseSource.RATE, 0.0)):
        flyer: Any = SimpleNamespace(
            noise=NoiseModel(np.ones(1), {NoisePart(source, "p", memory): 3.0}), states={"p": 0}, problem=model
        )
        u = np.zeros((200_000, 1))
        NullFlyer._disturb(flyer, u, 0.5 * STEP, np.random.default_rng(1))
        keep = np.exp(-0.5 * STEP / memory) if memory else 0.0
        if source is NoiseSource.TWIST:
            expected, after = 6.0 * (1.0 - keep) / (1.0 + keep), keep
            assert np.mean(u[1:] * u[:-1]) / np.mean(u**2) == pytest.approx(after, abs=0.01)
        else:
            expected = 6.0 * 2.0 * keep**2 / (1.0 + keep) if memory else 6.0
        assert np.mean(u**2) == pytest.approx(expected, rel=0.03)


def nowhere(count: int) -> SurfaceSteps:
    return SurfaceSteps((), np.zeros(0, dtype=int), np.zeros(0), np.zeros((count, 1, 0)), AS_SET)


def test_noise_is_estimated_of_records_of_which_one_has_a_control_prepared_and_the_next_has_not() -> None:
    control = "delta_a"
    moved = replace(linear(1, 1), inputs=(control,), B=np.ones((1, 1)), D=np.zeros((1, 1)))
    quiet = shapes_of(ROLL, moved, 100, AS_SET, ("p",))
    prepared = shapes_of(ROLL, moved, 100, AS_SET, ("p",), {control: np.full(51, 1e-6)})
    residuals = [np.random.default_rng(k).standard_normal((100, 1)) for k in range(2)]
    for shapes in ([prepared, quiet], [quiet, prepared]):
        noise = estimate_noise(residuals, shapes, np.ones(1), np.full(1, 0.1))
        assert noise.process[NoisePart(NoiseSource.PREPARED, control)] == 1.0
        assert [spectral_matrix(noise, one).shape for one in shapes] == [(51, 1, 1)] * 2


@pytest.mark.parametrize(("every", "read_so"), [(1.4, False), (1.6, True)])
def test_a_control_at_two_thirds_of_the_samples_is_read_with_them(every: float, read_so: bool) -> None:
    rng, count = np.random.default_rng(1), 600
    flight = Flight.build(
        "f",
        STEP * np.arange(count),
        {"delta_a": wave(count) + 0.01 * rng.standard_normal(count), "p": wave(count) + rng.standard_normal(count)},
        provenance=Provenance(detail={"native_hz": {"delta_a": 1.0 / (STEP * every)}}),
    )
    (read,) = at_own_rates([flight], ["delta_a"], ["p"], AS_SET)
    assert (len(read) < count) is read_so


def test_no_channel_is_trusted_more_than_half_its_scatter() -> None:
    shapes = Shapes({}, 100, STEP)
    noise = estimated_noise([np.zeros((100, 1))], [shapes], [nowhere(100)], np.array([0.2]), (), {}, None)
    assert np.sqrt(noise.measurement) == pytest.approx([0.5 * 0.2])


def test_a_filtered_attitude_shares_most_of_its_gyro_s_noise() -> None:
    rng = np.random.default_rng(1)
    p = 0.01 * rng.standard_normal(400)
    z = np.column_stack([p, np.cumsum(p) * STEP])
    record = FlightRecord(0, 0, STEP * np.arange(400), {}, z, np.zeros(2), {})
    scatter = np.array([0.01, 0.003])
    own, without, known = noise_parts([record], ("p", "phi"), scatter, AS_SET)
    assert own == pytest.approx([0.5 * 0.01, 0.003])
    assert known[NoisePart(NoiseSource.GYRO, "phi")] == pytest.approx(0.75 * 0.01**2)
    assert known[NoisePart(NoiseSource.WANDERING, "phi")] == pytest.approx(0.003**2 / (3.0 * STEP))
    assert not [name for name in without if name.of == "phi"]


# ------------------------------------------------------------------------------------------------ long records
def flown(seconds: float, resting: float | None = None) -> Segment:
    """A record of ROLL whose aileron moves all the time, but for a second and a half about `resting`."""
    time = np.arange(0.0, seconds, STEP)
    u = np.sin(2.0 * time)
    if resting is not None:
        u[np.abs(time - resting) < 0.75] = 0.3
    return Segment(100, time, u[:, None], np.zeros((time.size, 1)), np.zeros(1))


@pytest.mark.parametrize(
    ("seconds", "parts"), [(30.0, 1), (74.0, 1), (76.0, 2), (149.0, 2), (151.0, 3), (600.0, 8), (601.0, 9)]
)
def test_a_record_longer_than_75_s_is_cut_into_stretches_that_are_no_longer(seconds: float, parts: int) -> None:
    segment = flown(seconds)
    cut = stretches(segment, [0], AS_SET)
    assert len(cut) == parts
    assert [c.start for c in cut[1:]] == [c.stop for c in cut[:-1]]
    assert (cut[0].start, cut[-1].stop) == (0, len(segment))
    lengths = [c.stop - c.start for c in cut]
    assert min(lengths) > 0.75 * max(lengths)


def test_a_record_is_cut_where_the_controls_rest() -> None:
    for resting in (47.0, 53.0):
        first, _ = stretches(flown(100.0, resting), [0], AS_SET)
        assert first.stop * STEP == pytest.approx(resting, abs=0.3)
    even, _ = stretches(flown(100.0, 30.0), [0], AS_SET)  # too far from the middle
    assert even.stop * STEP == pytest.approx(50.0, abs=5.1)


def test_stretches_of_a_flight_begin_where_it_was_and_are_told() -> None:
    model = load_model("lateral", "cdfp")
    (columns,) = truth.fly([truth.Request(11, duration=90.0)])
    flight = Flight.build("f0", columns["time"], {k: v for k, v in columns.items() if k != "time"})
    prepared = prepare_flights(model, (), [flight], [], AS_SET)
    one, two = prepared.records
    assert (one.flight, two.flight) == (0, 0)
    assert abs(two.first * STEP - 45.0) <= 4.6
    assert one.first + len(one) <= two.first <= one.first + len(one) + 5
    assert two.time[0] == pytest.approx(flight.time[two.first])
    near = [flight.columns[n][two.first] for n in model.state_names]
    assert two.x0 == pytest.approx(near, abs=0.02)
    assert any("long records are fitted in stretches, 2 in all" in note for note in prepared.notes)


# ------------------------------------------------------------------------------------------------ controls that follow
def steered(own: float, noise: float = 0.001, count: int = 600) -> FlightRecord:
    """A record of ROLL whose aileron is the roll rate a sample ago times a gain, and a wave of rms `own` noises beside it."""
    rng = np.random.default_rng(7)
    p = np.cumsum(rng.standard_normal(count)) * 0.01
    u = -0.2 * np.concatenate([p[:1], p[:-1]]) + np.sqrt(2.0) * own * noise * np.sin(0.9 * np.arange(count))
    time = STEP * np.arange(count)
    return FlightRecord(0, 0, time, {"delta_a": u}, p[:, None], p[:1], {"delta_a": noise}, states=p[:, None])


@pytest.mark.parametrize(("own", "follows"), [(0.0, True), (0.4, True), (0.6, False), (5.0, False)])
def test_a_control_that_does_half_its_noise_beside_the_motion_moves_by_itself(own: float, follows: bool) -> None:
    assert only_following([steered(own)], ROLL, AS_SET) == (("delta_a",) if follows else ())


def test_one_record_on_which_a_control_moves_by_itself_is_enough() -> None:
    assert only_following([steered(0.0), steered(5.0)], ROLL, AS_SET) == ()


def test_a_control_without_noise_and_a_record_of_few_samples_are_not_judged() -> None:
    assert only_following([replace(steered(0.0), input_noise={})], ROLL, AS_SET) == ()
    assert only_following([steered(0.0, count=20)], ROLL, AS_SET) == ()


def test_what_says_how_a_control_moves_is_not_asked_where_it_only_follows() -> None:
    model = load_model("six-dof", "cdfp")
    known = catalogue(model=model)
    asked, dropped = without_hardware_of(known, ["delta_e"])
    assert {"elevator_lag", "elevator_delay", "elevator_backlash"} <= {e.name for e in dropped}
    assert {"servo_lag", "thrust_lag", "aileron_lag", "CD_de2", "airspeed_scale"} <= {e.name for e in asked}
    assert without_hardware_of(known, []) == (tuple(known), ())
    assert "servo_lag" in {e.name for e in without_hardware_of(known, ["delta_e", "delta_a", "delta_r"])[1]}


# ------------------------------------------------------------------------------------------------ steps of surfaces
def moved(u: Array, jump: float = 0.0, scale: float = 1.0, restless: frozenset[str] = frozenset()) -> SurfaceSteps:
    """Steps found in the course (N,) of one control that an output of rms `scale` shows by `jump` per radian."""
    one = Linear(
        np.array([[-1.0]]), np.array([[1e-9]]), np.eye(1), np.array([[jump]]), ("delta_a",), STEP, np.array([scale])
    )
    segment = Segment(0, STEP * np.arange(u.size), u[:, None], np.ones((u.size, 1)), np.zeros(1))
    return find_surface_steps(ROLL, one, segment, AS_SET, restless)


def jittery(count: int) -> Array:
    """A course that moves by 0.001 up or down in every interval: a scatter of 0.0014826."""
    return 0.001 * (np.arange(count) % 2)


@pytest.mark.parametrize(("times", "found"), [(3.6, 0), (4.4, 1)])
def test_a_step_of_four_times_the_scatter_is_one(times: float, found: int) -> None:
    u = jittery(201)
    u[101:] += times * 1.4826 * 0.001 - 0.001  # from a high sample to a low one
    assert len(moved(u).name) == found


def test_the_largest_forty_eight_steps_of_a_record_are_left_open() -> None:
    u = np.cumsum(np.where(np.arange(600) % 10 == 0, 0.01 + 1e-5 * np.arange(600), 0.0))
    steps = moved(u)
    assert len(steps.name) == 48
    assert min(steps.step) == pytest.approx(0.01 + 1e-5 * 120)


def test_all_steps_of_a_control_that_never_rests_are_left_open_but_for_four_hundred() -> None:
    u = np.cumsum(np.where(np.arange(6000) % 10 == 0, 0.01 + 1e-6 * np.arange(6000), 0.0))
    restless = frozenset({"delta_a"})
    assert len(moved(u[:600], restless=restless).name) == 59
    steps = moved(u, restless=restless)
    assert len(steps.name) == 400
    assert min(steps.step) == pytest.approx(0.01 + 1e-6 * 2000)


@pytest.mark.parametrize(("share", "found"), [(0.145, 0), (0.155, 2)])
def test_a_jump_of_a_seventh_of_an_output_is_seen(share: float, found: int) -> None:
    u = np.where(np.arange(200) < 100, 0.0, 0.1)
    assert moved(u, jump=share / 0.1).name.count("p") == found


def test_surfaces_and_jumps_are_as_free_as_usual_where_flights_do_not_tell() -> None:
    one = replace(nowhere(10), name=("delta_a", "ay"), jumping=frozenset({"ay"}))
    assert one.spread({}) == pytest.approx([0.2, 0.1])
    assert one.spread({"delta_a": 0.3, "ay": 0.02}) == pytest.approx([0.3, 0.02])


@pytest.mark.parametrize(("seen", "free"), [(0.0, (0.2 / 2.0, 0.1 / 2.0)), (5.0, (0.5, 0.5)), (0.1, (0.1323, 0.1))])
def test_the_freedom_that_flights_show_counts_with_one_step_as_usual(seen: float, free: tuple[float, float]) -> None:
    one = replace(nowhere(10), name=("delta_a", "ay") * 3, jumping=frozenset({"ay"}))
    found = freedom_of([one], [(np.full(6, seen), np.zeros(6))])
    assert (found["delta_a"], found["ay"]) == pytest.approx(free, rel=1e-3)


@pytest.mark.parametrize(("white", "is_filled"), [(0.4, True), (0.6, False)])
def test_an_attitude_of_which_half_is_white_is_measured_not_filtered(
    monkeypatch: pytest.MonkeyPatch, white: float, is_filled: bool
) -> None:
    monkeypatch.setattr(sampling, "white_share", lambda *given: white)
    time, slow = 0.05 * np.arange(400), np.repeat(np.random.default_rng(5).standard_normal(200), 2)
    flight = Flight.build("f", time, {"p": np.sin(time), "q": time, "r": time, "phi": slow, "theta": slow})
    filled = with_attitudes_between(flight, AS_SET)
    assert any("filter" in str(n) for n in filled.notes) is is_filled


@pytest.mark.parametrize(("share", "felt"), [(0.45, ()), (0.55, ("delta_a",)), (1.9, ("delta_a",)), (2.1, ())])
def test_a_control_is_felt_that_moves_by_half_of_its_answers_to_gusts(share: float, felt: tuple[str, ...]) -> None:
    time, rng = STEP * np.arange(600), np.random.default_rng(11)
    still, gusts = 0.2 * np.sin(time)[:, None], np.cumsum(0.01 * rng.standard_normal((600, 1)), axis=0)
    loop = ClosedLoop(ROLL, {"delta_a": np.array([[0.3], [0.0]])}, (still,), (gusts,))
    control = (0.3 * still + share * 0.3 * gusts)[:, 0] + 1e-5 * rng.standard_normal(600)
    record = FlightRecord(0, 0, time, {"delta_a": control}, still + gusts, np.zeros(1), {"delta_a": 1e-5})
    fit = SimpleNamespace(problem=SimpleNamespace(records=(record,)), criteria=AS_SET)
    assert loop.felt(fit) == felt  # type: ignore[arg-type]


@pytest.mark.parametrize(("ratios", "loud"), [((1.9, 1.9, 7.0), False), ((2.1, 2.1, 0.5), True), ((), False)])
def test_a_control_is_loud_whose_noise_moves_a_rate_by_twice_that_of_the_gyro(
    monkeypatch: pytest.MonkeyPatch, ratios: tuple[float, ...], loud: bool
) -> None:
    monkeypatch.setattr(flight_records, "_loudest", lambda model, ratio, flight: ratio)
    flights: Any = [SimpleNamespace(segments=ratios)]
    assert controls_outdo_gyros(ROLL, flights, AS_SET) is loud
