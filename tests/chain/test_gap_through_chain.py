"""The gap workflow on recordings that went through sensors, bus, logger and calibration, attitude filter included."""

import json

import pytest

from estimation.gap.answer.result import GapResult
from estimation.gap.effects import catalogue
from estimation.gap.workflow import Options, run_gap
from estimation.models.load import load_model
from groundstation.flight import read_flight
from tests.support.paths import ROOT

FOLDER = ROOT / "recordings" / "gap"
OPTIONS = Options(seed=2, most=2)


def answer(letter: str) -> GapResult:
    flights = [read_flight(FOLDER / f"{letter}_{k}.mcap") for k in range(4)]
    return run_gap(load_model("lateral", "cdfp"), flights[:3], flights[3:], catalogue(), OPTIONS)


@pytest.mark.study
@pytest.mark.parametrize("letter", ["b", "c"])
def test_says_what_the_key_says(letter: str) -> None:
    """One set hides nothing, one a single effect of usual size; the key is read here, by the workflow never."""
    hidden = [name for name, _ in json.loads((FOLDER / "key.json").read_text(encoding="utf-8"))[letter]["hidden"]]
    result = answer(letter)
    assert [s.effect for s in result.steps] == hidden
    assert result.verdict == ("gap_closed" if hidden else "no_gap")
    gate = result.details["kinematic_gate"]
    assert isinstance(gate, dict)
    assert gate["origin"] == "physics"  # the attitude filter leaves nothing that contradicts the other instruments
