"""Stretches by mode and by condition: one parser, nothing evaluated as code; what is no flight is left out, and said."""

import numpy as np
import pytest

from estimation.prepare.stretches import select_segments
from groundstation.flight import Flight, Provenance
from groundstation.flight.errors import FlightError
from groundstation.flight.expression import DEEPEST, ExpressionError, parse, parse_condition
from groundstation.flight.marks import FlightMode, Mark, Marks, marks_of
from groundstation.flight.stretches import airborne, is_times, stretches_where

MODES = Marks(
    (
        FlightMode("FBWA", 0.0, 20.0),
        FlightMode("MANUAL", 20.0, 31.0),
        FlightMode("FBWA", 31.0, 70.0),
        FlightMode("MANUAL", 70.0, 81.0),
    )
)


def flown(**columns: np.ndarray) -> Flight:
    time = np.arange(0.0, 100.0, 0.1)
    every = {
        "V": np.full(time.size, 21.0),
        "phi": 0.8 * np.sin(time / 7.0),
        "altitude": np.full(time.size, 90.0),
        **columns,
    }
    return Flight.build("x", time, every, provenance=Provenance(detail={**MODES.to_json()}))


def runs(label: np.ndarray) -> list[tuple[int, int]]:
    return [(int(np.flatnonzero(label == n)[0]), int(np.flatnonzero(label == n)[-1])) for n in range(label.max() + 1)]


def test_a_mode_names_its_stretches_whatever_the_case() -> None:
    assert runs(stretches_where(flown(), "mode:manual").label) == [(200, 309), (700, 809)]


def test_a_condition_reads_columns_and_modes() -> None:
    flight = flown()
    found = stretches_where(flight, "mode:MANUAL and (abs(phi) < 0.3 or 20 < time <= 24)").label >= 0
    expected = (np.abs(flight["phi"]) < 0.3) | ((flight.time > 20) & (flight.time <= 24))
    inside = ((flight.time >= 20) & (flight.time < 31)) | ((flight.time >= 70) & (flight.time < 81))
    assert not np.any(found & ~(expected & inside))
    assert found.sum() > 0.8 * (expected & inside).sum()  # runs below a second are left out


def test_a_comma_means_or_and_not_turns() -> None:
    both = stretches_where(flown(), "mode:MANUAL, mode:FBWA and time > 90").label  # the second lasts until 70 s
    assert runs(both) == [(200, 309), (700, 809)]
    assert (stretches_where(flown(), "not mode:FBWA").label >= 0).sum() == 110 + 300


def test_nothing_holds_where_a_column_was_not_measured() -> None:
    gone = np.where(np.arange(1000) < 500, np.nan, 0.1)
    for text in ("phi < 1", "not phi > 1", "phi < 1 or V > 3"):
        assert runs(stretches_where(flown(phi=gone), text).label) == [(500, 999)]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("mode:CRUISE", "was never in it; its modes are FBWA, MANUAL"),
        ("alfa > 1", "has no column alfa; it has time, V"),
        ("V > 30", "nothing of x is left: it holds at 0 of 1000 samples"),
        ("V + 3", "a condition, like V > 12 or mode:MANUAL is expected"),
        ("V > (phi > 1)", "a condition stands where a number is expected"),
        ("V and phi > 1", "stand between conditions"),
        ("__import__('os').system('true')", "cannot read"),
        ("(" * 200 + "V > 1" + ")" * 200, "more than"),
        ("not " * 100 + "V >", "ends where a number"),
        ("V > 1 )", "is not expected there"),
    ],
)
def test_what_names_no_stretch_is_a_sentence(text: str, words: str) -> None:
    with pytest.raises(FlightError, match=words.replace("(", r"\(")):
        stretches_where(flown(), text)


def test_a_number_is_no_condition_nor_the_reverse() -> None:
    with pytest.raises(ExpressionError, match="no condition"):
        parse("V > 3")
    assert parse("2 ** 3 * V").values({"V": np.array([0.5])}) == 4.0
    assert parse_condition("-V < +3").values({"V": np.array([-4.0, 1.0])}).tolist() == [0.0, 1.0]
    assert parse("(" * (DEEPEST // 2 - 2) + "V" + ")" * (DEEPEST // 2 - 2)).values({"V": np.array([2.0])}) == 2.0


def test_times_are_told_from_conditions() -> None:
    assert is_times("2:12,15:25")
    assert is_times(" 1e1:2.5e1 ")
    assert not is_times("mode:MANUAL")
    assert not is_times("V > 3")


def test_the_ground_the_roll_and_a_hover_are_left_out_and_said() -> None:
    time = np.arange(0.0, 100.0, 0.1)
    speed = np.interp(time, [0, 8, 14, 60, 62, 70, 72, 86, 92, 100], [0, 0, 19, 19, 4, 4, 19, 19, 0.5, 0.5])
    height = np.interp(time, [0, 16, 40, 80, 88, 100], [4, 4, 90, 90, 4, 4])
    flight = flown(V=speed, altitude=height)
    found = airborne(flight)
    limit = 0.55 * 19
    slow = speed < limit
    lift_off, touch = time[height > 7.0][[0, -1]]
    assert not found.flying[slow & ((time < 20) | (time > 84) | ((time > 62.5) & (time < 69.5)))].any()
    assert not found.flying[(time < lift_off) | (time > touch)].any()
    assert found.flying[(time > lift_off + 0.2) & (time < 59)].all()
    assert "on the ground, at lift-off or landing, or in a hover" in found.text
    assert found.text in stretches_where(flight, "V > 0").notes


def whole_flight(ground_speed: float = 0.0) -> Flight:
    """Standing with a pitot that reads its noise, off, level, landed, standing; by GNSS at rest where it stands, or not."""
    time = np.arange(0.0, 100.0, 0.1)
    speed = np.interp(time, [0, 8, 14, 80, 92, 100], [0, 0, 17, 17, 0, 0])
    noise = np.abs(np.random.default_rng(3).normal(0.0, 1.8, time.size)) * (speed < 2.0)
    height = np.interp(time, [0, 14, 40, 70, 86, 100], [4, 4, 90, 90, 4, 4])
    return flown(V=speed + noise, altitude=height, vn=np.maximum(speed, ground_speed), ve=np.zeros(time.size))


def test_of_a_whole_flight_what_stood_and_rolled_is_left_out_without_being_asked() -> None:
    flight = whole_flight()
    part = select_segments(flight, None)
    assert part["V"].min() > 0.5 * 17
    assert part["altitude"].min() > 7.0
    assert 50.0 < part.time[-1] - part.time[0] < 75.0
    assert airborne(flight).text in [str(n) for n in part.notes]
    assert len(select_segments(flight, "0:100")) == len(flight)  # who asks for the ground has it


def test_a_speed_with_gaps_tells_the_ground_as_well() -> None:
    whole = whole_flight()
    gappy = flown(**{**whole.columns, "V": np.where(np.arange(len(whole)) % 4 == 1, np.nan, whole["V"])})
    assert (airborne(gappy).flying == airborne(whole).flying).mean() > 0.99


def test_an_airspeed_of_nothing_at_speed_over_ground_is_not_standing() -> None:
    assert len(select_segments(whole_flight(ground_speed=17.0), None)) == 1000
    slow_flyer = flown(V=np.full(1000, 2.2), altitude=np.full(1000, 5.0))
    assert len(select_segments(slow_flyer, None)) == 1000


def test_a_stall_is_flown() -> None:
    time = np.arange(0.0, 100.0, 0.1)
    speed = np.where((time > 50) & (time < 51.5), 9.0, 20.0)
    assert airborne(flown(V=speed)).flying.all()


def test_marks_of_a_flight_from_anybody_are_what_they_should_be() -> None:
    detail = {
        "modes": [
            {"mode": "A", "from": 1, "to": 2},
            {"mode": 3, "from": 1, "to": 2},
            {"mode": "B", "from": 5, "to": 2},
            7,
        ],
        "events": [{"time": "x", "text": "y"}, {"time": 1.0, "text": "line\nbreak"}],
        "messages": "none",
    }
    flight = Flight.build("x", np.arange(3.0), {"V": np.ones(3)}, provenance=Provenance(detail=detail))
    found = marks_of(flight)
    assert found.modes == (FlightMode("A", 1.0, 2.0),)
    assert [m.time for m in found.events] == [1.0]
    assert "\n" not in found.events[0].text
    assert found.messages == ()
    assert Marks((), (Mark(1.0, "e"),)).moved(2.0).events[0].time == 3.0
