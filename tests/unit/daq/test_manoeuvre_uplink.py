"""A manoeuvre that goes up the link: whole and proven, or not at all; never into an armed sequencer."""

import json
import math
import time
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from daq.actuation.servos import ServoManoeuvre, plan_of
from daq.contract.link import manoeuvre_wire as wire
from daq.contract.manoeuvre import Manoeuvre, ManoeuvreError
from daq.contract.sequencing import State
from daq.telemetry.manoeuvre_inbox import ManoeuvreInbox
from daq.transport.mavlink_codec import FrameEncoder
from groundstation.receiver import events as ev
from tests.support.link_rig import FakeLogger, Rig
from tests.unit.daq.sequencer_rig import ARM, GO, OFF, sequencer_config, short_manoeuvre, switch_plan
from tests.unit.daq.sequencer_rig import Rig as SequencerRig
from tests.unit.daq.test_uplink import at_rest, keyed

CONFIG = sequencer_config()


class Deck:
    """Takes plans as the logger does. why: what it says against them."""

    def __init__(self) -> None:
        self.plans: list[ServoManoeuvre] = []
        self.why = ""

    def check_manoeuvre(self, manoeuvre: Manoeuvre) -> Callable[[], str]:
        plan = plan_of(manoeuvre, CONFIG)
        return lambda: self._put(plan)

    def _put(self, plan: ServoManoeuvre) -> str:
        if not self.why:
            self.plans.append(plan)
        return self.why


def noisy(seconds: float, seed: int = 1) -> Manoeuvre:
    """A smooth input of three controls."""
    t = np.arange(round(seconds / 0.02) + 1) * 0.02
    rng = np.random.default_rng(seed)
    waves = {
        name: sum(
            a * np.sin(2 * math.pi * k * t / t[-1]) for k, a in zip((2, 3, 5), rng.uniform(0.005, 0.02, 3), strict=True)
        )
        for name in ("delta_e", "delta_a", "delta_r")
    }
    return Manoeuvre("multisine", 0.02, {n: tuple(np.asarray(v).tolist()) for n, v in waves.items()}, aircraft="cdfp")


def told(rig: Rig) -> list[str]:
    return [e.words for e in rig.events if isinstance(e, ev.ManoeuvreSent)]


def until_told(rig: Rig, seconds: float) -> None:
    """Fly until the ground knows what became of it; the thread that weighs it has real time."""
    for _ in range(round(seconds * 4)):
        at_rest(rig, 0.25)
        if told(rig):
            return
        time.sleep(0.002)


@given(st.integers(2, 400), st.integers(0, 2**31), st.sampled_from([0.005, 0.02, 0.1]))
def test_what_is_unpacked_is_what_was_packed(samples: int, seed: int, step: float) -> None:
    rng = np.random.default_rng(seed)
    values = rng.uniform(-0.5, 0.5, (2, samples))
    values[:, [0, -1]] = 0.0
    made = Manoeuvre("x", step, {"delta_e": tuple(values[0].tolist()), "delta_r": tuple(values[1].tolist())}, "a", "m")
    again = wire.unpack(wire.pack(made))
    assert (again.digest, again.kind, again.aircraft, again.model) == (made.digest, "x", "a", "m")
    np.testing.assert_allclose(again.increments["delta_r"], values[1], atol=0.51e-7)


def test_a_minute_of_three_controls_goes_up_and_ten_do_not() -> None:
    assert len(wire.fragments(wire.pack(noisy(60.0)))) <= wire.MOST_FRAGMENTS
    with pytest.raises(ManoeuvreError, match="put the file on board"):
        wire.pack(noisy(590.0))


@pytest.mark.parametrize(
    "content",
    [
        b"[]",
        b"{}",
        b"[" * 5000,
        b'{"kind":1,"time_step":"x"}',
        b'{"kind":"","time_step":NaN,"steps":{"delta_a":[0,1,0]}}',
        b"\xff",
    ],
    ids=["list", "empty", "nested", "words", "nan", "no text"],
)
def test_what_is_no_manoeuvre_is_one_sentence(content: bytes) -> None:
    with pytest.raises(ManoeuvreError, match="manoeuvre sent up"):
        wire.unpack(zlib.compress(content))


def test_a_bomb_and_an_altered_value_are_refused() -> None:
    with pytest.raises(ManoeuvreError, match="longer than it may be"):
        wire.unpack(zlib.compress(b" " * 10_000_000))
    content = json.loads(zlib.decompress(wire.pack(short_manoeuvre())))
    content["steps"]["delta_a"][5] += 1
    content["steps"]["delta_a"][6] -= 2
    content["steps"]["delta_a"][7] += 1
    with pytest.raises(ManoeuvreError, match="digest"):
        wire.unpack(zlib.compress(json.dumps(content).encode()))


def test_it_arrives_over_a_link_that_loses_every_third_frame(tmp_path: Path) -> None:
    rig, deck = keyed(tmp_path), Deck()
    rig.logger.check_manoeuvre = deck.check_manoeuvre
    at_rest(rig)
    turn = iter(range(10**6))
    rig.up = lambda data: b"" if next(turn) % 3 == 0 else data
    manoeuvre = noisy(20.0)
    rig.ground.send_manoeuvre(1, manoeuvre)
    until_told(rig, 60.0)
    assert told(rig) == ["taken"]
    assert [p.digest for p in deck.plans] == [manoeuvre.digest]
    assert (f"manoeuvre {manoeuvre.digest[:6]} taken from the ground", "ground") in rig.logger.marks
    rig.close()


def test_a_refusal_is_told_with_its_reason_and_may_be_over_the_next_time(tmp_path: Path) -> None:
    rig, deck = keyed(tmp_path), Deck()
    rig.logger.check_manoeuvre = deck.check_manoeuvre
    at_rest(rig)
    deck.why = "the pilot's switch is not at off"
    rig.ground.send_manoeuvre(1, short_manoeuvre())
    until_told(rig, 20.0)
    assert told(rig) == ["refused by the aircraft, which says why"]
    at_rest(rig, 3.0)
    assert any(deck.why in e.text for e in rig.events if isinstance(e, ev.StatusText))
    deck.why = ""
    rig.events.clear()
    rig.ground.send_manoeuvre(1, short_manoeuvre())
    until_told(rig, 20.0)
    assert told(rig) == ["taken"]
    rig.close()


def test_limits_of_the_aircraft_hold_for_what_comes_up_the_link(tmp_path: Path) -> None:
    rig, deck = keyed(tmp_path), Deck()
    rig.logger.check_manoeuvre = deck.check_manoeuvre
    at_rest(rig)
    rig.ground.send_manoeuvre(1, short_manoeuvre(peak_deg=20.0))
    until_told(rig, 20.0)
    at_rest(rig, 5.0)
    assert deck.plans == []
    assert any("largest_deg" in e.text for e in rig.events if isinstance(e, ev.StatusText))
    rig.close()


def test_unproven_fragments_do_nothing(tmp_path: Path) -> None:
    rig, deck = keyed(tmp_path), Deck()
    rig.logger.check_manoeuvre = deck.check_manoeuvre
    at_rest(rig)
    data = wire.pack(short_manoeuvre())
    for number, piece in enumerate(pieces := wire.fragments(data)):
        fields = {"checksum": zlib.crc32(data), "fragment": number, "fragments": len(pieces), "length": len(piece)}
        frame = FrameEncoder(255, 190).message(
            "MANOEUVRE_DATA", target_system=1, data=piece.ljust(190, b"\0"), **fields
        )
        rig._air.write(frame)
        at_rest(rig, 0.5)
    at_rest(rig, 3.0)
    assert deck.plans == []
    rig.close()


def test_without_a_key_neither_end_has_anything_to_do_with_it() -> None:
    rig = Rig(None)
    at_rest(rig)
    with pytest.raises(ManoeuvreError, match="signed link"):
        rig.ground.send_manoeuvre(1, short_manoeuvre())
    rig.close()


def test_an_aircraft_out_of_reach_is_given_up(tmp_path: Path) -> None:
    rig = keyed(tmp_path)
    at_rest(rig)
    rig.up = lambda data: b""
    rig.ground.send_manoeuvre(1, short_manoeuvre())
    at_rest(rig, 25.0)
    assert told(rig) == ["given up: no answer"]
    rig.close()


@given(
    st.lists(
        st.fixed_dictionaries(
            {
                "checksum": st.integers(0, 3),
                "fragment": st.integers(0, 255),
                "fragments": st.integers(0, 255),
                "length": st.integers(0, 255),
                "data": st.binary(min_size=190, max_size=190),
            }
        ),
        max_size=30,
    )
)
def test_any_fragments_are_answered_and_hold_little(shower: list[dict[str, object]]) -> None:
    said: list[str] = []
    inbox, logger = ManoeuvreInbox(lambda severity, text: said.append(text)), FakeLogger()
    logger.check_manoeuvre = Deck().check_manoeuvre
    for fields in shower:
        inbox.receive(fields, logger)
        inbox.service(logger)
        assert len(inbox._fragments) <= wire.MOST_FRAGMENTS
    inbox.close()


def test_only_with_the_switch_at_off_another_manoeuvre_is_taken_and_then_flown() -> None:
    rig = SequencerRig(switch_plan((0.0, OFF), (0.5, ARM), (2.0, OFF), (2.5, ARM), (3.5, GO)))
    other = plan_of(short_manoeuvre(peak_deg=3.0), CONFIG)
    before = rig.plan
    taken: dict[tuple[State, str], float] = {}

    def each() -> None:
        if rig.now < 2_300_000_000:
            why = rig.actuation.sequencer.load_plan(other)
            taken.setdefault((rig.state, why), rig.now * 1e-9)
            if not why:
                rig.actuation.sequencer.plan = before if rig.now < 2_100_000_000 else other

    rig.run(6.0, each)
    refused = {state for state, why in taken if why}
    assert State.ARMED in refused
    assert State.CHECKING in refused
    assert all(state in (State.IDLE, State.RELEASED) for state, why in taken if not why)
    peak = max(abs(f.increments[1]) for f in rig.book.frames if f.state == State.RUNNING)
    assert peak == pytest.approx(math.radians(3.0), rel=0.02)
