"""`--simulation` on the command line and in Python: the same numbers, one sentence where it cannot be."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

import sideslip as ss
from estimation.models import load_model, read_model, write_model
from sideslip.cli import cli
from tests.support.paths import RECORDINGS

LD2, LD4 = RECORDINGS / "cdfp_ld2.mcap", RECORDINGS / "cdfp_ld4.mcap"


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """A simulation that damps roll too little."""
    path = tmp_path / "own.toml"
    write_model(load_model("lateral", "cdfp").with_starts(Cl_p=-0.30), path)
    return path


def test_estimate_says_what_the_simulation_has_wrong(own: Path, tmp_path: Path) -> None:
    out = tmp_path / "estimate.json"
    done = CliRunner().invoke(
        cli, ["estimate", str(LD4), "--simulation", str(own), "--json", str(out)], catch_exceptions=False
    )
    assert done.exit_code == 0, done.output
    found = json.loads(out.read_text(encoding="utf-8"))["flights"][0]["methods"]["ml"]["parameters"]
    plain = ss.estimate(LD4, "lateral")
    of_plain = next(iter(plain.session.flights)).results["ml"].parameters["Cl_p"]
    assert found["Cl_p"]["estimate"] == pytest.approx(of_plain.estimate, abs=0.05 * of_plain.std)
    assert "k_Cl" not in {n for n, p in found.items() if p["identifiable"]}
    in_python = ss.estimate(LD4, "lateral", simulation=str(own))
    same = next(iter(in_python.session.flights)).results["ml"].parameters["Cl_p"]
    assert same.estimate == pytest.approx(found["Cl_p"]["estimate"], rel=1e-6)


def test_match_judges_the_simulation_as_it_is(own: Path, tmp_path: Path) -> None:
    worse, better = tmp_path / "worse.json", tmp_path / "better.json"
    runner = CliRunner()
    runner.invoke(cli, ["match", "lateral", str(LD2), "--simulation", str(own), "--json", str(worse)])
    saved = tmp_path / "child.toml"
    runner.invoke(cli, ["estimate", str(LD4), "--simulation", str(own), "--save-model", str(saved)])
    assert any(s.computed for s in read_model(saved).inputs)
    done = runner.invoke(cli, ["match", str(saved), str(LD2), "--simulation", str(own), "--json", str(better)])
    assert done.exit_code in (0, 1), done.output
    theil = [json.loads(p.read_text(encoding="utf-8"))["flights"][0]["fit"]["p"]["theil"] for p in (worse, better)]
    assert theil[1] < 0.7 * theil[0]


@pytest.mark.parametrize("verb", ["estimate", "match", "gap"])
def test_a_simulation_that_is_none_costs_one_sentence(verb: str, tmp_path: Path) -> None:
    words = [verb, *(["lateral"] if verb == "match" else []), str(LD4), "--simulation", "nowhere"]
    done = CliRunner().invoke(cli, words)
    assert "jsbsim:AIRCRAFT" in str(done.exception)
