"""The card of a test point: go on, stop, repeat or not, and one line for the link."""

import math
from collections.abc import Mapping

import pytest

from daq.identification.airframe import Airframe
from daq.identification.estimates import LiveDerivative, LiveEstimates
from daq.identification.next_manoeuvre import ManoeuvreAdvice
from daq.identification.point_quality import FlownPoint
from daq.identification.regression import LiveAircraft
from groundstation.identification.session import LiveState
from groundstation.identification.words import LINE, markdown, point_decision, point_line, state_lines

DEG = math.pi / 180.0
ADVICE = ManoeuvreAdvice("aileron 3-2-1-1", "Cl_p", 2.4, 1.1, 1.0, {"aileron": 6 * DEG}, 2.8)


def state(
    to_go: Mapping[str, float], *, moving: bool = False, faults: tuple[str, ...] = (), advised: bool = True
) -> LiveState:
    """After an aileron input of 5 deg that has narrowed Cl_p from 0.06 to 0.03."""
    aircraft = LiveAircraft("test", Airframe(2.0, 0.4, 3.0, 0.2, 0.2, 0.3, 0.01))
    known = {
        n: LiveDerivative(n, -0.5, 0.03 if n == "Cl_p" else math.inf, 0.03, "" if n == "Cl_p" else "no")
        for n in aircraft.derivatives
    }
    point = FlownPoint(40.0, 3.0, moving, {"delta_a": 5 * DEG, "delta_r": 0.1 * DEG}, {"beta": 0.2 * DEG}, 16.0, faults)
    wanted = dict.fromkeys(to_go, 0.025)
    estimates = LiveEstimates(50.0, 20.0, 400, known, ())
    advice = ADVICE if advised else None
    return LiveState(50.0, aircraft, estimates, wanted, to_go, {}, (), advice, 0, point, {"Cl_p": 0.06})


@pytest.mark.parametrize(
    ("seen", "words"),
    [
        (state({"Cl_p": 0.0}), "stop, every wanted bound is reached"),
        (
            state({"Cl_p": 12.0, "Cn_r": 40.0}, moving=True),
            "go on, at this rate bounds are reached of Cl_p in 12 s, Cn_r in 40 s",
        ),
        (state({"Cl_p": 300.0}, moving=True), "stop, this input brings no bound within a minute"),
        (
            state({"Cl_p": 12.0}, faults=("bank 20 deg before it: level the wings first",)),
            "repeat it: bank 20 deg before it",
        ),
        (state({"Cl_p": 12.0}), "good; once more of the same axis brings most"),
        (state({"Cl_p": 12.0}, advised=False), "good; need not be repeated"),
    ],
)
def test_what_to_do_with_a_point(seen: LiveState, words: str) -> None:
    assert point_decision(seen).startswith(words)


def test_the_card_says_what_was_flown_and_gained_and_what_comes_next() -> None:
    seen = state({"Cl_p": 12.0})
    for text in ("\n".join(state_lines(seen)), markdown(seen)):
        assert "test point flown: aileron 5.0 deg for 3.0 s at 16.0 m/s, gusts 0.2 deg" in text
        assert "test point has narrowed Cl_p 2.0 times" in text
        assert "next: aileron 3-2-1-1, 6.0 deg for 2.8 s, then hands off to 8 s (bound of Cl_p from 2.4 to 1.1" in text


def test_what_to_do_stands_before_the_table() -> None:
    """The pane is lower than the table on a small screen: what to do now was below its edge."""
    text = markdown(state({"Cl_p": 12.0}, moving=True))
    table = text.index("| now |")
    assert text.index("**test point: go on") < text.index("**next: ") < text.index("test point under way") < table
    assert "| to go | believed | by |" in text


def test_one_line_has_room_on_the_link() -> None:
    line = point_line(state({"Cl_p": 12.0, "Cn_r": 0.0}))
    assert line == "point aileron 5 deg: good; 1/2 there, Cl_p 2.4x; next aileron 3-2-1-1 6.0 deg 3 s"
    assert len(line) <= LINE
    assert point_line(state({}, faults=("gusts",))).startswith("point aileron 5 deg: repeat")
