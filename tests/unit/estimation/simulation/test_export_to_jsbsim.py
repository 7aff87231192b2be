"""What is written for JSBSim does in JSBSim what the model's text says: forces, moments, actuators, lags, inertia."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from click.testing import CliRunner

pytest.importorskip("jsbsim", reason="the package jsbsim is not installed")

from estimation.engine.trace import CASADI_FUNCTIONS
from estimation.gap.effects import catalogue
from estimation.models import load_model, write_model
from estimation.models.base import Model, Parameter
from estimation.models.expressions import evaluate
from estimation.prepare.pipeline import prepare
from estimation.simulation.along_flight import column_name
from estimation.simulation.attach import Attached, attach, simulation_of
from estimation.simulation.conversion import export_to_jsbsim
from estimation.simulation.jsbsim import flying
from estimation.simulation.jsbsim.components import chains_of
from estimation.simulation.jsbsim.export import WrittenAircraft, export_aircraft, inlined
from estimation.simulation.jsbsim.flying import fly_aircraft
from estimation.simulation.jsbsim.functions import Translator
from estimation.simulation.jsbsim.increments import increments_of
from estimation.simulation.jsbsim.library import aircraft_file, loaded
from estimation.simulation.oracle import COEFFICIENTS, VARIABLES, Array, Oracle, Simulation, SimulationError, States
from estimation.simulation.proof import AS_IT_IS, proof_of, step_model
from groundstation.flight import Flight
from sideslip.cli import cli

EFFECTS = {e.name: e for e in catalogue()}
CESSNA = aircraft_file("c172p")


def with_effect(model: Model, name: str, **values: float) -> Model:
    form = next(f for f in EFFECTS[name].forms if {p.name for p in f.parameters} == set(values))
    return form.added_to(model, values)


@pytest.fixture(scope="module")
def glided() -> Flight:
    flight = fly_aircraft(CESSNA, inlined(CESSNA), False, 120.0, {})
    return Flight.build("glide", flight.time[::6], {n: v[::6] for n, v in flight.columns.items()})


@pytest.fixture(scope="module")
def attached(glided: Flight) -> Attached:
    return attach("jsbsim:c172p", "lateral", [glided])


@pytest.fixture(scope="module")
def whole(glided: Flight) -> Attached:
    return attach("jsbsim:c172p", "six-dof", [glided])


class Remembering:
    """An oracle that is asked for the same states once: the unchanged aircraft flies the same in every comparison."""

    def __init__(self, oracle: Oracle) -> None:
        self._oracle = oracle
        self._known: dict[bytes, Array] = {}

    def coefficients(self, states: States) -> Array:
        key = b"".join(v.tobytes() for v in (*states.values.values(), states.rho, states.alpha_dot))
        if key not in self._known:
            self._known[key] = self._oracle.coefficients(states)
        return self._known[key]


@pytest.fixture(scope="module")
def remembering(attached: Attached) -> Simulation:
    return replace(attached.simulation, oracle=Remembering(attached.simulation.oracle))


def states(count: int = 8) -> States:
    rng = np.random.default_rng(5)
    sizes = {"V": 3.0, "p": 0.2, "q": 0.1, "r": 0.1, "thrust": 0.0}
    values = {n: (50.0 if n == "V" else 0.0) + rng.normal(0.0, sizes.get(n, 0.05), count) for n in VARIABLES}
    return States(values, np.full(count, 1.05), np.zeros(count))


CHANGES: dict[
    str, tuple[Callable[[Model], Model], Callable[[dict[str, np.ndarray], np.ndarray], dict[str, np.ndarray]]]
] = {
    "moment": (
        lambda m: with_effect(m, "Cn_da", Cn_da=-0.012),
        lambda x, c: {"Cn": -0.012 * x["delta_a"]},
    ),
    "side force": (
        lambda m: with_effect(m, "CY_da", CY_da=0.05),
        lambda x, c: {"CY": 0.05 * x["delta_a"]},
    ),
    "factors": (
        lambda m: m.with_starts(k_CY=1.1, k_Cl=1.05, k_Cn=0.97, k_CL=1.04, k_CD=1.2, k_Cm=0.9),
        lambda x, c: {
            "CY": 0.1 * c[:, 1],
            "Cl": 0.05 * c[:, 3],
            "Cn": -0.03 * c[:, 5],
            "Cm": -0.1 * c[:, 4],
            "CX": -0.2 * np.cos(x["alpha"]) * -(c[:, 0] * np.cos(x["alpha"]) + c[:, 2] * np.sin(x["alpha"]))
            + 0.04 * np.sin(x["alpha"]) * (c[:, 0] * np.sin(x["alpha"]) - c[:, 2] * np.cos(x["alpha"])),
            "CZ": -0.2 * np.sin(x["alpha"]) * -(c[:, 0] * np.cos(x["alpha"]) + c[:, 2] * np.sin(x["alpha"]))
            - 0.04 * np.cos(x["alpha"]) * (c[:, 0] * np.sin(x["alpha"]) - c[:, 2] * np.cos(x["alpha"])),
        },
    ),
    "derivative, cubic, rates": (
        lambda m: with_effect(
            with_effect(m.with_starts(Cl_p=m.parameter("Cl_p").start - 0.1), "Cn_beta3", Cn_beta3=1.0),
            "Cl_p_abs_p",
            Cl_p_abs_p=-1.5,
        ),
        lambda x, c: {
            "Cl": (p := x["p"] * 10.91184 / (2 * x["V"])) * (-0.1 - 1.5 * np.abs(p)),
            "Cn": x["beta"] ** 3,
        },
    ),
}


@pytest.mark.parametrize("name", CHANGES)
def test_coefficients_of_the_written_aircraft_are_the_model_s(whole: Attached, tmp_path: Path, name: str) -> None:
    """JSBSim's own forces and moments, about its CG, against the coefficient by hand; wind axes and AERORP included."""
    change, by_hand = CHANGES[name]
    made, _, _ = export_aircraft(change(whole.model), CESSNA, tmp_path, "why", 120.0)
    x = states()
    before = whole.simulation.oracle.coefficients(x)
    after = simulation_of(f"jsbsim:{made.file.parent}").oracle.coefficients(x)
    wanted = {c: np.zeros(len(x)) for c in COEFFICIENTS} | by_hand(dict(x.values), before)
    for i, c in enumerate(COEFFICIENTS):
        np.testing.assert_allclose(after[:, i] - before[:, i], wanted[c], atol=2e-7, err_msg=c)
    assert "why" in made.file.read_text(encoding="utf-8")


SECONDS = 12.0  # of the flights compared: those of aileron and rudder; the elevator's say nothing of a lateral model

FLOWN: dict[str, Callable[[Model], Model]] = {
    "as found": lambda m: with_effect(m.with_starts(Cl_p=-0.6, k_Cn=1.1, CY_0=0.002), "rudder_lag", rudder_lag=0.06),
    "delay": lambda m: with_effect(m, "aileron_delay", aileron_delay=0.03),
    "dead zone and play": lambda m: with_effect(
        with_effect(m, "aileron_deadzone", aileron_deadzone=0.01), "rudder_backlash", rudder_backlash=0.015
    ),
    "lagging sideslip": lambda m: with_effect(m, "indicial_lag", indicial_lag=0.1),
    "inertia": lambda m: with_effect(m, "Ixz_error", Ixz=m.constants["Ixz"] + 100.0),
}


@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", FLOWN)
def test_the_written_aircraft_flies_like_the_model_and_the_unchanged_one_does_not(
    attached: Attached, remembering: Simulation, tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(flying, "DURATION", SECONDS)
    write_model(FLOWN[name](attached.model), tmp_path / "child.toml")
    done = export_to_jsbsim(tmp_path / "child.toml", None, tmp_path / "out")
    assert not done.proof.failed, done.sentence()
    record = json.loads((done.exported.file.parent / "sideslip.json").read_text(encoding="utf-8"))
    assert record["proved"]
    assert record["simulation"] == "jsbsim:c172p"
    unchanged = WrittenAircraft(inlined(CESSNA), (), {})
    model = increments_of(FLOWN[name](attached.model))
    assert len(proof_of(CESSNA, remembering, unchanged, replace(model, transforms=()), 120.0).failed) > 2


def test_an_exported_aircraft_can_be_asked_again(attached: Attached, tmp_path: Path) -> None:
    made, _, _ = export_aircraft(FLOWN["as found"](attached.model), CESSNA, tmp_path, "", 120.0)
    again = simulation_of(f"jsbsim:{made.file.parent}")
    per_rudder = [
        s.oracle.coefficients(states().moved("delta_r", 0.1))[:, 5] - s.oracle.coefficients(states())[:, 5]
        for s in (attached.simulation, again)
    ]
    np.testing.assert_allclose(per_rudder[1], 1.1 * per_rudder[0], atol=1e-7)  # k_Cn
    assert "without the actuator" in " ".join(again.notes)


@pytest.mark.timeout(300)
def test_at_60_hz_the_proof_holds_and_says_what_the_steps_alone_are_off_by(
    attached: Attached, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Edges of the aileron come half a frame late in JSBSim's steps: more than is allowed of aerodynamics."""
    monkeypatch.setattr(flying, "DURATION", 5.0)  # s: that of the ailerons
    write_model(attached.model.with_starts(Cl_p=-0.6), tmp_path / "child.toml")
    words = ["export", str(tmp_path / "child.toml"), "--to", "jsbsim", "--out", str(tmp_path / "out")]
    steps = {}
    for rate in (60.0, 120.0):
        done = CliRunner().invoke(cli, [*words, "--rate", str(rate)], standalone_mode=False)
        assert done.return_value == 0, done.output
        assert "within a tenth of sensor noise" in done.output
        assert f"at {rate:g} Hz its steps alone put p off by" in done.output
        record = json.loads((tmp_path / "out" / "c172p-sideslip" / "sideslip.json").read_text(encoding="utf-8"))
        steps[rate] = record["proof"]["p"]["steps"] / record["proof"]["p"]["allowed"]
        assert record["proof"]["p"]["rms"] < 0.2 * record["proof"]["p"]["allowed"]
    assert steps[60.0] > 1.0 > steps[120.0]
    assert steps[60.0] / steps[120.0] == pytest.approx(4.6, rel=0.15)  # second order, and a servo that frames chop


def test_a_wrong_derivative_fails_the_proof_however_coarse_the_steps(
    attached: Attached, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A hundredth of the roll damping, at a rate whose steps are off by ten times more."""
    monkeypatch.setattr(flying, "DURATION", 5.0)
    model = attached.model.with_starts(Cl_p=attached.model.parameter("Cl_p").start * 1.2)
    _, made, found = export_aircraft(model, CESSNA, tmp_path, "", 30.0)
    wrong = replace(found, physical=found.physical.with_starts(Cl_p=found.physical.parameter("Cl_p").start * 1.01))
    assert not proof_of(CESSNA, attached.simulation, made, found, 30.0).failed
    assert "p" in proof_of(CESSNA, attached.simulation, made, wrong, 30.0).failed


TWO_STATES = {
    "name": "two", "states": ["x", "z"], "inputs": ["u"], "outputs": ["x", "z"], "parameters": [],
    "constants": {"L": 5.0, "tau": 0.1}, "equations": ["x_dot = L*u", "z_dot = (u - z)/tau"],
}  # fmt: skip


def test_steps_are_those_that_jsbsim_takes() -> None:
    """Closed form: of p_dot = L u the rule is late by h/2 times the last change of L u; a filter is trapezoidal."""
    model = Model.from_dict(TWO_STATES)
    time = np.linspace(0.0, 0.78, 40)
    u = np.where(time > 0.3, 1.0 - np.exp(-(time - 0.3) / 0.05), 0.0)
    flight = Flight.build("f", time, {"x": u, "z": u, "u": u})
    data = prepare(model, flight, AS_IT_IS)
    x, z = step_model(model, data, np.zeros(2), ("z",)).T
    straight = np.append(0.0, np.cumsum(0.01 * 5.0 * (u[1:] + u[:-1])))
    np.testing.assert_allclose(x, straight - 0.01 * 5.0 * np.diff(u, prepend=0.0), atol=1e-12)
    share = 0.01 / 0.1
    for k in range(39):
        assert z[k + 1] == pytest.approx(((1 - share) * z[k] + share * (u[k] + u[k + 1])) / (1 + share), abs=1e-12)


def test_what_is_no_aircraft_s_is_left_out_and_said(attached: Attached, tmp_path: Path) -> None:
    model = with_effect(with_effect(attached.model, "beta_scale", beta_scale=0.1), "time_skew", time_skew_air_data=0.05)
    made, _, found = export_aircraft(with_effect(model, "beta_lag", beta_lag=0.07), CESSNA, tmp_path, "", 120.0)
    assert made.terms == ()
    assert [w.split()[0] for w in found.left_out] == ["beta", "delay"]


def test_a_share_of_what_the_simulation_has_is_left_out_and_said(attached: Attached) -> None:
    """A base that was refitted in all derivatives has such shares; a rudder that lags beside them ended the export."""
    share = column_name("Cn", "delta_a")
    refitted = attached.model.plus(terms={"Cn": f"off_Cn_delta_a*{share}"}, parameters=[Parameter("off_Cn_delta_a")])
    found = increments_of(with_effect(refitted, "rudder_lag", rudder_lag=0.06))
    (words,) = [w for w in found.left_out if share in w]
    assert words.endswith("in Cn: a share of what the simulation has itself")
    assert all(share not in a.text for a in found.addends)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda m: replace(m, constants={**m.constants, "m": 900.0}), "mass is 900 kg"),
        (lambda m: m.plus(terms={"q_dyn": "1"}), "changes the line q_dyn"),
        (lambda m: m.plus(terms={"Cn": "0.1*V_dot"}), "no property for V_dot"),
    ],
)
def test_what_cannot_be_written_is_refused_before_anything_is(
    attached: Attached, tmp_path: Path, change: Callable[[Model], Model], told: str
) -> None:
    with pytest.raises(SimulationError, match=told):
        export_aircraft(change(attached.model), CESSNA, tmp_path / "out", "", 120.0)
    assert not (tmp_path / "out").exists()


def test_a_delay_counts_frames_of_the_rate_it_is_written_for(attached: Attached) -> None:
    """30 ms are 3.6 frames at 120 Hz: four tenths of three, six of four; JSBSim's actuators delay by one less than they say."""
    model = with_effect(attached.model, "rudder_delay", rudder_delay=0.03)
    _, parts = chains_of(increments_of(model), model.starts(), CESSNA, 120.0)
    assert [e.findtext("delay") for e in parts[:2]] == ["4", "5"]
    assert [float(e.findtext("gain") or 0.0) for e in parts[2:4]] == pytest.approx([0.4, 0.6])


@pytest.mark.parametrize(
    "text",
    [
        "1.5*tanh(3*beta) - cosh(p)",
        "where(beta < 0.02, beta^3, sqrt(abs(alpha)))",
        "-(V - 40)^2/rho",
        "sign(r)*exp(q)*max(p, r)",
        "atan2(p, r) + log(V)",
        "sinh(beta) - min(alpha, 2*beta)/3",
    ],
)
def test_any_expression_has_in_jsbsim_the_value_it_has_here(attached: Attached, tmp_path: Path, text: str) -> None:
    term = Translator(attached.model, {}).term(text)
    assert isinstance(term, ET.Element)
    root = inlined(CESSNA)
    aerodynamics = root.find("aerodynamics")
    assert aerodynamics is not None
    function = ET.Element("function", name="aero/test")
    function.append(term)
    aerodynamics.insert(0, function)
    fdm = loaded(CESSNA, root=root)
    for beta, p, r in ((0.1, 0.2, -0.1), (-0.05, -0.1, 0.3)):
        fdm["ic/vt-fps"], fdm["ic/beta-rad"], fdm["ic/p-rad_sec"], fdm["ic/r-rad_sec"] = 160.0, beta, p, r
        fdm["ic/alpha-rad"], fdm["ic/q-rad_sec"] = 0.04, 0.05
        fdm.run_ic()
        symbols = {"beta": beta, "p": p, "q": 0.05, "r": r, "alpha": 0.04, "V": 160.0 * 0.3048}
        symbols["rho"] = fdm["atmosphere/rho-slugs_ft3"] * 14.593902937206 / 0.3048**3
        assert fdm["aero/test"] == pytest.approx(float(evaluate(text, symbols, CASADI_FUNCTIONS)), rel=1e-6)


class TestVerb:
    def test_a_proof_that_fails_is_told_and_ends_with_1(
        self, attached: Attached, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        write_model(with_effect(attached.model, "Cn_da", Cn_da=-0.012), tmp_path / "child.toml")
        monkeypatch.setattr("estimation.simulation.proof.SHARE", 1e-6)  # nothing flies so exactly
        done = CliRunner().invoke(
            cli,
            ["export", str(tmp_path / "child.toml"), "--to", "jsbsim", "--rate", "20", "--out", str(tmp_path)],
            standalone_mode=False,
        )
        assert done.return_value == 1
        assert "proof failed" in done.output

    def test_nonsense_is_refused(self, tmp_path: Path) -> None:
        write_model(load_model("lateral", "cdfp"), tmp_path / "plain.toml")
        runner = CliRunner()
        told = runner.invoke(
            cli, ["export", str(tmp_path / "plain.toml"), "--to", "jsbsim", "--out", str(tmp_path / "o")]
        )
        assert "--aircraft-from" in str(told.exception)
        words = ["--to", "jsbsim", "--aircraft-from", "jsbsim:c172p", "--out", str(tmp_path / "o")]
        assert "stands on no simulation" in str(
            runner.invoke(cli, ["export", str(tmp_path / "plain.toml"), *words]).exception
        )
        no_folder = runner.invoke(cli, ["export", str(tmp_path / "plain.toml"), "--to", "jsbsim"])
        assert "--out DIR" in str(no_folder.exception)
        assert "-o OUTPUT" in str(runner.invoke(cli, ["export", str(tmp_path / "plain.toml")]).exception)
