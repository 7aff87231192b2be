"""A whole campaign of simulated flights: 5 % more of one derivative, a vane that slipped and three bad flights are all told."""

from pathlib import Path

import pytest

from groundstation.flight import read_flight
from groundstation.flight.quality.report import quality_report
from tests.studies.campaign_plants import fly, judged, told

pytestmark = [
    pytest.mark.study,
    pytest.mark.timeout(600),
]  # forty flights; each decision on tables alone: test_groups.py

FLIGHTS = 40


def test_everything_planted_is_told_and_nothing_else(tmp_path: Path) -> None:
    fly(tmp_path, FLIGHTS, 1, planted=True)
    claims = told(tmp_path, "ls")
    found = judged(claims, FLIGHTS)
    assert found["Cn_dr told"]
    assert abs(found["change"]) == pytest.approx(0.05 * 0.033, rel=0.35)
    assert found["other differences"] == []
    assert found["slip told"]
    assert max(found["days off"]) <= 1
    assert {"CY_0", "Cn_0"} <= set(found["moved"])
    assert found["bad told"] == 2
    # the third, a roll gyro 20 % too large, contradicts its own bank angle: refused before any estimate
    refused = [f.text for f in quality_report(read_flight(tmp_path / "f023.csv")) if f.severity == "fail"]
    assert len(refused) == 1
    assert refused[0].startswith("phi moves")
    assert found["good told"] == 0
    whole = [r["text"] for r in claims if r["kind"] == "outlying flight"]
    assert any(text.startswith("f008") and "dr (" in text for text in whole)  # its rudder was read 25 % too large
