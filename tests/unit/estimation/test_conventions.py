"""Reports state what their numbers mean; a thesis table prints no number that could not be told."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from estimation.aircraft import load_aircraft
from estimation.answers.estimates import session_lines
from estimation.models import load_model
from estimation.report.conventions import conventions, conventions_table
from estimation.report.model_export import export_estimates
from estimation.report.tables import CANNOT_TELL, ReportTable
from estimation.session import runner
from estimation.session.session import EstimationSession
from groundstation.flight import Provenance
from tests.unit.estimation.truth import NOISE, Case, fly


@pytest.fixture(scope="module")
def session() -> EstimationSession:
    """A flight without any rudder, whose derivatives cannot be told."""
    flights = fly(Case(noise=NOISE, rudder=0.0), np.random.default_rng(8))[0]
    aircraft = load_aircraft("cdfp")
    return runner.estimate(load_model("lateral", aircraft), flights, aircraft, ["ml"])


def test_the_printed_answer_and_the_page_state_conventions_and_constants(session: EstimationSession) -> None:
    text = "\n".join(session_lines(session))
    for words in (
        "per rad",
        "p b/2V",
        "rolls left",
        "y right",
        "S 0.787 m2",
        "b 1.5 m",
        "m 3.5 kg",
        "Ixz 0.008",
        "0.44 m aft",
    ):
        assert words in text
    assert "wind tunnel" in text
    assert "a yaw damper behind the record passes for Cn_r and CY_r" in text
    assert "pitch damper" not in text
    table = conventions_table(session)
    assert {"axes", "units", "signs", "controls", "constants", "CG"} <= {row[0] for row in table.rows}


def test_what_corrected_bounds_hold_of_stated_uncertainties_is_said(session: EstimationSession) -> None:
    """0.24 m/s of some 16 are 1.5 %, twice that of a derivative; nothing is said where nobody has stated any."""
    assert "corrected bounds" not in dict(conventions(session))
    fit = session.flights[0]
    V = float(np.nanmedian(fit.flight["V"]))
    stated = replace(fit.flight, provenance=Provenance(detail={"uncertainty": {"V": 0.015 * V}}))
    calibrated = replace(session, flights=(replace(fit, flight=stated),))
    assert "airspeed's calibration (3.0% of each derivative)" in dict(conventions(calibrated))["corrected bounds"]


def test_a_latex_table_has_no_number_for_what_cannot_be_told_and_the_belief_beside_what_can(
    session: EstimationSession, tmp_path: Path
) -> None:
    export_estimates(session.to_json(), tmp_path / "t.tex")
    lines = (tmp_path / "t.tex").read_text().splitlines()
    (rudder,) = (line for line in lines if "n_{\\delta_r}" in line)
    assert "cannot tell" in rudder
    (damping,) = (line for line in lines if "-0.45$" in line)
    assert "cannot tell" not in damping
    assert "engineering estimate" in damping


def test_a_group_that_ends_in_cannot_tell_says_only_that() -> None:
    row = ("Cn_dr", "0.12", "0.01", CANNOT_TELL, "0.13", "0.02", "0.03")
    table = ReportTable(
        "t", "c", ("", *("estimate", "bound", "corrected") * 2), (row,), (("", 1), ("ml", 3), ("ls", 3))
    )
    (line,) = (text for text in table.latex().splitlines() if "cannot tell" in text)
    assert "0.12" not in line
    assert "0.13" in line


def test_sentences_break_in_a_latex_table() -> None:
    table = ReportTable("t", "c", ("what", "how"), (("axes", "x forward " * 20),), symbols=False, texts=(1,))
    assert r"\begin{tabular}{lp{" in table.latex()
