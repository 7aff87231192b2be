"""A simulation along flights and the model on it, against models whose coefficients are known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from estimation.errors import AircraftError, EstimationError
from estimation.estimators.output_error import output_error
from estimation.gap.effects import catalogue
from estimation.gap.shapes.places import coefficient_lines, variables_of
from estimation.models import InputTransform, Model, Parameter, load_model, read_model, write_model
from estimation.resolve import resolve
from estimation.session.proof_of_match import predict_flight
from estimation.simulation import along_flight
from estimation.simulation.attach import (
    Free,
    attach,
    estimated_about_its_motion,
    motion_settled,
    renewed_attachment,
    simulation_of,
)
from estimation.simulation.oracle import VARIABLES, SimulationError, States
from groundstation.flight import Flight, Provenance, read_flight
from tests.studies import second_truth as truth
from tests.support.paths import ROOT

LD4 = ROOT / "recordings" / "cdfp_ld4.mcap"

FUNCTION = """
import numpy as np

def many(V, alpha, beta, p, q, r, surfaces, thrust, rho):
    return -0.02, -0.12*beta, -3.0*alpha, -0.09*beta - 0.1*surfaces["delta_a"], None, 0.02*beta + 0.1*beta**3

def one(V, alpha, beta, p, q, r, surfaces, thrust, rho):
    slope = 0.02 if beta < 10 else 0.0     # a branch: numbers only
    return -0.02, -0.12*beta, -3.0*alpha, -0.09*beta - 0.1*surfaces["delta_a"], None, slope*beta + 0.1*beta**3

def rated(V, alpha, beta, p, q, r, surfaces, thrust, rho, alpha_dot):
    return None, None, -3.0*alpha, None, -0.5*alpha - 7.0*alpha_dot*0.3/(2*V), None

def rated_alone(V, alpha, beta, p, q, r, surfaces, thrust, rho, *, alpha_dot=0.0):
    return None, None, -3.0*alpha, None, (-0.5*alpha if beta < 9 else 0) - 7.0*alpha_dot*0.3/(2*V), None

def wrong(V, alpha, beta, p, q, r, surfaces, thrust, rho):
    return 1.0, surfaces["aileron"]

def short(V, alpha, beta, p, q, r, surfaces, thrust, rho):
    return 1.0, 2.0

number = 3
"""


@pytest.fixture
def functions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    name = f"own_{tmp_path.name.replace('-', '_')}"
    (tmp_path / f"{name}.py").write_text(FUNCTION, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return name


def states(count: int = 5) -> States:
    rng = np.random.default_rng(2)
    values = {n: (20.0 if n == "V" else 0.0) + rng.normal(0.0, 0.1, count) for n in VARIABLES}
    return States(values, np.full(count, 1.2), np.zeros(count))


class TestFunction:
    def test_arrays_and_numbers_give_the_same(self, functions: str) -> None:
        x = states()
        many, one = (simulation_of(f"{functions}:{n}").oracle.coefficients(x) for n in ("many", "one"))
        np.testing.assert_allclose(many, one)
        np.testing.assert_allclose(many[:, 5], 0.02 * x.values["beta"] + 0.1 * x.values["beta"] ** 3)
        assert np.isnan(many[:, 4]).all()

    def test_one_that_asks_for_the_rate_of_alpha_is_given_it(self, functions: str) -> None:
        """Without it, pitch damping would be found to be off by what goes with that rate."""
        x = replace(states(), alpha_dot=np.array([0.3, -0.2, 0.0, 0.1, 0.5]))
        for name in ("rated", "rated_alone"):
            found = simulation_of(f"{functions}:{name}").oracle.coefficients(x)[:, 4]
            by_hand = -0.5 * x.values["alpha"] - 7.0 * x.alpha_dot * 0.3 / (2 * x.values["V"])
            np.testing.assert_allclose(found, by_hand, rtol=1e-12)

    def test_mistakes_are_told(self, functions: str) -> None:
        for name, told in (("wrong", "KeyError"), ("short", "six coefficients")):
            with pytest.raises(SimulationError, match=told):
                simulation_of(f"{functions}:{name}").oracle.coefficients(states())
        for name, told in (("number", "not a function"), ("absent", "no 'absent'")):
            with pytest.raises(SimulationError, match=told):
                simulation_of(f"{functions}:{name}")

    def test_a_model_that_needs_more_is_refused(self, functions: str) -> None:
        with pytest.raises(SimulationError, match="gives no Cm"):
            attach(f"{functions}:many", "six-dof", [read_flight(LD4)])


@pytest.fixture(scope="module")
def short() -> Flight:
    """Twelve seconds by the second truth."""
    return flown()


def flown(manoeuvres: str = "rich") -> Flight:
    (columns,) = truth.fly([truth.Request(3, duration=12.0, manoeuvres=manoeuvres)])
    return Flight.build("f", columns.pop("time"), columns, provenance=Provenance(aircraft="cdfp"))


@pytest.mark.parametrize("sideslip", [0.0, 0.1])
def test_noise_of_a_vane_that_nothing_moves_is_no_sideslip(sideslip: float) -> None:
    """Smoothing leaves 0.03 deg of 0.15, whose mean size a drag by |sideslip| would take for sideslip; a sine stays as it is."""
    time = np.arange(0.0, 20.0, 0.05)
    true = sideslip * np.sin(2.0 * time)
    still = dict.fromkeys(("p", "q", "r", "phi", "theta", "delta_e", "ax", "ay", "az", "thrust"), np.zeros(time.size))
    air = {"V": np.full(time.size, 20.0), "rho": np.full(time.size, 1.2), "alpha": 0.05 * np.sin(time)}
    vane = true + 0.0026 * np.random.default_rng(5).standard_normal(time.size)
    flight = Flight.build("f", time, {**still, **air, "beta": vane}, provenance=Provenance())
    model = load_model("longitudinal", "cdfp")
    found, usable, _ = along_flight.motion(model, flight, {}, along_flight.AS_MOTION)
    error = found.values["beta"] - true[usable] - np.mean(vane - true)
    assert np.sqrt(np.mean(error**2)) < (0.0022 if sideslip else 1e-4)


@pytest.mark.parametrize("which", ["lateral", "longitudinal", "six-dof"])
def test_a_linear_simulation_moves_as_the_model_it_is(which: str, short: Flight, tmp_path: Path) -> None:
    """Our own text as simulation: what moves on its columns is what moves by its equations."""
    plain = load_model(which, "cdfp")
    if "CD_k" in plain.parameter_names:
        plain = plain.with_starts(CD_k=0.0)  # the only square
    write_model(plain, tmp_path / "own.toml")
    told = attach(str(tmp_path / "own.toml"), which, [short], free=Free.NOTHING)
    exact = predict_flight(plain, short).predicted
    for moving, share in ((told, 0.05), (renewed_attachment(told), 2e-3)):
        off = np.nanstd(predict_flight(moving.model, moving.flights[0]).predicted - exact, axis=0)
        assert (off < share * np.nanstd(exact, axis=0)).all()
    assert told.model.parameter("k_Cl" if which != "longitudinal" else "k_Cm").start == 1.0
    name = "Cl_p" if which != "longitudinal" else "Cm_q"
    assert told.model.parameter(name).start == pytest.approx(plain.parameter(name).start, rel=2e-3)  # by mean airspeed


def test_a_moment_by_the_rate_of_alpha_follows_the_model_not_the_measured_rate(
    short: Flight, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The measured rate, free of noise, has no edges left: nothing hidden, and yet something that moves like that rate."""
    plain = load_model("longitudinal", "cdfp").with_starts(CD_k=0.0)
    damped = plain.plus(terms={"Cm": "-6*alpha_dot*c/(2*V)"})
    write_model(damped, tmp_path / "own.toml")
    exact = predict_flight(damped, short).predicted
    off = []
    for rate in ("alpha_dot", "no such"):
        monkeypatch.setattr(along_flight, "ALPHA_RATE", rate)
        told = attach(str(tmp_path / "own.toml"), "longitudinal", [short], free=Free.NOTHING)
        assert ("sim_Cm_alpha_dot" in told.model.input_names) == (rate == "alpha_dot")
        off.append(np.nanstd(predict_flight(told.model, told.flights[0]).predicted - exact, axis=0)[2:4])  # theta, q
    assert (off[0] < 0.2 * off[1]).all()


LIFTED = """
from numpy import cos, sin

def lifted(V, alpha, beta, p, q, r, surfaces, thrust, rho, alpha_dot):
    chords = {c} / (2 * V)
    lift = {CL_0} + {CL_alpha}*alpha + ({CL_q}*q + 8*alpha_dot)*chords + {CL_de}*surfaces["delta_e"]
    pitch = {Cm_0} + {Cm_alpha}*alpha + {Cm_q}*q*chords + {Cm_de}*surfaces["delta_e"]
    return lift*sin(alpha) - {CD_0}*cos(alpha), None, -lift*cos(alpha) - {CD_0}*sin(alpha), None, pitch, None
"""


def test_lift_by_the_rate_of_alpha_follows_the_model_not_the_measured_rate(
    short: Flight, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Against the catalogue's CL_alphadot, on a flight that moves otherwise than the model: the measured rate is another one."""
    plain = load_model("longitudinal", "cdfp").with_starts(CD_k=0.0)
    text = LIFTED.format(**plain.starts(), **plain.constants)
    (tmp_path / "lift_by_rate.py").write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    (form,) = next(e for e in catalogue(model=plain) if e.name == "CL_alphadot").forms
    exact = predict_flight(form.added_to(plain, {"CL_alphadot": 8.0}), short).predicted
    errors = []
    for by_rate in (("CL",), ()):
        monkeypatch.setattr(along_flight, "BY_ALPHA_RATE", by_rate)
        attached = attach("lift_by_rate:lifted", "longitudinal", [short], free=Free.NOTHING)
        assert ("sim_CL_alpha_dot" in attached.model.input_names) == bool(by_rate)
        assert coefficient_lines(attached.model) == ("CL", "CD", "Cm")
        assert set(variables_of(attached.model, ("CL", "CD", "Cm"))) == {"alpha", "q_hat", "delta_e", "V"}
        settled = motion_settled(attached)
        errors.append(np.std(predict_flight(settled.model, settled.flights[0]).predicted - exact, axis=0))
    assert (errors[0] < 0.2 * errors[1]).all()


def test_derivatives_are_estimated_as_of_the_plain_model(tmp_path: Path) -> None:
    flight = read_flight(LD4)
    plain = load_model("lateral", "cdfp")
    write_model(plain.with_starts(Cl_p=-0.30, Cn_beta=0.015), tmp_path / "own.toml")
    told = estimated_about_its_motion(attach(str(tmp_path / "own.toml"), "lateral", [flight], free=Free.DERIVATIVES))
    of_plain, of_simulation = output_error(plain, flight), output_error(told.model, told.flights[0])
    for name in ("Cl_p", "Cn_beta", "Cl_da", "CY_beta"):
        a, b = of_plain.parameters[name], of_simulation.parameters[name]
        assert abs(a.estimate - b.estimate) < 0.02 * a.std
        assert b.std == pytest.approx(a.std, rel=1e-2)
    assert of_simulation.parameters["Cl_p"].reference == pytest.approx(-0.30, rel=1e-3)


def test_a_prediction_far_from_the_flight_is_renewed_at_its_own_motion(short: Flight, tmp_path: Path) -> None:
    """A cube of sideslip, predicted a third too large: slopes at the measured motion err, slopes at the predicted one do not."""
    plain = load_model("lateral", "cdfp").with_starts(Cl_da=-0.12, Cn_dr=-0.06)
    cubic = plain.plus(terms={"Cn": "0.3*beta^3"})
    write_model(cubic, tmp_path / "cubic.toml")
    first = attach(str(tmp_path / "cubic.toml"), "lateral", [short], free=Free.NOTHING)
    exact = predict_flight(cubic, short).predicted
    off = [
        np.std(predict_flight(a.model, a.flights[0]).predicted - exact)
        for a in (first, renewed_attachment(first), motion_settled(first))
    ]
    assert np.std(exact) > 0.1
    assert off[0] > 0.01  # rad and rad/s, of what moves by tenths
    assert off[1] < 0.2 * off[0]
    assert off[2] < 0.02 * off[0]


LOOSE = {
    "lag": ("elevator_late", 0.08),
    "delay": ("elevator_late", 0.07),
    "backlash": ("elevator_loose", 0.03),
}


@pytest.mark.parametrize("kind", list(LOOSE))
def test_a_simulation_is_asked_where_a_late_or_loose_surface_was(kind: str, tmp_path: Path) -> None:
    """A drag by |elevator| has no slope that holds on both sides of zero: asked at the elevator as recorded it is wrong until the
    late one has crossed, asked at the late one it is right."""
    plain, short = load_model("longitudinal", "cdfp").with_starts(CD_k=0.0), flown("longitudinal")
    kinked = plain.plus(terms={"CD": "0.8*sqrt(delta_e^2 + 1e-8)"})
    write_model(kinked, tmp_path / "kinked.toml")
    name, size = LOOSE[kind]
    late = InputTransform(kind, "delta_e", (name,))

    def moved(model: Model) -> Model:
        return model.plus(parameters=[Parameter(name, "1", size, fixed=True)], transforms=[late])

    exact = predict_flight(moved(kinked), short).predicted
    spec, off = str(tmp_path / "kinked.toml"), []
    for controls in (None, moved(plain)):
        attached = attach(spec, "longitudinal", [short], free=Free.NOTHING, controls=controls)
        write_model(moved(attached.model), tmp_path / "late.toml")
        off.append(np.nanstd(predict_flight(moved(attached.model), attached.flights[0]).predicted[:, 0] - exact[:, 0]))
    assert np.ptp(short["delta_e"]) > 0.05
    assert off[1] < 0.2 * off[0]  # the rest is the measured motion, beside which slopes hold
    # of a model file that says itself how the surface moves nobody has to say it again
    read_back = attach(spec, str(tmp_path / "late.toml"), [short])
    np.testing.assert_allclose(read_back.flights[0]["sim_CD_0"], attached.flights[0]["sim_CD_0"], atol=1e-12)


class TestAircraft:
    def test_of_the_simulation_where_flights_name_none(self, tmp_path: Path) -> None:
        write_model(load_model("lateral", "cdfp"), tmp_path / "own.toml")
        flight = read_flight(LD4)
        nameless = replace(flight, provenance=Provenance())
        heavy = read_model(tmp_path / "own.toml")
        write_model(replace(heavy, constants={**heavy.constants, "m": 5.0}), tmp_path / "own.toml")
        assert attach(str(tmp_path / "own.toml"), "lateral", [nameless]).model.constants["m"] == 5.0
        assert attach(str(tmp_path / "own.toml"), "lateral", [flight]).model.constants["m"] == 3.5

    def test_of_nobody_is_refused(self, functions: str) -> None:
        nameless = replace(read_flight(LD4), provenance=Provenance())
        with pytest.raises(AircraftError, match="--aircraft"):
            attach(f"{functions}:many", "lateral", [nameless])


def test_models_that_stand_on_no_simulation_are_refused(functions: str, tmp_path: Path) -> None:
    write_model(load_model("lateral", "cdfp"), tmp_path / "own.toml")
    for which in (str(tmp_path / "own.toml"), "module:Class"):
        with pytest.raises(EstimationError, match="simulation"):
            attach(f"{functions}:many", which, [read_flight(LD4)])


def test_text_that_no_state_in_the_air_decides_is_refused(tmp_path: Path) -> None:
    model = load_model("lateral", "cdfp")
    write_model(model.plus(terms={"Cl": "0.1*phi"}), tmp_path / "own.toml")
    with pytest.raises(SimulationError, match="depends on phi"):
        attach(str(tmp_path / "own.toml"), "lateral", [read_flight(LD4)])


def test_a_model_found_on_a_simulation_is_read_back_with_its_computed_inputs(functions: str, tmp_path: Path) -> None:
    told = attach(f"{functions}:many", "lateral", [read_flight(LD4)])
    write_model(told.model, tmp_path / "child.toml")
    assert read_model(tmp_path / "child.toml") == told.model
    again = attach(f"{functions}:many", str(tmp_path / "child.toml"), [read_flight(LD4)])
    np.testing.assert_array_equal(again.flights[0]["sim_Cn_0"], told.flights[0]["sim_Cn_0"])


@pytest.mark.parametrize("name", ["beta_lag", "beta_scale"])
def test_a_simulation_is_evaluated_where_the_aircraft_is_not_where_a_wrong_vane_shows_it(
    name: str, short: Flight, tmp_path: Path
) -> None:
    """A cube of sideslip, which a late or wrong vane shows elsewhere: the model with its simulation moves as the whole does."""
    plain = load_model("lateral", "cdfp")
    cubic = plain.plus(terms={"Cn": "0.3*beta^3"})
    write_model(cubic, tmp_path / "cubic.toml")
    (form,) = next(e for e in catalogue(model=plain) if e.name == name).forms
    wrong, outputs = {name: 0.4 if name == "beta_lag" else 0.8}, plain.output_names
    shown = predict_flight(form.added_to(cubic, wrong), short).predicted[:, outputs.index("beta")]
    flight = short.with_columns(beta=shown)
    first = attach(str(tmp_path / "cubic.toml"), "lateral", [flight], free=Free.NOTHING)
    with_vane = replace(first, model=form.added_to(first.model, wrong))
    exact = predict_flight(form.added_to(cubic, wrong), flight).predicted
    off = [
        np.std(predict_flight(a.model, a.flights[0]).predicted - exact)
        for a in (with_vane, renewed_attachment(with_vane), motion_settled(with_vane))
    ]
    assert off[0] > 1e-3  # rad and rad/s
    assert off[2] < 0.1 * off[0]
    asked = resolve([flight], "lateral", simulation=str(tmp_path / "cubic.toml"), moving=with_vane.model)
    column = renewed_attachment(with_vane).flights[0]["sim_Cn_beta"]
    np.testing.assert_allclose(asked.flights[0]["sim_Cn_beta"], column)
    assert np.nanstd(column - first.flights[0]["sim_Cn_beta"]) > 0.0
