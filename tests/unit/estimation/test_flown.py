"""A model keeps what was flown to estimate it, and a prediction beyond that is told."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import sideslip as ss
from estimation.errors import ModelError
from estimation.models import load_model, write_model
from estimation.models.load import read_model
from estimation.session.proof_of_match import beyond_flown, flown_ranges, stretches_of_recordings, was_estimated_from
from groundstation.flight import Flight, write_flight
from sideslip.verbs.estimate import estimate
from sideslip.verbs.match import match

LATERAL = load_model("lateral", "cdfp")


def test_ranges_are_those_of_what_forces_depend_on(made_flights: list[Flight]) -> None:
    found = flown_ranges(LATERAL, made_flights)
    assert {"beta", "p", "r", "delta_a", "delta_r", "V", "alpha"} <= set(found)
    assert not {"phi", "rho", "theta"} & set(found)
    everything = np.concatenate([f["beta"] for f in made_flights])
    low, high = found["beta"]
    assert everything.min() <= low < np.quantile(everything, 0.02)
    assert np.quantile(everything, 0.98) < high <= everything.max()


def test_one_wild_value_is_no_range(made_flights: list[Flight]) -> None:
    flight = made_flights[0]
    beta = flight["beta"].copy()
    beta[7] = 1.5
    assert (
        flown_ranges(LATERAL, [flight.with_columns(beta=beta)])["beta"][1]
        < 2.0 * flown_ranges(LATERAL, [flight])["beta"][1]
    )


def test_a_flight_of_half_the_size_stays_within_and_one_of_twice_does_not(made_flights: list[Flight]) -> None:
    flight = made_flights[0]
    model = replace(LATERAL, flown=flown_ranges(LATERAL, [flight]))
    moving = ("beta", "p", "r", "delta_a", "delta_r")
    for factor, told in ((0.5, set()), (2.0, set(moving))):
        scaled = flight.with_columns(**{n: factor * flight[n] for n in moving})
        assert {b.name for b in beyond_flown(model, scaled)} == told
    (first, *_) = beyond_flown(model, flight.with_columns(beta=2.0 * flight["beta"]))
    assert first.text.startswith("beta from ")
    assert " deg, estimated from " in first.text
    assert beyond_flown(LATERAL, flight) == ()  # a model of which nobody says what was flown


def test_a_flight_that_the_model_was_estimated_from_proves_no_match(made_flights: list[Flight], tmp_path: Path) -> None:
    flight, other = (
        replace(f, provenance=replace(f.provenance, sha256=digest))
        for f, digest in zip(made_flights, ("a1", "b2"), strict=False)
    )
    middle = 0.5 * (flight.time[0] + flight.time[-1])
    first_half, second_half = flight.part(flight.time < middle), flight.part(flight.time > middle)
    model = replace(LATERAL, estimated_from=stretches_of_recordings([first_half]))
    assert was_estimated_from(model, flight)
    assert was_estimated_from(model, flight.part(flight.time < middle - 1.0))
    assert not was_estimated_from(model, second_half)
    assert not was_estimated_from(model, other)
    assert not was_estimated_from(model, replace(flight, provenance=replace(flight.provenance, sha256="")))
    write_model(model, tmp_path / "m.toml")
    assert read_model(tmp_path / "m.toml").estimated_from == model.estimated_from
    answer = ss.match(tmp_path / "m.toml", [flight, second_half], aircraft="cdfp")
    assert [p["estimated_from"] for p in answer.to_json()["flights"]] == [True, False]
    assert sum("proves no match" in line for line in answer.lines()) == 1
    broken = (tmp_path / "m.toml").read_text().replace('sha256 = "a1"', "sha = 1")
    (tmp_path / "m.toml").write_text(broken)
    with pytest.raises(ModelError, match="estimated_from"):
        read_model(tmp_path / "m.toml")


def test_from_the_command_line(made_flights: list[Flight], tmp_path: Path) -> None:
    flight = made_flights[0]
    fast = flight.with_columns(V=1.5 * flight["V"])
    for name, one in (("a", flight), ("b", fast)):
        write_flight(one, tmp_path / f"{name}.mcap")
    run = CliRunner()
    done = run.invoke(
        estimate,
        [str(tmp_path / "a.mcap"), "--aircraft", "cdfp", "--save-model", str(tmp_path / "m.toml")],
        standalone_mode=False,
    )
    assert done.exception is None
    assert set(tomllib.loads((tmp_path / "m.toml").read_text())["flown"]) >= {"beta", "V", "delta_a"}
    told = run.invoke(
        match,
        [str(tmp_path / "m.toml"), *(str(tmp_path / f"{n}.mcap") for n in "ab"), "--json", str(tmp_path / "p.json")],
        standalone_mode=False,
    )
    assert "beyond what the model was estimated from: V from " in told.output
    first, second = json.loads((tmp_path / "p.json").read_text())["flights"]
    assert first["beyond"] == {}
    assert second["beyond"]["V"]["here"][1] > second["beyond"]["V"]["flown"][1]


def test_a_file_keeps_the_ranges_and_refuses_what_are_none(tmp_path: Path) -> None:
    made = replace(LATERAL, flown={"beta": (-0.1, 0.12)})
    write_model(made, tmp_path / "m.toml")
    assert read_model(tmp_path / "m.toml") == made
    assert read_model(tmp_path / "m.toml").with_starts(Cl_p=-0.4).flown == made.flown
    assert LATERAL.digest == replace(made, flown={}).digest
    text = (tmp_path / "m.toml").read_text()
    for wrong in ("[1.0]", "[2.0, 1.0]", '["a", 1.0]', "3.0"):
        broken = text[: text.index("beta = [", text.index("[flown]"))] + f"beta = {wrong}\n"
        (tmp_path / "m.toml").write_text(broken)
        with pytest.raises(ModelError, match=r"flown\.beta"):
            read_model(tmp_path / "m.toml")
