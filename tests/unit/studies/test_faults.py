"""Figures of the study of faults, on flights whose alarms are known; the flights themselves are a study."""

import math

import pytest

from tests.studies import faults as study

BEGINS = study.BEGINS_S


def test_figures_are_counted_as_published() -> None:
    flights = [
        study.Alarmed("elevon_stuck", BEGINS + 1.0, "Cl"),
        study.Alarmed("rudder_stuck", BEGINS + 4.0, "CY"),
        study.Alarmed("vane_slipped", BEGINS - 3.0, "sensor"),  # before the fault: false, and the fault not found
        study.Alarmed("engine_out", None),
        study.Alarmed("none", None),
        study.Alarmed("none", 30.0, "Cn"),
    ]
    found = study.Figures.of(flights)
    assert found.precision == pytest.approx(2 / 4)
    assert found.recall == pytest.approx(2 / 4)
    assert found.delay == pytest.approx(2.5)
    assert [f.false for f in flights] == [False, False, True, False, False, True]
    assert math.isnan(study.Figures.of([study.Alarmed("none", None)]).precision)


def test_every_kind_is_a_failure_of_the_simulator() -> None:
    for kind in study.KINDS:
        hidden = study.scenario(kind, 3).hidden
        assert [h.name for h in hidden] == ([] if kind == "none" else [kind])


def test_a_table_has_a_row_for_each_kind_and_the_metric() -> None:
    lines = study.table([study.Alarmed("elevon_stuck", BEGINS + 1.0, "Cl"), study.Alarmed("none", None)])
    assert any("right elevon" in line and "| 1 | 1 | 0 | 1.0 | 1.0 | Cl 1 |" in line for line in lines)
    assert "| surfaces | 1.00 | 1.00 | 1.0 |" in lines
