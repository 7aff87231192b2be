"""A long record is checked in the time of a short one: what its factors come from, and that they are right."""

import numpy as np
import pytest

from estimation.compatibility import excited, problem
from estimation.compatibility.excited import excited_pieces
from estimation.compatibility.kalman import FilterRecord
from estimation.compatibility.reconstruction import compatibility
from groundstation.flight import Flight
from groundstation.flight.arrays import MOST_WINDOWS, WINDOW, windows
from tests.unit.estimation.test_compatibility import PLANTED, errors, flight

RATE = 50.0


def record(seconds: float, movement: np.ndarray, rng: np.random.Generator) -> FilterRecord:
    """Noise in three inputs and two outputs, as large as `movement` says of each tenth of the record."""
    time = np.arange(0.0, seconds, 1.0 / RATE)
    size = np.repeat(movement, -(-time.size // movement.size))[: time.size, None]
    return FilterRecord(0, time, size * rng.standard_normal((time.size, 3)), size * rng.standard_normal((time.size, 2)))


def test_a_short_record_is_used_whole(rng: np.random.Generator) -> None:
    short = [record(300.0, np.ones(10), rng), record(200.0, np.ones(10), rng)]
    chosen, note = excited_pieces(short)
    assert chosen is short
    assert note == ""


def test_of_each_span_of_a_long_record_the_piece_that_moves_most_is_used(rng: np.random.Generator) -> None:
    movement = np.ones(40)
    movement[1::4] = 3.0
    chosen, note = excited_pieces([record(1200.0, movement, rng)])
    assert len(chosen) == 10
    assert "15000 of 60000 samples" in note
    assert [r.first for r in chosen] == [1500 * k for k in range(1, 40, 4)]


def test_a_fault_of_one_channel_does_not_decide_what_is_used(rng: np.random.Generator) -> None:
    movement = np.ones(40)
    movement[1::4] = 1.5
    sound = record(1200.0, movement, rng)
    u = sound.u.copy()
    u[2 * 1500 : 3 * 1500, 0] *= 1e6
    chosen, _ = excited_pieces([FilterRecord(0, sound.time, u, sound.z)])
    assert chosen[0].first == 1500


def test_factors_of_a_part_are_right_and_said(monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator) -> None:
    whole = flight(rng, seconds=60.0, **PLANTED)
    for module in (excited, problem):
        monkeypatch.setattr(module, "LONG_SAMPLES", 500)
    monkeypatch.setattr(excited, "MOST_SAMPLES", 500)
    monkeypatch.setattr(excited, "SHORTEST_PIECE_S", 10.0)
    monkeypatch.setattr(excited, "LONGEST_PIECE_S", 10.0)
    monkeypatch.setattr(excited, "FEWEST_PIECES", 2)
    result = compatibility(whole)
    assert np.abs(errors(result, PLANTED)).max() < 4.0
    assert any("of 1200 samples" in n for n in result.flights[0].notes)
    assert np.isfinite(result.flights[0].reconstructed).all()  # the motion is of all of it


def test_windows_of_a_long_record_are_even_and_bounded() -> None:
    time = np.arange(0.0, 5.0 * MOST_WINDOWS * WINDOW, 0.2)
    seen = [t[0] for t, _ in windows(time, np.sin(time))]
    assert 0.95 * MOST_WINDOWS < len(seen) <= MOST_WINDOWS + 1
    assert np.ptp(np.diff(seen)) < 1.0
    assert seen[-1] > 0.99 * time[-1] - 5 * WINDOW
    short = time[time < 100.0]
    assert len(list(windows(short, short))) == 25


def test_check_of_a_flight_says_what_was_left_out_once(rng: np.random.Generator) -> None:
    made = flight(rng)
    without = Flight.build("made", made.time, {n: v for n, v in made.columns.items() if n != "beta"})
    left_out = compatibility(without, ("dax", "day", "daz", "dp", "dq", "dr")).flights[0].left_out
    assert ["beta" in f.text for f in left_out].count(True) == 1
