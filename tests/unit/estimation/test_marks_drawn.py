"""Reports draw what a log says beside its samples, and lay two flights on one another in time."""

import base64

import numpy as np
import pytest
from matplotlib.figure import Figure

from estimation.errors import EstimationError
from estimation.report.drawing.marks_drawn import MOST_NAMED, aligned_figures, draw_marks
from groundstation.flight import Flight, Provenance
from groundstation.flight.errors import FlightError
from groundstation.flight.marks import FlightMode, Mark, Marks


def flight(name: str, start: float, seed: int, marks: Marks | None = None, moved: float = 12.0) -> Flight:
    """A roll and back; `moved`: when, after the start [s]."""
    time = np.arange(0.0, 40.0, 0.05)
    aileron = 0.15 * ((time > moved) & (time < moved + 1.5)) - 0.15 * ((time >= moved + 1.5) & (time < moved + 3.0))
    p = np.convolve(aileron, np.exp(-np.arange(0, 2, 0.05) / 0.4), "full")[: time.size]
    noise = np.random.default_rng(seed).normal(0, 0.002, time.size)
    detail = dict((marks or Marks()).to_json())
    return Flight.build(name, start + time, {"delta_a": aileron, "p": p + noise}, provenance=Provenance(detail=detail))


def modes(count: int) -> Marks:
    names = [("MANUAL", "FBWA")[i % 2] for i in range(count)]
    spans = tuple(FlightMode(n, 100.0 + 40.0 * i / count, 100.0 + 40.0 * (i + 1) / count) for i, n in enumerate(names))
    return Marks(spans, (Mark(117.0, "armed"),), (Mark(300.0, "after the stretch"),))


def test_modes_are_shaded_and_events_are_lines() -> None:
    axes = Figure().subplots(2, 1)
    draw_marks(axes, flight("a", 100.0, 1, modes(3)))
    assert [len(axis.patches) for axis in axes] == [3, 3]
    assert axes[0].patches[0].get_facecolor() != axes[0].patches[1].get_facecolor()
    assert [t.get_text() for t in axes[0].texts] == ["MANUAL", "FBWA", "MANUAL"]
    assert [line.get_xdata()[0] for line in axes[1].lines] == [117.0]  # what was said after the stretch is not in it
    assert [t.get_text() for t in axes[1].texts] == ["armed"]


def test_many_modes_have_no_names_and_one_has_no_shade() -> None:
    many, one = Figure().subplots(1, 2)
    draw_marks([many], flight("a", 100.0, 1, modes(MOST_NAMED + 2)))
    assert len(many.patches) == MOST_NAMED + 2
    assert [t.get_text() for t in many.texts] == ["armed"]
    draw_marks([one], flight("b", 100.0, 1, modes(1)))
    assert not one.patches
    assert one.texts[0].get_text() == "MANUAL"


def test_flights_are_laid_on_the_first_in_its_time() -> None:
    first, second = flight("morning", 100.0, 2, modes(2)), flight("evening", 900.0, 3, moved=20.0)
    (drawn,) = aligned_figures([first, second], "correlation")
    assert "evening is moved by -808.00 s onto morning" in drawn.caption
    svg = base64.b64decode(drawn.uri.partition(",")[2]).decode()
    assert all(text in svg for text in ("morning", "evening", "FBWA"))
    with pytest.raises(FlightError, match="by event"):
        aligned_figures([first, flight("other", 0.0, 5)], "event")


def test_one_flight_alone_cannot_be_laid_on_another() -> None:
    import sideslip as ss

    with pytest.raises(EstimationError, match="two or more"):
        ss.check([flight("a", 0.0, 4)], align="auto")
