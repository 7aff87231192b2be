"""Whom to believe: process noise, agreement, impossible instruments, joint against members; and methods that fail."""

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from estimation.aircraft import load_aircraft
from estimation.estimators import output_error as output_error_module
from estimation.estimators.estimator import Estimator, Task
from estimation.estimators.output_error import OutputErrorOptions, output_error
from estimation.estimators.result import Result
from estimation.models import load_model, read_model, write_model
from estimation.models.base import joint_model
from estimation.session import runner
from estimation.session.evidence import driven_outputs, gain_of_filter
from estimation.session.sanity_checks import DoubtKind
from estimation.session.verdict import NO_METHOD, verdict
from estimation.structure.candidates import Candidate, CandidateKind, structure_candidates, with_candidates
from estimation.structure.score_test import Lack, StructureTest
from estimation.structure.score_test import Tested as Score
from groundstation.flight import Flight, MissingColumnError, write_flight
from sideslip.verbs.estimate import estimate
from tests.studies.verdict_study import JET_AIRCRAFT, JET_TRUE, jet_flights
from tests.unit.estimation.truth import NOISE, TRUE, Case, fly

LATERAL = load_model("lateral", "cdfp")
METHODS = ("ml", "fem", "ls")


@pytest.fixture(scope="module")
def calm() -> Mapping[str, Result]:
    """Results of a flight in still air."""
    flight = fly(Case(noise=NOISE), np.random.default_rng(21))[0][0]
    return runner.estimate(LATERAL, [flight], load_aircraft("cdfp"), METHODS).flights[0].results


@pytest.fixture(scope="module")
def rough() -> Mapping[str, Result]:
    """Results of a flight in gusts of 0.5 m/s, 1.7 deg of sideslip."""
    flight = fly(Case(noise=NOISE, gust=0.5), np.random.default_rng(22))[0][0]
    return runner.estimate(LATERAL, [flight], load_aircraft("cdfp"), METHODS).flights[0].results


def moved(result: Result, **values: float) -> Result:
    """The result with other estimates."""
    table = {n: replace(e, estimate=values.get(n, e.estimate)) for n, e in result.parameters.items()}
    return replace(result, parameters=table)


def test_still_air_recommends_output_error_with_and_without_a_filter(calm: Mapping[str, Result]) -> None:
    for methods in (METHODS, ("ml", "ls"), ("ml",)):
        found = verdict({m: calm[m] for m in methods})
        assert found.recommended.method == "ml"
        assert "process noise" in found.recommended.why or "residuals" in found.recommended.why
        assert DoubtKind.PROCESS_NOISE not in {d.kind for d in found.doubts}


def test_gusts_recommend_the_filter_and_output_error_alone_is_not_believed(rough: Mapping[str, Result]) -> None:
    found = verdict(rough)
    assert found.recommended.method == "fem"
    assert DoubtKind.PROCESS_NOISE in {d.kind for d in found.doubts}
    alone = verdict({"ml": rough["ml"]})
    assert alone.recommended.method == NO_METHOD
    assert "--method ml,fem,ls" in alone.recommended.why


def test_a_filter_is_not_believed_beside_something_left_out(
    rough: Mapping[str, Result], calm: Mapping[str, Result]
) -> None:
    """It takes what is left out for process noise, however little that moves; output error bears so little."""
    scale = Candidate("scale_beta", CandidateKind.SCALE, null=1.0, channel="beta", phrase="a wrong scale of beta")
    left = StructureTest((), (Lack(Score(scale, -6.5, 0.96, {"CY_r": 0.4})),), added=("delay_beta",))
    found = verdict(rough, structure=left).recommended
    assert (found.method, found.lacks) == (NO_METHOD, ("scale_beta",))
    assert "fem may take that for process noise" in found.why
    assert verdict(rough, structure=StructureTest((), ())).recommended.method == "fem"
    assert verdict(calm, structure=left).recommended.method == "ml"


def test_a_regression_is_no_witness_against_a_model_that_has_its_vane_late() -> None:
    """It takes the lagging vane for sideslip: right estimates of four random aeroplanes were refused for that."""
    made = fly(Case(noise=NOISE), np.random.default_rng(21))[0][0]
    flight = made.with_columns(beta=np.interp(made.time - 0.1, made.time, made["beta"]))
    found = runner.estimate(LATERAL, [flight], load_aircraft("cdfp"), ("ml", "ls")).flights[0]
    assert found.structure is not None
    assert found.structure.added == ("delay_beta",)
    assert found.verdict is not None
    assert found.verdict.recommended.method == "ml"
    assert "agrees" not in found.verdict.recommended.why
    only = {"ml": replace(found.results["ml"], status=output_error_module.Status.DIVERGED), "ls": found.results["ls"]}
    assert "takes records for the true motion, from which delay_beta" in verdict(only).recommended.why


def test_a_filter_that_leaves_a_late_vane_aside_is_not_believed_in_rough_air(rough: Mapping[str, Result]) -> None:
    lag = [c for c in structure_candidates(LATERAL) if c.name == "delay_beta"]
    late = {m: replace(r, model=with_candidates(r.model, lag)) for m, r in rough.items()}
    found = verdict(late).recommended
    assert found.method == NO_METHOD
    assert "does not correct by the late record" in found.why


def test_a_record_without_noise_has_no_process_noise(rough: Mapping[str, Result]) -> None:
    """What a filter takes up where output error leaves less than any instrument's noise; not where it leaves more, nor where the
    two differ."""

    def without_noise(result: Result, size: float, r2: float) -> Result:
        flights = tuple(
            replace(f, residuals=size * f.residuals, fit={n: replace(m, r2=r2) for n, m in f.fit.items()})
            for f in result.flights
        )
        return replace(result, flights=flights)

    ml = rough["ml"]
    agreeing = moved(rough["fem"], **{n: e.estimate for n, e in ml.parameters.items()})

    def recommended(fem: Result, size: float = 0.05, r2: float = 0.999) -> str:
        return verdict({"ml": without_noise(ml, size, r2), "fem": without_noise(fem, size, r2)}).recommended.method

    assert recommended(agreeing) == "ml"
    assert recommended(agreeing, size=1.0) == "fem"
    assert recommended(agreeing, r2=0.9) == "fem"
    bound = math.hypot(ml.parameters["Cl_p"].std_coloured, agreeing.parameters["Cl_p"].std_coloured)
    assert recommended(moved(agreeing, Cl_p=ml.parameters["Cl_p"].estimate + 4.0 * bound)) == "fem"


def test_a_filter_of_few_numbers_is_not_believed(rough: Mapping[str, Result]) -> None:
    """Residuals at every twentieth sample: fewer than eight for each parameter and gain."""
    fem = rough["fem"]
    thin = [
        replace(f, residuals=np.where(np.arange(f.samples)[:, None] % 20 == 0, f.residuals, np.nan))
        for f in fem.flights
    ]
    assert verdict({"fem": fem}).recommended.method == "fem"
    recommended = verdict({"fem": replace(fem, flights=tuple(thin))}).recommended
    assert recommended.method == "none"
    assert "few for its" in recommended.why


def test_reconstructed_angles_leave_output_error_alone(rough: Mapping[str, Result]) -> None:
    found = verdict(rough, reconstructed=("beta",))
    assert found.recommended.method == "ml"
    assert "reconstructed" in found.recommended.why
    against = {d.text.split(":")[0] for d in found.doubts if d.kind is DoubtKind.RECONSTRUCTED}
    assert against == {"fem", "ls"}
    assert verdict({"ls": rough["ls"]}, reconstructed=("beta",)).recommended.method == NO_METHOD


def test_a_flight_says_which_of_its_angles_were_reconstructed() -> None:
    flight = fly(Case(noise=NOISE), np.random.default_rng(23))[0][0]
    detail = {**flight.provenance.detail, "reconstructed": {"columns": ["V", "alpha", "beta"]}}
    flight = replace(flight, provenance=replace(flight.provenance, detail=detail))
    session = runner.estimate(LATERAL, [flight], load_aircraft("cdfp"), ("ml", "ls"))
    found = session.flights[0].verdict
    assert found is not None
    assert "beta reconstructed" in found.recommended.why or "alpha and beta reconstructed" in found.recommended.why


def test_process_noise_is_looked_for_where_forces_act() -> None:
    assert driven_outputs(LATERAL) == {"beta", "p", "r", "ay"}


def test_the_gain_of_a_filter_over_itself_is_nothing(calm: Mapping[str, Result]) -> None:
    same = gain_of_filter(calm["fem"], calm["fem"])
    assert (same.gain, same.size, same.beyond_chance) == (0.0, 0.0, False)
    assert same.chance == pytest.approx(
        37.7, abs=8.0
    )  # of chi-square with some 20 degrees of freedom at one in a thousand


def test_two_manoeuvres_of_a_jet_in_turbulence() -> None:
    """Recommended CY_p and CY_dr within three bounds of truth; output error alone warns."""
    model = load_model("lateral", JET_AIRCRAFT)
    flights, joint = jet_flights(1.0, 1), joint_model(model)
    results = {m: runner.run_method(m, joint, flights, JET_AIRCRAFT) for m in METHODS}
    best = results[verdict(results).recommended.method]
    for name in ("CY_p", "CY_dr"):
        e = best.parameters[name]
        assert abs(e.estimate - JET_TRUE[name]) < 3.0 * e.std_coloured
    alone = verdict({"ml": results["ml"]})
    assert alone.recommended.method == NO_METHOD
    assert {d.kind for d in alone.doubts} == {DoubtKind.PROCESS_NOISE}


def test_methods_that_contradict_each_other_leave_nobody(calm: Mapping[str, Result]) -> None:
    other = moved(calm["ls"], CY_dr=1.9 * calm["ls"].parameters["CY_dr"].estimate)
    found = verdict({"ml": calm["ml"], "ls": other})
    assert found.recommended.method == NO_METHOD
    assert any(d.kind is DoubtKind.DISAGREEMENT and "CY_dr" in d.text for d in found.doubts)


@pytest.mark.parametrize("bias", [2.9, 0.3])
def test_a_bias_that_no_instrument_has(calm: Mapping[str, Result], bias: float) -> None:
    flight = fly(Case(noise=NOISE), np.random.default_rng(21))[0][0]
    model = LATERAL.with_biases("ay").with_starts(bias_ay=bias).fixed("CY_0")
    shifted = flight.with_columns(ay=flight["ay"] + bias)
    result = output_error(model, shifted)
    assert result.parameters["bias_ay"].estimate == pytest.approx(bias, abs=0.2)
    found = verdict({"ml": result})
    kinds = {d.kind for d in found.doubts}
    assert (DoubtKind.INSTRUMENT in kinds) == (bias > 1.0)
    assert found.recommended.method == (NO_METHOD if bias > 1.0 else "ml")


def test_a_joint_estimate_outside_its_members_is_doubted(calm: Mapping[str, Result]) -> None:
    ml = calm["ml"]
    e = ml.parameters["CY_p"]
    inside = verdict({"ml": ml}, members={"ml": [ml, moved(ml, CY_p=e.estimate + 0.2 * e.std)]})
    assert DoubtKind.JOINT not in {d.kind for d in inside.doubts}
    assert inside.recommended.method == "ml"
    far = moved(ml, CY_p=e.estimate + 6.0 * e.std_coloured)
    outside = verdict({"ml": far}, members={"ml": [ml, ml]})
    (doubt,) = [d for d in outside.doubts if d.kind is DoubtKind.JOINT]
    assert "CY_p" in doubt.text
    assert outside.recommended.method == NO_METHOD


def test_what_tells_no_derivative_is_not_recommended(calm: Mapping[str, Result]) -> None:
    derivatives = set(calm["ml"].model.free_names) - {"CY_0", "Cl_0", "Cn_0"}
    blind = {
        n: replace(e, identifiable=False, std_coloured=0.0) if n in derivatives else replace(e, identifiable=True)
        for n, e in calm["ml"].parameters.items()
    }
    answer = verdict({"ml": replace(calm["ml"], parameters=blind)}).recommended
    assert answer.method == NO_METHOD
    assert "none of the derivatives" in answer.why


def test_a_record_of_noise_alone_recommends_nothing() -> None:
    rng = np.random.default_rng(411)
    flight = fly(Case(noise=NOISE), rng)[0][0]
    still = {n: 1e-6 * rng.standard_normal(len(flight)) for n in ("p", "r", "beta", "phi", "ay", "delta_a", "delta_r")}
    session = runner.estimate(load_model("lateral", "cdfp"), [flight.with_columns(**still)], load_aircraft("cdfp"))
    answer = session.flights[0].verdict
    assert answer is not None
    assert answer.recommended.method == NO_METHOD
    assert "none of the outputs" in answer.recommended.why


def test_a_method_that_did_not_converge_is_not_recommended(calm: Mapping[str, Result]) -> None:
    lost = replace(calm["ml"], status=output_error_module.Status.STALLED, text="stalled")
    found = verdict({"ml": lost, "fem": calm["fem"], "ls": calm["ls"]})
    assert found.recommended.method == "fem"
    assert verdict({}, {"ml": "it failed"}).recommended.method == NO_METHOD


# ------------------------------------------------------------------------------------------- failures lose nothing else


def _broken(task: Task) -> Result:
    if task.flights[0].name == "made_1" or len(task.flights) > 1:
        raise np.linalg.LinAlgError("Matrix is not positive definite")
    from estimation.estimators.equation_error import equation_error

    return equation_error(task.model, task.flights)


def test_a_failing_method_is_a_sentence_and_loses_no_other_result(
    made_flights: list[Flight], monkeypatch: pytest.MonkeyPatch
) -> None:
    own = Estimator("broken", "one that breaks", _broken)
    usual = runner.find_estimator
    monkeypatch.setattr(runner, "find_estimator", lambda name: own if name == "broken" else usual(name))
    session = runner.estimate(LATERAL, made_flights[:2], load_aircraft("cdfp"), ["ls", "broken"], joint=True)
    first, second = session.flights
    assert set(first.results) == {"ls", "broken"}
    assert set(second.results) == {"ls"}
    assert "not positive definite" in second.failures["broken"]
    assert set(session.joint) == {"ls"}
    assert "not positive definite" in session.joint_failures["broken"]
    assert not session.converged
    data = json.loads(json.dumps(session.to_json(), allow_nan=False))
    assert data["flights"][1]["methods"]["broken"]["converged"] is False
    assert any(d["kind"] == "failed" for d in data["flights"][1]["doubts"])


def test_a_flight_that_no_method_can_use_is_still_refused(made_flights: list[Flight]) -> None:
    lacking = made_flights[0].with_columns(delta_a=np.full(len(made_flights[0]), np.nan))
    with pytest.raises(MissingColumnError, match="delta_a"):
        runner.estimate(LATERAL, [lacking], load_aircraft("cdfp"), ["ml", "ls"])


# --------------------------------------------------------------------------------------- cannot tell, and initial states


def test_a_bias_known_precisely_to_be_small_is_told(made_flights: list[Flight]) -> None:
    model = LATERAL.with_biases("phi").fixed("CY_0", "Cl_0", "Cn_0")
    bias = output_error(model.with_starts(TRUE), made_flights[0]).parameters["bias_phi"]
    assert abs(bias.estimate) < 4.0 * bias.std
    assert bias.identifiable, bias.why


def test_what_cannot_be_told_is_printed_with_its_bound(made_flights: list[Flight], tmp_path: Path) -> None:
    still = made_flights[0].with_columns(delta_r=0.0 * made_flights[0]["delta_r"])
    write_flight(still, tmp_path / "f.csv")
    out = CliRunner().invoke(estimate, [str(tmp_path / "f.csv"), "--aircraft", "cdfp"], standalone_mode=False)
    assert out.exception is None
    (line,) = [row for row in out.output.splitlines() if row.strip().startswith("Cn_dr") and "cannot tell: " in row]
    assert "wider than 1e-12" not in out.output
    assert math.isfinite(float(line.split()[1]))
    assert "recommended: " in out.output


def test_initial_states_are_held_by_model_file_option_and_command_line(
    made_flights: list[Flight], tmp_path: Path
) -> None:
    held = LATERAL.with_initial("phi", held=True, values={"beta": 0.01})
    write_model(held, tmp_path / "m.toml")
    assert read_model(tmp_path / "m.toml") == held
    result = output_error(held, made_flights[0])
    start = dict(zip(LATERAL.state_names, result.flights[0].initial_states[0], strict=True))
    free = output_error(LATERAL, made_flights[0])
    assert start["beta"] == 0.01
    other = dict(zip(LATERAL.state_names, free.flights[0].initial_states[0], strict=True))
    assert other["beta"] != 0.01
    released = output_error(held, made_flights[0], options=OutputErrorOptions(free_states=LATERAL.state_names))
    assert released.cost == pytest.approx(free.cost, rel=1e-6)
    write_flight(made_flights[0], tmp_path / "f.csv")
    costs = {}
    for name, options in {
        "held": ["--model", "lateral", "--hold-initial", "phi,beta=0.01"],
        "freed": ["--model", str(tmp_path / "m.toml"), "--free-initial", "all"],
    }.items():
        arguments = [str(tmp_path / "f.csv"), "--aircraft", "cdfp", "--json", str(tmp_path / "e.json"), *options]
        assert CliRunner().invoke(estimate, arguments, standalone_mode=False).exception is None
        costs[name] = json.loads((tmp_path / "e.json").read_text())["flights"][0]["methods"]["ml"]["cost"]
    assert costs["held"] == pytest.approx(result.cost, rel=1e-6)
    assert costs["freed"] == pytest.approx(free.cost, rel=1e-6)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--hold-initial", "x"], "no state 'x'"),
        (["--hold-initial", "phi=much"], "not a number"),
        (["--free-initial", "phi=1"], "a value is for --hold-initial"),
        (["--hold-initial", "phi", "--free-initial", "phi"], "choose one"),
    ],
)
def test_nonsense_of_initial_states_is_refused(
    made_flights: list[Flight], tmp_path: Path, options: list[str], said: str
) -> None:
    write_flight(made_flights[0], tmp_path / "f.csv")
    out = CliRunner().invoke(estimate, [str(tmp_path / "f.csv"), "--aircraft", "cdfp", *options], standalone_mode=False)
    assert said in str(out.exception)
