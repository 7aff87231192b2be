"""Quantised, slow and stuck channels, wild values and time in another unit: no estimate moves in silence.

Levels at which the information of a flight is not changed: steps of up to a seventh of a channel's noise (16 bit over the
range of an instrument, 12 bit for angles that others show better), values held where the motion is straight between new ones.
"""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from estimation.errors import DataError
from estimation.estimators.output_error import output_error
from estimation.estimators.result import Result
from estimation.models import load_model
from estimation.prepare.flight_data import Preparation
from estimation.prepare.pipeline import prepare
from groundstation.flight import Flight, read_flight, write_flight
from groundstation.flight.findings import FindingKind
from sideslip.verbs.check import check
from sideslip.verbs.estimate import estimate
from tests.support.paths import ROOT
from tests.unit.estimation.truth import NOISE, Case, fly

LATERAL = load_model("lateral", "cdfp")
FOREIGN = ROOT / "recordings" / "foreign"
SPAN = {
    "phi": 2 * np.pi, "theta": np.pi, "p": 8.7, "q": 8.7, "r": 8.7, "alpha": 1.05, "beta": 1.05, "V": 40.0, "ay": 40.0,
    "delta_a": 1.05, "delta_r": 1.05,
}  # fmt: skip
"""Ranges of instruments: half and full circles, gyros of 250 deg/s, vanes and surfaces of 30 deg, 2 g."""
ALIKE = 0.05  # of a bound


def rounded(flight: Flight, bits: int, *columns: str) -> Flight:
    steps = {c: SPAN[c] / 2**bits for c in columns or SPAN}
    return flight.with_columns(**{c: np.round(flight[c] / s) * s for c, s in steps.items()})


def held(flight: Flight, column: str, samples: int) -> Flight:
    return flight.with_columns(**{column: flight[column][(np.arange(len(flight)) // samples) * samples]})


def moved(before: Result, after: Result) -> float:
    """Largest move of an estimate, in corrected bounds."""
    return max(
        abs(after.parameters[n].estimate - e.estimate) / e.std_coloured
        for n, e in before.parameters.items()
        if np.isfinite(e.std_coloured)
    )


@pytest.fixture(scope="module")
def ordinary() -> Flight:
    return read_flight(FOREIGN / "ordinary_0.csv")


@pytest.fixture(scope="module")
def wandering() -> Flight:
    """A flight whose attitude comes from a filter: no noise, a slow error of 0.012 rad; airspeed and attitude are smooth."""
    noise = {**NOISE, "phi": 0.0, "theta": 0.0, "V": 0.0, "alpha": 0.0, "q": 0.0}
    flight = fly(Case(seconds=40, rate=25, noise=noise, servo=None), np.random.default_rng(5))[0][0]
    return flight.with_columns(phi=flight["phi"] + 0.012 * np.sin(2 * np.pi * flight.time / 35))


@pytest.fixture(scope="module")
def fitted(ordinary: Flight, wandering: Flight) -> dict[str, Result]:
    return {"ordinary": output_error(LATERAL, ordinary), "wandering": output_error(LATERAL, wandering)}


@pytest.mark.parametrize(("bits", "columns"), [(16, ()), (12, ("phi", "theta", "V"))])
def test_rounding_of_an_ordinary_flight(
    ordinary: Flight, fitted: dict[str, Result], bits: int, columns: tuple[str, ...]
) -> None:
    assert moved(fitted["ordinary"], output_error(LATERAL, rounded(ordinary, bits, *columns))) < ALIKE


@pytest.mark.parametrize("bits", [12, 16])
def test_an_attitude_that_repeats_for_seconds_is_compared(
    wandering: Flight, fitted: dict[str, Result], bits: int
) -> None:
    flight = rounded(wandering, bits, "phi")
    result = output_error(LATERAL, flight)
    assert moved(fitted["wandering"], result) < ALIKE
    assert not [n for n in result.flights[0].notes if n.kind in (FindingKind.STUCK, FindingKind.HELD)]
    dithered = flight.with_columns(phi=flight["phi"] + 1e-11 * np.random.default_rng(1).standard_normal(len(flight)))
    assert moved(result, output_error(LATERAL, dithered)) < 1e-3


@pytest.mark.parametrize(("column", "samples"), [("theta", 5), ("alpha", 5), ("V", 5), ("q", 2)])
def test_a_slow_channel_is_taken_between_its_new_values_and_said(
    wandering: Flight, fitted: dict[str, Result], column: str, samples: int
) -> None:
    flight = held(wandering, column, samples)
    result = output_error(LATERAL, flight)
    assert moved(fitted["wandering"], result) < ALIKE
    (note,) = [n for n in result.flights[0].notes if n.kind is FindingKind.HELD]
    assert note.columns == (column,)
    assert "--keep-held" in note.text
    kept = prepare(LATERAL, flight, Preparation(keep_held=True))
    assert not [n for n in kept.notes if n.kind is FindingKind.HELD]


def test_repeats_of_a_slow_output_are_not_compared(wandering: Flight) -> None:
    data = prepare(LATERAL, held(wandering, "beta", 4))
    beta = LATERAL.output_names.index("beta")
    known = np.isfinite(data.segments[0].z[:, beta])
    assert np.flatnonzero(known).tolist() == list(range(0, len(wandering), 4))
    assert np.isfinite(prepare(LATERAL, held(wandering, "beta", 4), Preparation(keep_held=True)).segments[0].z).all()


@pytest.mark.parametrize("value", [1e30, -400.0, 30.0])
def test_a_wild_value_is_named_and_left_out(ordinary: Flight, fitted: dict[str, Result], value: float) -> None:
    r = ordinary["r"].copy()
    r[200] = value
    result = output_error(LATERAL, ordinary.with_columns(r=r))
    assert moved(fitted["ordinary"], result) < ALIKE
    (note,) = [n for n in result.flights[0].notes if n.kind is FindingKind.OUTLIER]
    assert note.text.startswith("r: a wild value left out")


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "milliseconds"), (1e6, "microseconds")])
@pytest.mark.parametrize("verb", [estimate, check])
def test_time_in_another_unit_gets_its_sentence(
    ordinary: Flight, tmp_path: Path, factor: float, unit: str, verb: object
) -> None:
    late = Flight.build("late", ordinary.time * factor, dict(ordinary.columns))
    write_flight(late, tmp_path / "late.csv")
    out = CliRunner().invoke(verb, [str(tmp_path / "late.csv"), "--aircraft", "cdfp"], standalone_mode=False)  # type: ignore[arg-type]
    assert isinstance(out.exception, DataError)
    assert f"time looks like {unit}" in str(out.exception)


def test_check_has_an_entry_for_what_it_leaves_out_and_a_choice(tmp_path: Path) -> None:
    flight = held(read_flight(FOREIGN / "ordinary_0.csv"), "beta", 4)
    write_flight(flight, tmp_path / "slow.csv")
    entries = {}
    for name, options in (("left", []), ("kept", ["--keep-held"])):
        out = CliRunner().invoke(
            check,
            [
                str(tmp_path / "slow.csv"), "--aircraft", "cdfp", "--segments", "0:6", "--factors", "dbeta",
                "--json", str(tmp_path / "c.json"), *options,
            ],
            standalone_mode=False,
        )  # fmt: skip
        assert out.exception is None
        data = json.loads((tmp_path / "c.json").read_text())["flights"][0]["quality"]
        entries[name] = [q for q in data if q["check"] == "left out" and q["text"].startswith("beta")]
    assert len(entries["left"]) == 1
    assert set(entries["left"][0]) == {"check", "verdict", "text"}
    assert entries["kept"] == []
