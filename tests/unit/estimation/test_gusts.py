"""Whether process noise looks like gusts: flights in rough air, and flights in still air that a model lacks something of."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.aircraft import load_aircraft
from estimation.estimators.filter_error import process_noise_error
from estimation.estimators.result import Result
from estimation.models import load_model
from estimation.prepare.flight_data import FlightData
from estimation.prepare.pipeline import prepare_all
from estimation.structure.gusts import coloured_spectrum, not_gusts, turns_no_wind
from groundstation.flight import Flight
from tests.studies import second_truth
from tests.unit.estimation.truth import DEG, NOISE, Case, fly

LATERAL = load_model("lateral", "cdfp")
Fit = tuple[Result, list[FlightData]]


def fitted(flight: Flight) -> Fit:
    data = prepare_all(LATERAL, [flight])
    return process_noise_error(LATERAL, data), data


@pytest.fixture(scope="module")
def rough() -> Fit:
    return fitted(fly(Case(noise=NOISE, gust=0.4), np.random.default_rng(71))[0][0])


def flown(effect: str, size: float, gust: float) -> Flight:
    request = second_truth.Request(seed=731, gust=gust * DEG, effects={effect: size} if size else {})
    (columns,) = second_truth.fly([request])
    data = dict(columns)
    return Flight.build("flown", data.pop("time"), data)


def test_rough_air_passes(rough: Fit) -> None:
    assert not_gusts(*rough) == ""


def test_a_tone_in_the_innovations_is_no_gust(rough: Fit) -> None:
    result, data = rough
    (fit,) = result.flights
    c = result.model.output_names.index("p")
    tone = np.nanstd(fit.residuals[:, c]) * np.sin(0.5 * np.pi * np.arange(len(fit.residuals)))
    shaken = fit.residuals.copy()
    shaken[:, c] += tone  # a quarter of the sampling rate: neighbours do not correlate
    text = coloured_spectrum(replace(result, flights=(replace(fit, residuals=shaken),)), data)
    assert "innovations of p is not flat" in text
    assert "% of its power at 5" in text


def test_what_turns_no_wind_is_no_gust(rough: Fit) -> None:
    result, data = rough
    gain = {s: {o: v * (40.0 if s == "r" else 1.0) for o, v in row.items()} for s, row in result.extra["gain"].items()}
    assert turns_no_wind(result, data) == ""
    assert "gusts turn beta first" in turns_no_wind(replace(result, extra={**result.extra, "gain": gain}), data)


@pytest.mark.parametrize("effect", ["aileron_backlash", "Cn_dr3", "slipstream_rudder"])
def test_what_a_model_lacks_in_still_air_is_no_gust(effect: str) -> None:
    aircraft = replace(load_aircraft("cdfp"), mass=second_truth.MASS, **second_truth.INERTIA)
    model = load_model("lateral", aircraft)
    data = prepare_all(model, [flown(effect, 3.0, 0.0)])
    assert not_gusts(process_noise_error(model, data), data).startswith("its process noise is no gusts")


@pytest.mark.parametrize("gust", [0.5, 1.5])
def test_another_simulators_rough_air_passes(gust: float) -> None:
    aircraft = replace(load_aircraft("cdfp"), mass=second_truth.MASS, **second_truth.INERTIA)
    model = load_model("lateral", aircraft)
    data = prepare_all(model, [flown("", 0.0, gust)])
    assert not_gusts(process_noise_error(model, data), data) == ""
