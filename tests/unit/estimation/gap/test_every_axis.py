"""What the workflow needs beyond the lateral plane: a trim, controls at their steps, filters in pitch, the kinematic check."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from estimation.engine.kernel import Array
from estimation.engine.simulate import Segment, Simulator
from estimation.gap.answer.result import GapVerdict
from estimation.gap.criteria import AS_SET
from estimation.gap.effects import Effect, catalogue
from estimation.gap.fit.linear_motion import linear_motion, steady_outputs, steady_state
from estimation.gap.fit.noise import pitch_error
from estimation.gap.records.candidate_model import with_nuisance
from estimation.gap.records.flight_records import FlightRecord, prepare_flights
from estimation.gap.search.select import material
from estimation.gap.significance.instruments import KinematicCheck, clearest, kinematic_check, pitch_kinematic_model
from estimation.gap.significance.nulls import input_errors, spectrum, with_errors
from estimation.gap.workflow import Options, run_gap
from estimation.models.base import Signal
from estimation.models.dependence import force_states
from estimation.models.load import load_model
from estimation.signals.controls import near_steps, step_reach, with_raw_steps
from estimation.signals.denoise import noise_level
from groundstation.flight import Flight
from tests.studies import gap_benchmark
from tests.studies import second_truth as truth
from tests.unit.estimation.gap.candidates_by_hand import candidate

PITCHING, LATERAL = load_model("longitudinal", "cdfp"), load_model("lateral", "cdfp")
RNG = np.random.default_rng(5)


def segment(model: object, z: Array, u: Array) -> Segment:
    return Segment(0, np.arange(len(z)) / 20.0, u, z, z[0, :4])


def test_a_pitching_record_moves_about_its_trim_and_a_lateral_one_about_zero() -> None:
    level = np.array([17.0, 0.09, 0.1, 0.0, 1.0, -9.8])
    z = level + 0.01 * RNG.standard_normal((81, 6))
    z[3:9] = np.nan
    z[0] = level
    one = segment(PITCHING, z, np.zeros((81, len(PITCHING.inputs))))
    assert steady_state(PITCHING, one) == pytest.approx(level[:4], abs=0.005)
    assert steady_state(PITCHING, one)[3] == 0.0  # pitch rate has no steady value
    assert steady_outputs(PITCHING, one) == pytest.approx(level, abs=0.005)
    sideways = segment(LATERAL, 0.3 + np.zeros((81, 5)), np.zeros((81, len(LATERAL.inputs))))
    np.testing.assert_array_equal(steady_state(LATERAL, sideways), 0.0)
    np.testing.assert_array_equal(steady_outputs(LATERAL, sideways), 0.0)


def test_a_state_no_output_shows_rests_where_it_starts() -> None:
    z = np.tile([17.0, 0.09, 0.1, 0.0, 1.0, -9.8], (40, 1))
    wake = PITCHING.plus(
        states=[Signal("alpha_wake", "rad", start="alpha"), Signal("free", "1", start=0.0)],
        lines=["alpha_wake_dot = alpha - alpha_wake", "free_dot = -free"],
    )
    one = Segment(0, np.arange(40) / 20.0, np.zeros((40, len(wake.inputs))), z, np.zeros(6))
    assert steady_state(wake, one) == pytest.approx([17.0, 0.09, 0.1, 0.0, 0.09, 0.0])


def test_the_linear_picture_of_pitching_has_the_short_period_of_the_textbook() -> None:
    """omega^2 = -(q S c / Iyy) (Cm_alpha + Cm_q c/2V L_alpha/V), damping from Cm_q and lift (Etkin and Reid, 6.3)."""
    z = np.tile([17.0, 0.085, 0.085, 0.0, 1.0, -9.8], (40, 1))
    values = {"rho": 1.17, "thrust": 5.0}
    u = np.column_stack([np.full(40, values.get(n, 0.0)) for n in PITCHING.input_names])
    simulator = Simulator.build(PITCHING, (), substeps=1, hold="linear")
    linear = linear_motion(PITCHING, simulator, segment(PITCHING, z, u), PITCHING.starts())
    q_dyn, m, inertia = 0.5 * 1.17 * 17.0**2, 3.5, 0.23
    lift_rate = q_dyn * 0.787 * (3.0 + 0.025) / (m * 17.0)
    damping = q_dyn * 0.787 * 0.61**2 / (2 * 17.0 * inertia)
    stiffness = q_dyn * 0.787 * 0.61 / inertia * 0.168 + damping * 0.92 * lift_rate
    roots = np.linalg.eigvals(linear.A)
    fast = roots[np.argsort(-np.abs(roots))[:2]]
    assert float(np.abs(np.prod(fast))) == pytest.approx(stiffness, rel=0.12)
    assert float(-np.sum(fast).real) == pytest.approx(lift_rate + 0.92 * damping, rel=0.12)
    assert set(force_states(PITCHING)) == {"V", "alpha", "q"}  # where gusts along, across and moments enter


def test_a_control_is_taken_as_measured_by_its_steps_only() -> None:
    smooth = np.concatenate([np.zeros(20), np.full(20, 0.05)])
    near = near_steps(smooth, 0.001, 4.0, step_reach(0.05))
    assert np.flatnonzero(near).tolist() == list(range(16, 26))
    assert not near_steps(smooth, 0.02, 4.0, step_reach(0.05)).any()
    measured = smooth + 0.001
    measured[20] = np.nan
    taken, where = with_raw_steps(smooth, measured, 0.001, 4.0, 0.05)
    assert np.flatnonzero(where).tolist() == [*range(16, 20), *range(21, 26)]
    np.testing.assert_allclose(taken - smooth, np.where(where, 0.001, 0.0), atol=1e-15)
    assert [step_reach(1.0 / rate) for rate in (5.0, 10.0)] == [range(-1, 3), range(-2, 4)]
    assert [step_reach(1.0 / rate) for rate in (20.0, 50.0)] == [range(-3, 7), range(-3, 7)]


@pytest.fixture(scope="module")
def flown() -> dict[str, list[Flight]]:
    """Three pitching flights each with the elevator in the slipstream, nothing hidden, a scaled vane, and a still throttle."""
    sets = {
        "propwash": ({"propwash_elevator": 1.5}, 1.0),
        "none": ({}, 1.0),
        "scale": ({"alpha_scale": 1.5}, 1.0),
        "still": ({}, 0.0),
    }
    requests = [
        truth.Request(70 + i, speed, effects, duration=24.0, manoeuvres="longitudinal", throttle=throttle)
        for effects, throttle in sets.values()
        for i, speed in enumerate((14.5, 16.5, 19.0))
    ]
    made = [
        Flight.build(f"f{i % 3}", c["time"], {k: v for k, v in c.items() if k != "time"})
        for i, c in enumerate(truth.fly(requests))
    ]
    return {name: made[3 * i : 3 * i + 3] for i, name in enumerate(sets)}


def test_records_keep_the_elevator_as_measured_by_its_steps_and_nulls_its_noise(flown: dict[str, list[Flight]]) -> None:
    flight = flown["none"][0]
    (record,) = prepare_flights(PITCHING, (), [flight], (), AS_SET).records
    raw = record.raw["delta_e"]
    assert 0.2 < raw.mean() < 0.8
    measured = flight.columns["delta_e"][: len(record)]
    np.testing.assert_array_equal(record.inputs["delta_e"][raw], measured[raw])
    assert (record.inputs["delta_e"][~raw] != measured[~raw]).mean() > 0.9
    errors = input_errors(record, PITCHING, np.random.default_rng(1)).bank["delta_e"]
    assert np.std(errors[:, raw]) == pytest.approx(record.input_noise["delta_e"], rel=0.15)
    assert np.std(errors[:, ~raw]) < 0.7 * record.input_noise["delta_e"]
    (known,) = with_errors([record], PITCHING, [input_errors(record, PITCHING, np.random.default_rng(1))])
    assert known.error_spectra["delta_e"].mean() == pytest.approx(np.mean(errors**2), rel=0.3)
    assert known.error_spectra["delta_e"].size == len(record) // 2 + 1
    (sideways,) = prepare_flights(LATERAL, (), [flight], (), AS_SET).records
    assert not sideways.raw


def test_the_spectrum_of_random_courses_is_smooth_and_keeps_their_colour() -> None:
    rng = np.random.default_rng(8)
    courses = lfilter([1.0], [1.0, -0.9], rng.standard_normal((6, 4000)), axis=1)[:, 2000:]
    found = spectrum(courses)
    expected = 1.0 / np.abs(1.0 - 0.9 * np.exp(-2j * np.pi * np.fft.rfftfreq(2000))) ** 2
    assert found[20:] == pytest.approx(expected[20:], rel=0.45)
    assert np.mean(found[20:] / expected[20:]) == pytest.approx(1.0, abs=0.1)


def test_the_noise_of_a_control_is_told_between_its_steps(flown: dict[str, list[Flight]]) -> None:
    """0.07 deg in the second truth; by all third differences, a third of them of steps and servo, a tenth more and above."""
    levels = []
    for flight in flown["none"]:
        (record,) = prepare_flights(PITCHING, (), [flight], (), AS_SET).records
        levels.append((record.input_noise["delta_e"], noise_level(flight.columns["delta_e"])))
    own, rough = np.mean(levels, axis=0)
    assert own == pytest.approx(np.radians(0.07), rel=0.06)
    assert rough > 1.1 * np.radians(0.07)


def filtered(theta_error: float, gain: float = 1.0, white: float = 0.0) -> list[FlightRecord]:
    """A record whose pitch attitude integrates a noisy rate, with a slow error of some size; white: noise of its own."""
    t = np.arange(601) / 20.0
    q = 0.3 * np.sin(1.5 * t)
    theta = 0.1 + 0.2 * (1 - np.cos(1.5 * t)) * gain + theta_error * np.sin(0.8 * t)
    z = np.column_stack(
        [
            np.full(601, 17.0),
            np.full(601, 0.09),
            theta + white * RNG.standard_normal(601),
            q + 0.007 * RNG.standard_normal(601),
            np.zeros(601),
            np.zeros(601),
        ]
    )
    return [FlightRecord(0, 0, t, {}, z, z[0, :4], {})]


def test_what_is_wrong_with_a_filtered_pitch_attitude_is_seen_against_the_integrated_rate() -> None:
    names = PITCHING.output_names
    scatter = np.array([0.1, 0.005, 1e-5, 0.007, 0.05, 0.05])
    wider = pitch_error(filtered(0.01), names, scatter, AS_SET)
    assert wider[2] == pytest.approx(0.01 / np.sqrt(2.0), rel=0.25)
    np.testing.assert_array_equal(np.delete(wider, 2), np.delete(scatter, 2))
    independent = scatter.copy()
    independent[2] = 0.005  # noisier from sample to sample than one step of the gyro, and white: no filter
    assert pitch_error(filtered(0.01, white=0.005), names, independent, AS_SET) is independent
    assert pitch_error(filtered(0.01), LATERAL.output_names, scatter, AS_SET) is scatter


def test_a_filtered_pitch_attitude_may_take_speeding_up_for_gravity() -> None:
    made = with_nuisance(PITCHING, {}, 0.05, AS_SET, ("theta",))
    assert made.parameter("plumb_theta").prior_std == pytest.approx(AS_SET.plumb_share / 9.80665)
    assert "plumb_theta" not in with_nuisance(PITCHING, {}, 0.05, AS_SET).parameter_names


def test_the_kinematic_model_of_pitching_is_the_motion_of_the_second_truth(flown: dict[str, list[Flight]]) -> None:
    check = kinematic_check(flown["scale"], _sensors(), 30, 1, AS_SET, PITCHING)
    assert (check.origin, check.best) == ("sensor", "alpha_scale")
    assert kinematic_check(flown["none"], _sensors(), 30, 1, AS_SET, PITCHING).origin == "physics"
    less = [Flight.build("f", f.time, {k: v for k, v in f.columns.items() if k != "ax"}) for f in flown["none"]]
    assert kinematic_check(less, _sensors(), 30, 1, AS_SET, PITCHING).why == "not measured: ax"
    assert {"V_dot", "alpha_dot", "theta_dot"} <= set(pitch_kinematic_model(AS_SET).definitions)


def _sensors() -> tuple[object, ...]:
    from estimation.gap.effects import catalogue

    return catalogue(model=PITCHING)


def test_of_two_planes_the_one_that_stands_out_answers() -> None:
    calm, loud = KinematicCheck("physics", "a", 2.0, 3.0, ""), KinematicCheck("sensor", "b", 6.0, 3.0, "")
    mute = KinematicCheck("undecided", "", 0.0, 0.0, "not measured: ax")
    assert clearest([calm, loud]) is loud
    assert clearest([mute, calm]) is calm
    assert clearest([mute]) is mute


def test_what_derivatives_carry_is_never_named_however_well_it_fits() -> None:
    """The curvature of the equations leaves a little of a shifted centre of gravity, which other bends explain as well."""
    tied, free = candidate("cg_x", score=30.0), candidate("Cm_alpha2", score=30.0)
    effect = replace(tied.hypothesis.effect, tied_to=("Cm_*",))
    tied = replace(tied, hypothesis=replace(tied.hypothesis, effect=effect))
    assert material(tied, 0.05, {}, AS_SET).why_not == "cannot be told from Cm_*"
    assert not material(free, 0.05, {}, AS_SET).why_not


QUICK = Options(seed=3, nulls=20, most=1)
# What the throttle, the elevator and the trims could be explained by; all 47 are asked by the benchmark.
NEAR = {
    "propwash_elevator", "propwash_CL", "thrust_scale", "thrust_tilt", "thrust_lag", "thrust_z", "mass_error", "rho_error",
    "Iyy_error", "cg_x", "Cm_de3", "elevator_lag", "elevator_delay", "alpha_scale",
}  # fmt: skip


def asked() -> list[Effect]:
    """The entries of the catalogue that are asked here, all of which it holds."""
    found = [e for e in catalogue(model=PITCHING) if e.name in NEAR]
    assert {e.name for e in found} == NEAR
    return found


def test_an_elevator_in_the_slipstream_is_named_by_its_throttle_steps(flown: dict[str, list[Flight]]) -> None:
    flights = flown["propwash"]
    result = run_gap(PITCHING, flights[:2], flights[2:], asked(), options=QUICK)
    (step,) = result.steps
    assert step.effect == "propwash_elevator"
    true = 1.5 * truth.pitch.PITCH["propwash_elevator"] * truth.AREA / truth.pitch.DISC
    size, bound = step.estimates["k_propwash_elevator"]
    assert abs(size - true) < 4 * bound
    assert bound < 0.2 * true
    assert step.gap.after < step.gap.before - 0.2
    assert "q" in step.where.channels
    together = {frozenset((t.first, t.second)) for t in result.ties}
    assert frozenset(("thrust_scale", "mass_error")) in together
    assert not {"rho_error", "Iyy_error", "cg_x"} & {m.effect for m in step.members}


def test_a_throttle_that_never_moves_hides_effects_of_thrust(flown: dict[str, list[Flight]]) -> None:
    told = run_gap(PITCHING, flown["none"], (), asked(), options=QUICK)
    still = run_gap(PITCHING, flown["still"], (), asked(), options=QUICK)
    blind = {e["effect"]: e["separate_by"] for e in still.details["cannot_tell"]}
    assert {"thrust_tilt", "thrust_lag"} <= set(blind)
    assert not {"thrust_tilt", "thrust_lag"} & {e["effect"] for e in told.details["cannot_tell"]}
    assert "throttle steps" in blind["thrust_tilt"]
    for name in ("thrust_z", "thrust_scale", "propwash_CL"):  # trims at three speeds still tell a little
        assert still.minimum_detectable[name] > 2.5 * told.minimum_detectable[name]
    assert not told.steps
    assert not still.steps
    assert told.verdict.value == "no_gap"
    assert "rho_error cannot be told from CL_*" in told.text
    assert "errors of mass" not in told.text  # thrust steps do tell something of it


def test_an_elevator_that_only_holds_an_attitude_is_not_asked_when_it_moves() -> None:
    """Aileron flights given to the pitching model: a quarter of a second of elevator lag once explained the gusts it answers."""
    shape = truth.perturbed_derivatives(np.random.default_rng([9410, 7]))
    speeds = (14.5, 16.5, 19.0, 17.0)
    requests = [truth.Request(94100 + i, v, {}, 0.15 * truth.DEG, "aileron_only", shape) for i, v in enumerate(speeds)]
    four = gap_benchmark.flights(truth.fly(requests))
    result = run_gap(PITCHING, four[:3], four[3:], options=Options(seed=1, nulls=20))
    assert [s.effect for s in result.steps] == []
    assert result.verdict is GapVerdict.CANNOT_TELL
    assert "move it by itself, in steps" in result.text
    assert not [n for n in result.scores if n.startswith("elevator_") and n != "elevator_compliance"]
    assert {"elevator_lag", "elevator_delay"} <= {c["effect"] for c in result.details["cannot_tell"]}
    assert sum("delta_e rests or only follows the motion" in note for note in result.notes) == 3


@pytest.mark.parametrize(("samples", "verdict"), [(2, "no_gap"), (3, "unknown_effect")])
def test_a_vane_that_holds_its_values_is_told_and_nothing_else_blamed(
    flown: dict[str, list[Flight]], samples: int, verdict: str
) -> None:
    """The noise of a channel is known from its new values alone: taken over all samples it was 0.58 times the true one, and
    scatter that nobody had hidden stood out of quiet nulls."""
    held = [
        Flight.build(
            f.name,
            f.time,
            {n: c[np.arange(c.size) // samples * samples] if n == "alpha" else c for n, c in f.columns.items()},
        )
        for f in flown["none"]
    ]
    result = run_gap(PITCHING, held, (), asked(), options=QUICK)
    assert result.verdict.value == verdict
    if samples == 3:
        (step,) = result.steps
        told = step.to_json()["form"]
        assert (told["kind"], told["channel"], told["every"]) == ("held", "alpha", 0.15)
        assert step.effect == "unknown"
        assert "alpha holds its values: a new one comes every 0.15 s" in result.text
    assert ("alpha repeats the last value in many samples" in result.text) is (samples == 2)
