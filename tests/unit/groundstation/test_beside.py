"""Two flights in one view: the second lies on the first, by likeness, by an input, by an event."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from groundstation.cli.view import view
from groundstation.flight import Flight, Provenance, write_flight
from groundstation.flight.beside import beside
from groundstation.flight.errors import FlightError
from groundstation.flight.marks import FlightMode, Mark, Marks


def flown(start: float, begin: float, end: float, seed: int, event: float | None = None) -> Flight:
    """A stretch of one motion as another recorder shows it: its clock begins at `start`; begin, end: of the motion [s]."""
    rng = np.random.default_rng(seed)
    time = np.arange(begin, end, 0.04)
    doublet = 0.2 * (((time > 31) & (time < 32)).astype(float) - ((time >= 32) & (time < 33)).astype(float))
    p = np.convolve(doublet, np.exp(-np.arange(0, 2, 0.04) / 0.3), "full")[: time.size]
    phi = np.cumsum(p) * 0.04
    noisy = {n: v + 0.003 * rng.standard_normal(time.size) for n, v in {"p": p, "phi": phi}.items()}
    marks = Marks(events=(Mark(start + event - begin, "armed"),)) if event is not None else Marks()
    provenance = Provenance(detail=dict(marks.to_json()))
    return Flight.build(f"f{seed}", start + time - begin, {"delta_a": doublet, **noisy}, provenance=provenance)


@pytest.mark.parametrize("by", ["auto", "correlation", "input"])
def test_the_second_lies_on_the_first(by: str) -> None:
    first, second = flown(500.0, 10.0, 60.0, 1), flown(20.0, 25.0, 50.0, 2)
    found = beside(first, second, by)
    assert found.shift == pytest.approx(495.0, abs=0.06)  # its 20 s are the motion's 25, which are the first's 515
    both = np.isfinite(found.flight["phi_model"])
    assert both.sum() == pytest.approx(25 / 0.04, abs=4)
    np.testing.assert_allclose(found.flight["phi_model"][both], first["phi"][both], atol=0.03)


def test_an_event_that_both_have(tmp_path: Path) -> None:
    first, second = flown(100.0, 10.0, 60.0, 3, event=12.0), flown(0.0, 11.0, 40.0, 4, event=12.0)
    assert beside(first, second, "event").shift == pytest.approx(101.0)
    with pytest.raises(FlightError, match="cannot be laid on f3 by event"):
        beside(first, flown(0.0, 11.0, 40.0, 5), "event")


def test_what_an_autopilot_says_while_it_boots_aligns_nothing() -> None:
    """Each log begins with its version; what both flights did is the change of a mode, 40 and 65 s later."""

    def logged(start: float, manual: float) -> Flight:
        flight = flown(start, 0.0, 100.0, 9)
        modes = (FlightMode("FBWA", start, start + manual), FlightMode("MANUAL", start + manual, start + 100.0))
        said = (Mark(start + 0.2, "ArduPlane V4.5.1 (6a3b91c2)"), Mark(start + 0.2, "ChibiOS: d4fce84e"))
        marks = Marks(modes, (Mark(start, "disarmed"),), said)
        return replace(flight, provenance=Provenance(detail=dict(marks.to_json())))

    found = beside(logged(200.0, 40.0), logged(1000.0, 65.0), "event")
    assert found.shift == pytest.approx(240.0 - 1065.0)
    assert "mode MANUAL" in found.text


def test_two_that_are_not_alike_are_not_correlated() -> None:
    rng = np.random.default_rng(6)
    time = np.arange(0.0, 40.0, 0.05)
    first, second = (Flight.build(n, time, {"p": rng.standard_normal(time.size)}) for n in "ab")
    with pytest.raises(FlightError, match="by correlation"):
        beside(first, second, "correlation")
    assert beside(first, second).text.endswith("both begin together")


def test_the_verb_writes_one_recording_of_both(tmp_path: Path) -> None:
    paths = [tmp_path / f"{n}.mcap" for n in "ab"]
    for path, flight in zip(paths, (flown(500.0, 10.0, 60.0, 7), flown(20.0, 25.0, 50.0, 8)), strict=True):
        write_flight(flight, path)
    words = [*map(str, paths), "--align", "--view", "none", "--rrd", str(tmp_path / "both.rrd")]
    done = CliRunner().invoke(view, words)
    assert done.exit_code == 0, done.output
    assert "b is moved by +495.0" in done.output
    assert (tmp_path / "both.rrd").stat().st_size > 1000
    assert CliRunner().invoke(view, [str(p) for p in paths]).exit_code == 2
