"""Transfer functions fitted to responses, and the handling-quality numbers made of them."""

import math
from dataclasses import replace

import numpy as np
import pytest

from estimation.errors import DataError, EstimationError
from estimation.frequency.forms import ROLL as ROLL_FORM
from estimation.frequency.forms import TransferForm, form_for
from estimation.frequency.handling import RatedAircraft, handling
from estimation.frequency.response import FrequencyResponse, ResponseOptions, frequency_response
from estimation.frequency.transfer import GOOD, fit_transfer
from tests.unit.estimation.frequency.linear_aircraft import DUTCH_ROLL, ROLL, Case, Plant, fly

ALONE = ResponseOptions(with_=(), points=30)
SHORT_PERIOD = Plant((-20.0, -30.0), (1.0, 2 * 0.6 * 5.0, 25.0), 0.06)


def exact(plant: Plant, control: str, output: str, error: float = 1e-4) -> FrequencyResponse:
    """A response without error of a plant, told with a relative one."""
    omega = np.geomspace(0.5, 30.0, 40)
    H = plant.at(omega)
    std, many = error * np.abs(H), np.full(40, 10.0)
    return FrequencyResponse((control,), output, omega, H, std, np.full(40, 0.99), many, (), (10.0,), 60.0, 16.0)


@pytest.mark.parametrize(
    ("plant", "control", "output", "values"),
    [
        (ROLL, "delta_a", "p", {"K": 8.0, "T_R": 0.2, "tau": 0.1}),
        (DUTCH_ROLL, "delta_r", "r", {"K": 4.0, "b0": 1.0, "zeta_d": 0.15, "omega_d": 4.5, "tau": 0.0}),
        (SHORT_PERIOD, "cmd_e", "q", {"K": -20.0, "1/T_theta2": 1.5, "zeta_sp": 0.6, "omega_sp": 5.0, "tau": 0.06}),
    ],
)
def test_an_exact_response_gives_its_own_numbers(
    plant: Plant, control: str, output: str, values: dict[str, float]
) -> None:
    fit = fit_transfer(exact(plant, control, output))
    assert {n: p.estimate for n, p in fit.parameters.items()} == pytest.approx(values, rel=1e-5, abs=1e-6)
    assert dict(fit.cifer) == pytest.approx(values, rel=1e-5, abs=1e-6)
    assert fit.cost < 1e-6
    numerator, denominator, delay = fit.form.polynomials(fit.values)
    np.testing.assert_allclose(numerator, plant.numerator, rtol=1e-5)
    np.testing.assert_allclose(denominator, plant.denominator, rtol=1e-5)
    assert delay == pytest.approx(plant.delay, abs=1e-6)


@pytest.mark.parametrize("kind", ["multisine", "doublets"])
def test_a_known_delay_is_found_within_its_bound(kind: str) -> None:
    for seed in range(3):
        flight = fly({"delta_a": ROLL}, "p", Case(40.0, kind=kind, colour=0.5), np.random.default_rng(30 + seed))
        fit = fit_transfer(frequency_response(flight, "delta_a", "p", ALONE))
        for name, true in (("K", 8.0), ("T_R", 0.2), ("tau", 0.1)):
            p = fit.parameters[name]
            assert abs(p.estimate - true) < 3.0 * p.std
            assert p.std < 0.35 * true
        assert fit.cost < 50.0


def test_the_bounds_are_those_of_many_repetitions() -> None:
    """Independent errors of known size on an exact response; windows so long that no points share noise."""
    truth, rng = exact(ROLL, "delta_a", "p", 0.05), np.random.default_rng(31)
    truth = replace(truth, length=np.full(40, 1e4))
    values, bounds = [], []
    for _ in range(40):
        kick = rng.normal(size=(2, 40)) * truth.std
        fit = fit_transfer(replace(truth, H=truth.H + kick[0] + 1j * kick[1]))
        values.append(fit.values)
        bounds.append([p.std for p in fit.parameters.values()])
    ratio = np.std(values, axis=0) / np.mean(bounds, axis=0)
    assert np.all((ratio > 0.7) & (ratio < 1.3))  # 40 draws tell a standard deviation to 11 %


def test_shared_windows_widen_the_bounds() -> None:
    apart = fit_transfer(replace(exact(ROLL, "delta_a", "p"), length=np.full(40, 1e4)))
    shared = fit_transfer(replace(exact(ROLL, "delta_a", "p"), length=np.full(40, 2.0)))
    assert shared.parameters["K"].std > 2.0 * apart.parameters["K"].std


def test_a_form_that_does_not_fit_says_so_and_widens() -> None:
    response = exact(DUTCH_ROLL, "delta_r", "r")
    wrong = fit_transfer(response, "0/1")
    assert wrong.cost > 100.0
    assert wrong.misfit > 10.0


def test_auto_finds_an_order_where_no_mode_is_known() -> None:
    fit = fit_transfer(exact(DUTCH_ROLL, "delta_a", "beta", 0.02))
    assert fit.form.name == "1/2"
    assert fit.parameters["a0"].estimate == pytest.approx(20.25, rel=1e-3)


@pytest.mark.parametrize(
    ("control", "output", "name", "orders"),
    [
        ("delta_a", "p", "roll", (0, 1)),
        ("cmd_r", "ay", "dutch-roll", (2, 2)),
        ("delta_e", "q", "short-period", (1, 2)),
        ("delta_e", "az", "short-period", (2, 2)),
    ],
)
def test_forms_of_input_and_output(control: str, output: str, name: str, orders: tuple[int, int]) -> None:
    found = form_for(control, output)
    assert found is not None
    assert (found.name, found.orders) == (name, orders)
    assert len(found.names) == len(found.units) == len(set(found.names))
    x = np.linspace(0.5, 1.5, len(found.names))
    back = found.from_polynomials(*found.polynomials(x))
    np.testing.assert_allclose(back, x)


@pytest.mark.parametrize("wrong", ["", "rol", "2/1", "1/0", "1/99", "a/b", "-1/2", "1/2/3", "١/٢"])
def test_forms_that_are_none(wrong: str) -> None:
    if wrong == "١/٢":  # digits of another script are digits; what they mean is the same
        assert form_for("delta_a", "p", wrong) == TransferForm("1/2", (1, 2))
        return
    with pytest.raises(EstimationError, match="form"):
        form_for("delta_a", "p", wrong)


def test_too_few_coherent_points() -> None:
    response = exact(ROLL, "delta_a", "p")
    dull = replace(response, coherence=np.full(40, GOOD - 0.01))
    with pytest.raises(DataError, match=r"0 frequencies with a coherence of 0.6 or more cannot settle the 3 unknowns"):
        fit_transfer(dull)


# -------------------------------------------------------------------------------------------------- handling qualities


def test_short_period_numbers() -> None:
    response = exact(SHORT_PERIOD, "delta_e", "q")
    fit = fit_transfer(response)
    numbers = {n.name: n for n in handling(response, fit, RatedAircraft("I", "A", 1000.0))}
    load = 16.0 / 9.80665 * 1.5
    assert numbers["n/alpha"].value == pytest.approx(load, rel=1e-5)
    assert numbers["CAP"].value == pytest.approx(25.0 / load, rel=1e-4)
    assert numbers["CAP"].level == 3  # 10.2, and level 2 ends at 10
    assert numbers["zeta_sp"].level == 1
    assert numbers["tau"].level == 1


def test_bandwidth_of_an_attitude_by_hand() -> None:
    """theta / delta = K exp(-tau s) / (s (T s + 1)): phase -90 - atan(T w) - tau w."""
    plant = Plant((-8.0,), (1.0, 5.0), 0.1)
    response = exact(plant, "delta_a", "p")
    numbers = {n.name: n for n in handling(response, fit_transfer(response), RatedAircraft())}
    omega = np.linspace(0.5, 30.0, 200_000)
    phase = -np.pi / 2 - np.arctan(0.2 * omega) - 0.1 * omega
    at = {d: float(np.interp(math.radians(d), phase[::-1], omega[::-1])) for d in (-135.0, -180.0)}
    size = 20 * np.log10(np.abs(plant.at(omega)) / omega)
    six = float(np.interp(np.interp(at[-180.0], omega, size) + 6.0, size[::-1], omega[::-1]))
    assert numbers["omega_BW"].value == pytest.approx(min(at[-135.0], six), rel=2e-3)
    late = -np.pi - float(np.interp(2 * at[-180.0], omega, phase))
    assert numbers["tau_p"].value == pytest.approx(late / (2 * at[-180.0]), rel=2e-3)


@pytest.mark.parametrize(
    ("craft", "T", "level"),
    [
        (RatedAircraft("I", "A", 1000.0), 0.9, 1),
        (RatedAircraft("I", "A", 1000.0), 1.2, 2),
        (RatedAircraft("III", "A", 1e5), 1.2, 1),
        (RatedAircraft("IV", "C"), 1.5, 3),
        (RatedAircraft("IV", "C"), 11.0, 4),
        (RatedAircraft("", "A", 1000.0), 0.9, None),
        (RatedAircraft("I", "A", 3.5), 0.9, None),
    ],
)
def test_levels_of_the_roll_mode(craft: RatedAircraft, T: float, level: int | None) -> None:
    """MIL-F-8785C table VII; none for an aircraft without a pilot or a class."""
    response = exact(Plant((3.0,), (1.0, 1.0 / T)), "delta_a", "p")
    fit = fit_transfer(response, ROLL_FORM)
    number = next(n for n in handling(response, fit, craft) if n.name == "T_R")
    assert number.value == pytest.approx(T, rel=1e-4)
    assert number.level == level


@pytest.mark.parametrize(
    ("zeta", "omega", "level"), [(0.2, 2.0, 1), (0.2, 0.9, 2), (0.1, 2.0, 2), (0.01, 2.0, 3), (-0.05, 2.0, 4)]
)
def test_levels_of_the_dutch_roll(zeta: float, omega: float, level: int) -> None:
    response = exact(Plant((4.0, 4.0), (1.0, 2 * zeta * omega, omega**2)), "delta_r", "r")
    numbers = {n.name: n for n in handling(response, fit_transfer(response), RatedAircraft("IV", "A"))}
    assert numbers["zeta_d"].level == level
    assert numbers["zeta_d omega_d"].value == pytest.approx(zeta * omega, rel=1e-3)


def test_why_there_is_no_level() -> None:
    assert "weighs 3.5 kg" in RatedAircraft("I", "A", 3.5).why_no_level
    assert "name the class" in RatedAircraft().why_no_level
    assert RatedAircraft("II").why_no_level == ""
    for wrong in (("V", "A"), ("I", "D")):
        with pytest.raises(EstimationError, match="MIL-F-8785C knows"):
            RatedAircraft(*wrong)
