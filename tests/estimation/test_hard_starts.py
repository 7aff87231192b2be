"""Records and starts that no fit can settle: every method ends in a result or a sentence, whichever library gave up."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from estimation.aircraft import load_aircraft
from estimation.models import load_model
from estimation.models.base import Model
from estimation.session import runner
from estimation.session.session import Session
from estimation.session.structured import Wish
from groundstation.flight import Flight
from tests.estimation.truth import NOISE, TRUE, Case, Craft, fly

LATERAL = load_model("lateral", "cdfp")
METHODS = ("ml", "fem", "fem-noise", "ls", "ngn-improved")
SHORT = 5.0  # s


def _flown(case: Case, seed: int) -> Flight:
    return fly(case, np.random.default_rng(seed))[0][0]


def _sound() -> tuple[Flight, Model]:
    return _flown(Case(seconds=SHORT, noise=NOISE), 41), LATERAL


def _stiff() -> tuple[Flight, Model]:
    """A roll mode of a few ms, which 20 Hz cannot see."""
    craft = Craft(ixx=0.006)
    return _flown(Case(seconds=SHORT, V=27.0, noise=NOISE, craft=craft), 42), LATERAL


def _unstable() -> tuple[Flight, Model]:
    """Weathercock and roll damping of the wrong sign, started from there."""
    away = {**TRUE, "Cn_beta": -0.012, "Cl_p": -0.06}
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


@cache
def _session(kind: str, method: str) -> Session | str:
    flight, model = HARD[kind]()
    craft = replace(load_aircraft("cdfp"))
    try:
        return runner.estimate(model, [flight], craft, [method], structure=Wish.OFF)
    except runner.UserError as refused:
        return str(refused)


@pytest.mark.parametrize("kind", HARD)
@pytest.mark.parametrize("method", METHODS)
def test_a_hard_start_ends_in_a_result_or_a_sentence(kind: str, method: str) -> None:
    session = _session(kind, method)
    if isinstance(session, str):
        assert "\n" not in session
        assert len(session) > 20
        assert kind != "sound"
        return
    (of_flight,) = session.flights
    for why in of_flight.failures.values():
        assert "\n" not in why
        assert "use another" in why
    for result in of_flight.results.values():
        told = [e for e in result.parameters.values() if e.identifiable]
        assert not result.converged or all(np.isfinite(e.estimate) for e in told)
    assert session.text
    session.to_json()
