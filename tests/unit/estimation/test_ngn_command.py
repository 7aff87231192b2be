"""Neural Gauss-Newton and the truth column from the command line."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from click.testing import CliRunner

from estimation.aircraft import load_aircraft
from estimation.answers.truth import read_truth
from estimation.errors import EstimationError
from estimation.models import load_model
from estimation.report.estimate_tables import mean_table
from estimation.session import runner
from groundstation.flight import Flight, write_flight
from sideslip.verbs.estimate import estimate
from tests.unit.estimation.truth import TRUE


def run(*words: str) -> Any:
    return CliRunner().invoke(estimate, [*words, "--aircraft", "cdfp"], standalone_mode=False)


def test_networks_bootstrap_and_truth(made_flights: list[Flight], tmp_path: Path) -> None:
    paths = [str(tmp_path / f"{name}.csv") for name in ("one", "two")]
    for flight, path in zip(made_flights, paths, strict=False):
        write_flight(flight.part(slice(0, 400)), path)
    truth = tmp_path / "truth.json"
    truth.write_text(json.dumps({"derivatives": TRUE}))
    answers = []
    for name in ("a.json", "b.json"):
        out = run(*paths, "--method", "ngn-improved", "--bootstrap", "10", "--seed", "2", "--device", "cpu",
                  "--truth", str(truth), "--json", str(tmp_path / name))  # fmt: skip
        assert out.exception is None
        answers.append((tmp_path / name).read_text())
    assert answers[0] == answers[1]
    assert "bootstrap, 10 replicates" in out.output
    assert "truth" in out.output
    data = json.loads(answers[0])
    assert data["truth"]["Cl_p"] == TRUE["Cl_p"]
    assert data["flights"][0]["methods"]["ngn-improved"]["bootstrap"]["replicates"] == 10


def test_report_shows_the_truth_beside_the_means(made_flights: list[Flight]) -> None:
    aircraft = load_aircraft("cdfp")
    session = runner.estimate(load_model("lateral", aircraft), made_flights[:2], aircraft, ["ls"])
    assert "truth" not in mean_table(session).head
    table = mean_table(replace(session, truth={"Cl_p": -0.48}))
    assert table.head[-1] == "truth"
    assert {row[0]: row[-1] for row in table.rows if row[-1]} == {"Cl_p": "-0.4800"}


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU here")
def test_what_cannot_be_had_is_one_sentence(made_flights: list[Flight], tmp_path: Path) -> None:
    flight = str(tmp_path / "f.csv")
    write_flight(made_flights[0].part(slice(0, 100)), flight)
    for words, said in (
        (("--method", "ngn", "--device", "cuda"), "no GPU here"),
        (("--method", "ngn", "--bootstrap", "3"), "at least 10"),
        (("--method", "ls", "--bootstrap", "30"), "methods ml, ngn and ngn-improved"),
        (("--truth", str(tmp_path / "none.json")), "no such file"),
    ):
        error = run(flight, *words).exception
        assert isinstance(error, EstimationError)
        assert said in str(error)
        assert "\n" not in str(error)


def test_truth_is_found_by_the_name_of_the_flight(tmp_path: Path) -> None:
    file = tmp_path / "key.json"
    own, other = {"Cl_p": -0.5}, {"Cl_p": -0.4}
    for data in (
        own,
        {"derivatives": own},
        {"recordings": [{"name": "x", "derivatives": other}, {"name": "ordinary_0", "derivatives": own}]},
        {"ordinary": {"hidden": None, "derivatives": own}, "vane_lag": {"derivatives": other}},
    ):
        file.write_text(json.dumps(data))
        assert read_truth(file, ["ordinary_0"]) == own
    with pytest.raises(EstimationError, match="not one"):
        read_truth(file, ["ordinary_0", "vane_lag_0"])
    file.write_text(json.dumps({"recordings": []}))
    with pytest.raises(EstimationError, match="no derivatives there for x"):
        read_truth(file, ["x"])
    file.write_text("Cl_p = 3")
    with pytest.raises(EstimationError, match="not JSON"):
        read_truth(file, ["x"])
