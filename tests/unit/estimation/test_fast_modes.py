"""A roll that is over between two records of the aileron: not told, but the steady rate for a deflection is."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from estimation.aircraft import load_aircraft
from estimation.estimators.result import Result
from estimation.models import load_model
from estimation.prepare.conditioned import condition_columns
from estimation.session import runner
from estimation.session.fast_modes import fast_modes, with_fast_modes
from groundstation.flight import Flight
from tests.unit.estimation.truth import NOISE, Case, fly


@pytest.fixture(scope="module")
def fitted() -> tuple[Flight, Result]:
    flight = fly(Case(noise=NOISE), np.random.default_rng(77))[0][0]
    session = runner.estimate(load_model("lateral", "cdfp"), [flight], load_aircraft("cdfp"), ("ml",))
    return flight, session.flights[0].results["ml"]


def recorded(flight: Flight, interval: float) -> Flight:
    """The flight with an aileron that was logged as a command every so often."""
    channels: Mapping[str, object] = {"delta_a": {"kind": "measured", "held": True, "interval_s": interval}}
    return replace(flight, provenance=replace(flight.provenance, detail={"channels": channels}))


def test_the_record_has_to_be_slower_than_the_roll(fitted: tuple[Flight, Result]) -> None:
    flight, result = fitted
    c = load_aircraft("cdfp").constants()
    Cl_p, Cl_da = (result.parameters[n].estimate for n in ("Cl_p", "Cl_da"))
    rho = float(np.median(flight["rho"])) if flight.measured("rho") else 1.225
    rate = 0.25 * rho * float(np.median(flight["V"])) * c["S"] * c["b"] ** 2 * abs(Cl_p) / c["Ixx"]
    assert fast_modes(result, [recorded(flight, 0.8 / rate)]) == []
    assert fast_modes(result, [flight]) == []
    assert (
        fast_modes(result, [recorded(flight, 1.5 / rate), flight]) == []
    )  # a measured deflection beside a slow record
    (mode,) = fast_modes(result, [recorded(flight, 1.5 / rate)])
    assert mode.time_constant == pytest.approx(1.0 / rate, rel=0.01)
    assert mode.ratio == pytest.approx(Cl_da / Cl_p)
    assert 0.0 < mode.std < 0.2 * mode.ratio
    assert f"Cl_p cannot be told at {rate / 1.5:.3g} Hz" in mode.text
    slow = with_fast_modes(result, [recorded(flight, 1.5 / rate)])
    untold = [n for n, e in slow.parameters.items() if not e.identifiable]
    assert untold == [n for n in result.parameters if n in ("Cl_p", "Cl_da")]
    assert "Cl_da/Cl_p can" in slow.parameters["Cl_p"].why


def test_the_verdict_says_it(fitted: tuple[Flight, Result]) -> None:
    flight, _ = fitted
    session = runner.estimate(load_model("lateral", "cdfp"), [recorded(flight, 2.0)], load_aircraft("cdfp"), ("ml",))
    verdict = session.flights[0].verdict
    assert verdict is not None
    assert any("Cl_p cannot be told at 0.5 Hz" in d.text for d in verdict.doubts)


def test_a_bank_that_rolls_on_has_no_jump(rng: np.random.Generator) -> None:
    time = np.arange(0.0, 6.0, 0.02)
    phi = 2.0 * time + 0.01 * rng.standard_normal(time.size)
    wrapped = np.where(time == 3.0, np.nan, (phi + np.pi) % (2.0 * np.pi) - np.pi)
    flight = Flight.build("rolling", time, {"phi": wrapped, "p": np.full(time.size, 2.0)})
    unwrapped = condition_columns(flight, ["phi"]).flight["phi"]
    finite = np.isfinite(unwrapped)
    np.testing.assert_allclose(unwrapped[finite], phi[finite], atol=1e-9)
