"""The power goes while the logger records: at most a second is lost, nothing is wrong without saying so, the next one starts."""

from pathlib import Path

import pytest

from daq.contract.recordings.accounting import verify
from daq.contract.recordings.recording import RecordingError
from tests.chain.card.cuts import FLIGHT, ONE_SECOND, Case, cut_flight, next_session
from tests.chain.card.flight import SLOW, SOUND, CardFlight, Slowness
from tests.chain.card.forgetting import CUTS
from tests.chain.card.judge import judge
from tests.chain.card.mounted import MountedCard, need_card
from tests.studies.power_cuts import cuts


def assert_promise_kept(cases: list[Case], most: int = ONE_SECOND) -> None:
    bad = [(c.cut.name, c.at_s, c.left) for c in cases if c.left.wrong or c.left.lost > most]
    assert not bad, f"{len(bad)} of {len(cases)} cuts: {bad[:5]}"
    assert any(c.left.lost for c in cases), "a card that forgets nothing proves nothing"


@pytest.mark.parametrize("slowness", [SOUND, SLOW], ids=["sound card", "slow card"])
def test_at_most_a_second_is_lost(card: MountedCard, tmp_path: Path, slowness: Slowness) -> None:
    instants = [0.4, 1.47, 2.93, 5.2, 7.11]
    cases = cut_flight(card, tmp_path, instants, slowness=slowness, recorder={"segment_s": 4.0})
    assert len(cases) == len(instants) * len(CUTS)
    assert_promise_kept(cases)


def test_the_moments_around_a_new_file(card: MountedCard, tmp_path: Path) -> None:
    instants = [2.2 + 0.17 * i for i in range(6)]
    cases = cut_flight(card, tmp_path, instants, slowness=SLOW, recorder={"segment_s": 2.0})
    assert_promise_kept(cases)


def test_a_session_shows_from_its_first_moments(card: MountedCard, tmp_path: Path) -> None:
    """Before the first scan has been flushed the card has the session's name, and its head says what it is."""
    (case,) = cut_flight(card, tmp_path, [0.6], slowness=SOUND, cuts=CUTS[:1])
    (session,) = (case.directory / FLIGHT / "onboard").iterdir()
    found = verify(session)
    assert (found.ok, found.scans) == (False, 0), found.text
    assert "no scan in it" in found.text


def test_a_file_that_never_came_is_missed(card: MountedCard, tmp_path: Path) -> None:
    """The first file ended in order, and the name of the second is lost: what is there must not pass for the whole flight."""
    instants = [2.6 + 0.1 * i for i in range(5)]
    cases = cut_flight(card, tmp_path, instants, slowness=SLOW, recorder={"segment_s": 2.0}, cuts=CUTS[:1])
    sessions = [next((c.directory / FLIGHT / "onboard").iterdir()) for c in cases]
    between = [d for d in sessions if [verify(p).ok for p in d.glob("*.mcap")] == [True]]
    assert between, "no cut fell between the two files"
    for session in between:
        assert not verify(session).ok
        assert "not closed in order" in verify(session).text


@pytest.mark.parametrize("content", [b"", bytes(26_000)], ids=["empty", "zeros"])
def test_a_name_without_content_does_not_hide_the_flight(tmp_path: Path, content: bytes) -> None:
    """What a cut leaves of a file just begun, on a card that keeps names before data."""
    flight = CardFlight(tmp_path, recorder={"segment_s": 1.0})
    flight.fly(3.0)
    blank = max(flight.directory.glob("*.mcap"))
    kept = sum(verify(p).scans for p in flight.directory.glob("*.mcap") if p != blank)
    blank.write_bytes(content)
    found = verify(flight.directory)
    assert not found.ok
    assert found.scans == kept
    assert any(path == blank for path, _ in found.damages)
    assert judge(flight.directory, flight.truth, flight.taken, tmp_path / "out.mcap").wrong == ()
    with pytest.raises(RecordingError):
        verify(blank)


def test_the_next_session_starts_by_itself(card: MountedCard, tmp_path: Path) -> None:
    cases = cut_flight(card, tmp_path, [0.05, 0.5, 2.3], slowness=SLOW, recorder={"segment_s": 2.0})
    said = {(c.cut.name, c.at_s): wrong for c in cases if (wrong := next_session(c.directory))}
    assert said == {}


def test_sessions_ended_in_order_are_on_the_card_to_the_last_scan(card: MountedCard, tmp_path: Path) -> None:
    """On the card itself, not a copy; the second session finds what the first one and the cut have left."""
    flown = []
    for _ in range(2):
        flight = CardFlight(card.path / FLIGHT)
        assert flight.fly(2.0).closes
        flown.append(flight)
        card.cut(CUTS[0])
    for number, flight in enumerate(flown):
        left = judge(flight.directory, flight.truth, flight.taken, tmp_path / f"{number}.mcap")
        assert (left.lost, left.wrong) == (0, ())
        assert verify(flight.directory).ok


@pytest.mark.study
@pytest.mark.timeout(900)
@pytest.mark.parametrize("slowness", [SOUND, SLOW], ids=["sound card", "slow card"])
def test_two_hundred_and_forty_cuts(tmp_path: Path, slowness: Slowness) -> None:
    need_card()
    cases = cuts(30, 100, slowness, tmp_path)
    assert len(cases) == 30 * len(CUTS) == 240
    assert_promise_kept(cases)
    assert all(next_session(c.directory) == [] for c in cases[::25])
