"""Records and starts that no fit can settle: every method ends in a result or a sentence, whichever library gave up."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.linalg import cho_factor, eigh, solve_discrete_are

from daq.utilities.errors import UserError
from estimation.aircraft import load_aircraft
from estimation.engine.simulate import Simulator
from estimation.errors import EstimationError
from estimation.estimators.arithmetic import NumericalFailure, mark_not_finite, numerical_failures
from estimation.estimators.equation_error import equation_error
from estimation.estimators.estimator import Estimator, Task
from estimation.estimators.filter_error import GainLaw, ProcessNoiseProblem, gain_law
from estimation.estimators.gauss_newton import SolverStep, Status, minimise
from estimation.estimators.result import Result
from estimation.models import load_model
from estimation.models.base import Model, Parameter
from estimation.prepare.pipeline import prepare_all
from estimation.session import runner
from estimation.session.structured import StructureWish
from groundstation.flight import Flight
from groundstation.flight.quality.plausibility import suspicions
from tests.unit.estimation.truth import NOISE, TRUE, Case, Craft, fly

LATERAL = load_model("lateral", "cdfp")
METHODS = ("ml", "fem", "fem-noise", "ls", "ngn-improved")
SHORT = 5.0  # s


def _flown(case: Case, seed: int) -> Flight:
    return fly(case, np.random.default_rng(seed))[0][0]


def _sound() -> tuple[Flight, Model]:
    return _flown(Case(seconds=SHORT, noise=NOISE), 41), LATERAL


def _stiff() -> tuple[Flight, Model]:
    """A roll mode of 3 ms, which 20 Hz cannot see."""
    craft = Craft(ixx=0.02)
    return _flown(Case(seconds=SHORT, V=27.0, noise=NOISE, craft=craft), 42), LATERAL


def _unstable() -> tuple[Flight, Model]:
    """Weathercock stability of the wrong sign, and starts far beyond that."""
    away = {**TRUE, "Cn_beta": -0.006}
    return _flown(Case(seconds=SHORT, true=away, noise=NOISE), 43), LATERAL.with_starts({"Cn_beta": -0.2, "Cl_p": 4.0})


def _units(factor: float, *columns: str) -> Callable[[], tuple[Flight, Model]]:
    def made() -> tuple[Flight, Model]:
        flight, model = _sound()
        return flight.with_columns(**{c: factor * flight[c] for c in columns}), model

    return made


def _unexcited() -> tuple[Flight, Model]:
    """Surfaces that rest, and motion that is noise."""
    flight = _flown(Case(seconds=SHORT, noise=NOISE, aileron=0.0, rudder=0.0), 44)
    rest = np.zeros(len(flight))
    return flight.with_columns(delta_a=rest, delta_r=rest), LATERAL


def _still() -> tuple[Flight, Model]:
    """Not a number moves but the clock."""
    flight, model = _sound()
    moving = ("p", "r", "phi", "beta", "ay", "delta_a", "delta_r")
    return flight.with_columns(**{c: np.full(len(flight), float(flight[c][0])) for c in moving}), model


def _absurd_start() -> tuple[Flight, Model]:
    flight, model = _sound()
    return flight, model.with_starts({"Cl_p": 1e9, "Cn_r": -1e9, "CY_beta": 1e12})


HARD: Mapping[str, Callable[[], tuple[Flight, Model]]] = {
    "sound": _sound,
    "stiff": _stiff,
    "unstable": _unstable,
    "rates in deg/s": _units(57.3, "p", "r"),
    "angles in deg": _units(57.3, "beta", "phi"),
    "speed in cm/s": _units(100.0, "V"),
    "acceleration in mg": _units(102.0, "ay"),
    "surfaces in us": _units(1e3, "delta_a", "delta_r"),
    "unexcited": _unexcited,
    "still": _still,
    "absurd start": _absurd_start,
}


REFUSED = ("rates in deg/s", "angles in deg", "surfaces in us", "still")
"""Records that are refused before a fit."""

CASES = [(kind, method) for kind in HARD for method in METHODS]


@pytest.fixture
def few_networks(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Eight networks of the bootstrap for 64: more of them do the same once more."""
    if method.startswith("ngn"):
        from estimation.estimators.neural_gauss_newton import estimate, training

        monkeypatch.setattr(
            estimate, "default_options", lambda *given: replace(training.default_options(*given), bootstraps=8)
        )


@pytest.mark.usefixtures("few_networks")
@pytest.mark.parametrize(("kind", "method"), CASES)
def test_a_hard_start_ends_in_a_result_or_a_sentence(kind: str, method: str) -> None:
    flight, model = HARD[kind]()
    if kind in REFUSED:
        with pytest.raises(UserError, match=r"^.{20,}$"):
            runner.estimate(model, [flight], load_aircraft("cdfp"), [method], structure=StructureWish.OFF)
        return
    session = runner.estimate(model, [flight], load_aircraft("cdfp"), [method], structure=StructureWish.OFF)
    (of_flight,) = session.flights
    for why in of_flight.failures.values():
        assert "\n" not in why
        assert "use another" in why
    for result in of_flight.results.values():
        estimates = [e.estimate for e in result.parameters.values() if e.identifiable]
        assert not result.converged or np.isfinite(estimates).all()
    session.to_json()


# ------------------------------------------------------------------------------------------- the edge of all methods

NOT_FINITE = np.array([[1.0, np.nan], [np.nan, 1.0]])
UNSEEN = np.diag([0.5, 2.0])  # the second state grows, and the output is of the first
ARITHMETIC: Mapping[str, Callable[[], object]] = {
    "factor": lambda: cho_factor(NOT_FINITE),
    "eigenvalues": lambda: eigh(NOT_FINITE),
    "riccati of infinities": lambda: solve_discrete_are(NOT_FINITE, np.eye(2), np.eye(2), np.eye(2)),
    "riccati without solution": lambda: solve_discrete_are(UNSEEN, np.array([[1.0], [0.0]]), np.eye(2), np.eye(1)),
    "singular": lambda: np.linalg.inv(np.zeros((2, 2))),
    "overflow": lambda: math.exp(1e3),
    "division": lambda: 1.0 / int(np.zeros(1)[0]),
}


def _with(work: Callable[[], object]) -> Estimator:
    def fit(task: Task) -> Result:
        if task.flights[0].name == "hard":
            work()
        return equation_error(task.model, task.smooth)

    return Estimator("own", "one of somebody", fit)


@pytest.mark.parametrize("name", ARITHMETIC)
def test_arithmetic_that_fails_in_any_method_is_one_sentence(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "find_estimator", lambda method: _with(ARITHMETIC[name]))
    easy, model = _sound()
    flights = [replace(easy, name="hard"), replace(easy, name="easy")]
    session = runner.estimate(model, flights, load_aircraft("cdfp"), ["own"], structure=StructureWish.OFF)
    hard, sound = session.flights
    assert "failed in its arithmetic" in hard.failures["own"]
    assert "check units" in hard.failures["own"]
    assert sound.results["own"].converged
    assert not session.converged
    with pytest.raises(NumericalFailure):
        runner.run_method("own", model, flights[:1], load_aircraft("cdfp"))


def _raise(error: Exception) -> None:
    raise error


@pytest.mark.parametrize(
    "work",
    [
        lambda: np.zeros(2) + np.zeros(3),
        lambda: np.linalg.inv(np.zeros((2, 3)) @ np.zeros((2, 3))),
        lambda: _raise(ValueError("nan is no name")),
        lambda: _raise(KeyError("inf")),
        lambda: _raise(EstimationError("a sentence of its own")),
    ],
)
def test_mistakes_of_a_program_stay_what_they_are(work: Callable[[], object]) -> None:
    with pytest.raises(Exception) as told, numerical_failures():
        work()
    assert not isinstance(told.value, NumericalFailure)


def test_estimates_that_are_no_numbers_have_not_converged() -> None:
    flight, model = _sound()
    sound = equation_error(model, flight)
    assert mark_not_finite(sound) is sound
    lost = {**sound.parameters, "Cl_p": replace(sound.parameters["Cl_p"], estimate=math.nan, identifiable=True)}
    found = mark_not_finite(replace(sound, parameters=lost))
    assert found.status is Status.DIVERGED
    assert not found.converged
    assert "Cl_p" in found.text


# ------------------------------------------------------------------------------------------- the cure in the search


def _filter_problem(law: GainLaw) -> ProcessNoiseProblem:
    flight, model = _sound()
    data = prepare_all(model, flight)
    extended = model.with_starts(TRUE).plus(parameters=[Parameter("noise_beta", start=1.0, lower=0.0)])
    problem = ProcessNoiseProblem(extended, data, Simulator.build(extended), noise="full")
    problem.noises, problem.law = ["noise_beta"], law
    return problem


@pytest.mark.parametrize("transition", [np.inf, np.nan])
def test_a_filter_without_a_gain_is_a_place_to_step_back_from(transition: float) -> None:
    nx, ny = len(LATERAL.states), len(LATERAL.outputs)
    law = GainLaw(np.full((nx, nx), transition), np.eye(ny, nx), np.full(ny, 0.01), np.array([0.01]), (0,))
    problem = _filter_problem(law)
    for derivatives in (False, True):
        assert problem.evaluate(problem.pack(problem.model.starts()), derivatives).cost == np.inf
    assert minimise(problem, problem.pack(problem.model.starts())).status is Status.DIVERGED


def test_a_growing_state_that_no_output_shows_has_no_filter() -> None:
    law = gain_law(np.diag([-1.0, 2.0]), np.array([[1.0, 0.0]]), 0.05, np.array([0.1]), np.array([0.1]), (0,))
    with pytest.raises(np.linalg.LinAlgError):
        law.gain(np.array([1.0]))


@dataclass(frozen=True)
class _Place:
    cost: float


class _HollowBowl:
    """x^2 / 2, whose derivatives cannot be had at and below 1: steps overshoot by a factor of ten."""

    def evaluate(self, unknowns: np.ndarray, derivatives: bool) -> _Place:
        x = float(unknowns[0])
        return _Place(np.inf if derivatives and abs(x) <= 1.0 else 0.5 * x * x)

    def step(self, unknowns: np.ndarray, point: _Place, damping: float) -> SolverStep:
        return SolverStep(-2.2 * unknowns / (1.0 + damping), point.cost)

    def clip(self, unknowns: np.ndarray) -> np.ndarray:
        return unknowns


def test_the_search_never_ends_where_there_are_no_derivatives() -> None:
    found = minimise(_HollowBowl(), np.array([6.0]))
    assert np.isfinite(found.point.cost)
    assert 1.0 < abs(found.unknowns[0]) < 6.0


def test_a_short_stretch_without_any_measured_output_has_no_say_in_the_bounds() -> None:
    """Two stretches, of the first of which no sample has an output: what is left is fitted as if it were alone."""
    flight = _flown(Case(seconds=2 * SHORT, noise=NOISE), 47)
    count = len(flight)
    outputs = ("p", "r", "beta", "phi", "ay")
    early = np.arange(count) < 12
    columns = {c: np.where(early, np.nan, flight[c]) for c in outputs}
    cut = flight.with_columns(**columns)
    split = Flight.build("cut", cut.time, {c: cut[c] for c in cut.columns if cut.measured(c)}, segment=1.0 - early)
    for method in ("ml", "fem"):
        session = runner.estimate(LATERAL, [split], load_aircraft("cdfp"), (method,), structure=StructureWish.OFF)
        parameters = session.flights[0].results[method].parameters
        assert abs(parameters["Cn_beta"].estimate - TRUE["Cn_beta"]) < 4.0 * parameters["Cn_beta"].std_coloured


def test_infinities_of_both_signs_side_by_side_end_without_a_warning(recwarn: pytest.WarningsRecorder) -> None:
    from estimation.prepare.plausible import _ratio_to_slope
    from groundstation.flight import Flight

    time = np.arange(200) * 0.05
    p = np.cos(time)
    p[[50, 51, 70, 71]] = np.inf, -np.inf, 1e300, -1e300
    phi = np.sin(time)
    phi[[90, 91]] = np.inf
    flight = Flight.build("f", time, {"p": p, "phi": phi})
    ratio = _ratio_to_slope(flight, "p", "phi")
    assert ratio == pytest.approx(1.0, rel=0.02)
    assert not recwarn.list


@pytest.mark.parametrize(
    ("value", "words"), [(np.inf, "shows inf at 1 samples"), (1e30, "damaged values"), (40.0, "deg/s")]
)
def test_values_that_no_sensor_shows_are_no_other_unit(value: float, words: str) -> None:
    time = np.arange(200) * 0.05
    p = 0.2 * np.cos(time)
    p[60] = value
    (found,) = suspicions(time, {"p": p})
    assert words in found.text
