"""The answer comes first: on the page, on the console, in Python; details fold."""

import re

import numpy as np
import pytest

from estimation.aircraft import load_aircraft
from estimation.answers.estimates import Estimates, session_lines
from estimation.errors import AircraftError, UnknownNameError
from estimation.models import load_model
from estimation.report.answer import AnswerRow, leading_answer, next_steps
from estimation.resolve import resolve
from estimation.session import runner
from estimation.session.session import EstimationSession
from groundstation.flight import Flight, MissingColumnError
from tests.support.unwritten_figures import unwritten_figures
from tests.unit.estimation.truth import NOISE, TRUE, Case, fly


@pytest.fixture(scope="module")
def session() -> EstimationSession:
    """A flight without rudder: its derivatives cannot be told."""
    flights = fly(Case(noise=NOISE, rudder=0.0), np.random.default_rng(21))[0]
    aircraft = load_aircraft("cdfp")
    return runner.estimate(load_model("lateral", aircraft), flights, aircraft, ["ml"])


@pytest.fixture(scope="module")
def page(session: EstimationSession, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The page of the report."""
    with unwritten_figures():
        return Estimates(session).report(tmp_path_factory.mktemp("report")).read_text(encoding="utf-8")


def test_the_first_screen_is_verdict_table_picture_fit_and_next_in_this_order(page: str) -> None:
    text = page
    marks = ['class="verdict-line"', 'id="answer"', 'id="forest"', 'id="strips"', "<b>Next</b>", "<details"]
    places = [text.index(mark) for mark in marks]
    assert places == sorted(places)
    headings = re.findall(r"<h2[^>]*>", text[: places[-1]])
    assert headings == []  # everything with a heading of its own is folded
    assert "<details open" not in text


def test_rows_are_the_estimates_with_what_was_believed_and_published(session: EstimationSession) -> None:
    answer = leading_answer(session)
    rows = {row.name: row for row in answer.rows}
    result = session.flights[0].results["ml"]
    assert rows["Cl_p"].value == result.parameters["Cl_p"].estimate
    assert (rows["Cl_p"].prior, rows["Cl_p"].published) == (-0.45, -0.4951)
    assert set(answer.undetermined) >= {"CY_dr", "Cl_dr", "Cn_dr"}
    assert not any(name.endswith("_0") for name in rows)  # trims of a day
    assert abs(rows["Cl_p"].value - TRUE["Cl_p"]) < 4 * rows["Cl_p"].bound
    (fly_rudder, *_) = next_steps(session, answer)
    assert "rudder" in fly_rudder
    assert "Cn_dr" in fly_rudder


def test_a_simple_model_that_is_refused_is_answered_with_the_whole_one() -> None:
    """It lacked p sin(alpha), and `Cn_da` was named for that."""
    flight = fly(Case(noise=NOISE), np.random.default_rng(1))[0][0]
    aircraft = load_aircraft("cdfp")
    session = runner.estimate(load_model("lateral-simple", aircraft), [flight], aircraft, ["ml"])
    answer = leading_answer(session)
    assert answer.verdict.startswith("Do not use these numbers yet")
    steps = next_steps(session, answer)
    assert any("--model lateral;" in step for step in steps)
    assert not any("--structure" in step for step in steps)


def test_the_console_has_the_same_order_and_gives_no_number_for_what_cannot_be_told(session: EstimationSession) -> None:
    lines = list(session_lines(session))
    answer = leading_answer(session)
    order = [
        lines.index(answer.verdict),
        *(next(i for i, t in enumerate(lines) if t.startswith(w)) for w in ("Cl_p ", "next: ")),
    ]
    assert order == sorted(order)
    assert order[-1] < 30  # a terminal's first screen
    (blind,) = (t for t in lines[: order[-1]] if t.startswith("Cn_dr "))
    assert re.fullmatch(r"Cn_dr +cannot tell +-0.0093 +-0.0327", blind)
    value, bound, low, high = next(t for t in lines if t.startswith("Cl_p ")).split()[1:5]
    assert float(high) - float(low) == pytest.approx(2 * 1.96 * float(bound), rel=0.1)
    assert float(low) < float(value) < float(high)


def test_every_table_heads_the_corrected_bound_as_such(session: EstimationSession, page: str) -> None:
    """`bound` is Cramer-Rao's, `corrected` the one to use: printed and on the page."""
    answer = page[page.index('id="answer"') :]
    assert "± corrected</th>" in answer[: answer.index("</table>")]
    lines = list(session_lines(session))
    ml = session.flights[0].results["ml"].parameters["Cl_p"]
    assert ml.std_coloured > 1.2 * ml.std
    for start, heads in (("Cl_p ", ("corrected",)), ("  Cl_p ", ("bound", "corrected"))):
        row = next(i for i, text in enumerate(lines) if text.startswith(start))
        head = next(text.split() for text in reversed(lines[:row]) if "estimate" in text.split()[:2])
        values = dict(zip(heads, lines[row].split()[2 : 2 + len(heads)]))
        assert tuple(h for h in head if h in ("bound", "corrected")) == heads
        assert float(values["corrected"]) == pytest.approx(ml.std_coloured, rel=0.1)


def test_a_forest_shows_estimates_at_nought_and_others_where_they_lie() -> None:
    from matplotlib.figure import Figure

    from estimation.report.drawing.forest import draw_forest

    rows = [
        AnswerRow("Cl_p", -0.5, 0.01, identifiable=True, prior=-0.45),
        AnswerRow("Cn_r", 0.2, 0.3, identifiable=True, prior=-0.4),  # beyond the axis: an arrow
        AnswerRow("Cn_dr", 0.7, 0.1, identifiable=False, prior=0.1),
    ]
    axis = draw_forest(Figure().subplots(), rows)
    prior = next(line for line in axis.lines if line.get_label() == "before flying")
    assert prior.get_xdata() == pytest.approx([10.0])  # -0.45 is 10 % of the estimate above it
    assert [line.get_marker() for line in axis.lines if line.get_marker() in "<>"] == ["<"]
    assert [text.get_text() for text in axis.texts] == ["cannot tell"]
    estimates = axis.containers[0].lines[0]
    assert list(estimates.get_xdata()) == [0.0, 0.0]
    assert "truth" not in [text.get_text() for text in axis.get_legend().get_texts()]


def test_nothing_prints_pages_and_errors_name_what_is_near(session: EstimationSession) -> None:
    answer = Estimates(session)
    for shown in (answer, answer.model, answer.best, session):
        assert 20 < len(repr(shown)) < 300
    with pytest.raises(UnknownNameError, match="did you mean Cl_p"):
        answer["Cl_P"]
    with pytest.raises(KeyError):
        answer["unheard of"]
    flight = Flight.build("f", np.arange(9) * 0.1, {"beta": np.zeros(9)})
    with pytest.raises(MissingColumnError, match="did you mean beta"):
        flight["betta"]
    with pytest.raises(AircraftError, match="no flight is given"):
        resolve([], "lateral")
