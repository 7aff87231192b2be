"""Commands: acknowledged, idempotent, refused when unsafe, and nothing at all without a good signature."""

from pathlib import Path

import numpy as np
import pytest

from daq.contract.link import commands as c
from daq.contract.recordings.messages import SequencerFrame
from daq.telemetry.config import DownlinkConfig
from daq.transport.mavlink_codec import FrameEncoder
from daq.transport.signing import Signer
from groundstation.receiver import events as ev
from groundstation.receiver.ports import LinkConfig
from tests.support.link_rig import Rig, quiet_scan

KEY = bytes(range(32))
WIDE = 20_000.0


def at_rest(rig: Rig, seconds: float = 3.0, speed_mm_s: int = 0) -> None:
    rng = np.random.default_rng(11)
    make = lambda n: quiet_scan(n, rng, time_ns=rig.clock.monotonic_ns(), speed_mm_s=speed_mm_s)  # noqa: E731
    rig.fly(round(seconds * 20), make)


def results(rig: Rig) -> list[tuple[int, str]]:
    return [(e.command, e.words) for e in rig.events if isinstance(e, ev.CommandResult)]


@pytest.fixture
def rig() -> Rig:
    made = Rig(None)
    at_rest(made)
    return made


def test_start_stop_mark_and_rate(rig: Rig) -> None:
    commander = rig.ground.commander
    commander.stop_recording(1)
    commander.start_recording(1)
    commander.mark(1)
    commander.mark(1)
    commander.set_rate(1, 5.0)
    at_rest(rig)
    assert results(rig).count((c.EVENT_MARK, "accepted")) == 2
    assert {(c.LOGGING_STOP, "accepted"), (c.LOGGING_START, "accepted")} <= set(results(rig))
    assert rig.logger.marks == [("mark 1", "ground"), ("mark 2", "ground")]
    assert rig.link.downlink.rate_hz == 5.0
    rig.close()


def test_lost_acknowledgements_do_not_repeat_the_action() -> None:
    silent = {"on": False}
    rig = Rig(None, down=lambda data: b"" if silent["on"] else data)
    at_rest(rig)
    rig.ground.commander.mark(1)
    rig.ground.commander.stop_recording(1)
    silent["on"] = True
    at_rest(rig, 3.5)
    silent["on"] = False
    at_rest(rig, 3.0)
    assert rig.logger.marks == [("mark 1", "ground")]
    assert rig.logger.stops == 1
    assert sorted(results(rig)) == sorted([(c.EVENT_MARK, "accepted"), (c.LOGGING_STOP, "accepted")])
    rig.close()


def test_no_answer_is_said() -> None:
    deaf = Rig(None, up=lambda data: b"")
    at_rest(deaf)
    deaf.ground.commander.stop_recording(1)
    at_rest(deaf, 7.0)
    assert results(deaf) == [(c.LOGGING_STOP, "no answer")]
    assert deaf.logger.stops == 0
    deaf.close()


def test_pitot_is_zeroed_at_rest_only(rig: Rig) -> None:
    rig.ground.commander.zero_pitot(1)
    at_rest(rig)
    assert results(rig) == [(c.PREFLIGHT_CALIBRATION, "accepted")]
    (text, origin), *_ = rig.logger.marks
    zero = c.parse_pitot_zero(text)
    assert zero is not None
    assert zero == pytest.approx(8192, abs=1.5)
    assert origin == "ground"
    at_rest(rig, speed_mm_s=17_000)
    rig.ground.commander.zero_pitot(1)
    at_rest(rig, speed_mm_s=17_000)
    assert results(rig)[-1] == (c.PREFLIGHT_CALIBRATION, "temporarily rejected")
    assert len(rig.logger.marks) == 1
    texts = [e.text for e in rig.events if isinstance(e, ev.StatusText)]
    assert "pitot not zeroed: GPS ground speed 17.0 m/s" in texts
    rig.close()


def test_rate_beyond_the_budget_is_denied(rig: Rig) -> None:
    rig.ground.commander.set_rate(1, 1.0)
    at_rest(rig)
    assert results(rig) == [(c.SET_MESSAGE_INTERVAL, "denied")]
    assert rig.link.downlink.rate_hz == 11.5
    rig.close()


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1e30, 3.5])
def test_odd_parameters_do_no_harm(rig: Rig, value: float) -> None:
    encoder = FrameEncoder(255, 190)
    for command in (c.SET_MESSAGE_INTERVAL, c.PREFLIGHT_CALIBRATION, c.EVENT_MARK, 9999):
        fields = {f"param{i}": value for i in range(1, 8)}
        rig._air.write(encoder.message("COMMAND_LONG", command=command, **fields))
    at_rest(rig)
    assert rig.link.downlink.rate_hz == 11.5
    rig.close()


def test_commands_for_another_aircraft_are_not_obeyed(rig: Rig) -> None:
    rig._air.write(FrameEncoder(255, 190).message("COMMAND_LONG", command=c.LOGGING_STOP, target_system=9))
    at_rest(rig)
    assert rig.logger.stops == 0
    rig.close()


def keyed(tmp_path: Path) -> Rig:
    key = tmp_path / "key"
    key.write_bytes(KEY)
    key.chmod(0o600)
    aircraft = DownlinkConfig(budget_bytes_per_s=WIDE, key_file=key)
    return Rig(None, aircraft=aircraft, ground=LinkConfig(ports=("memory",), key_file=key))


def test_with_a_key_unsigned_and_badly_signed_commands_do_nothing_and_are_reported(tmp_path: Path) -> None:
    rig = keyed(tmp_path)
    at_rest(rig)
    wrong = Signer(bytes(32), rig.clock.utc_ns)
    for encoder in (FrameEncoder(255, 190), FrameEncoder(254, 190, wrong)):
        rig._air.write(encoder.message("COMMAND_LONG", command=c.LOGGING_STOP, target_system=1))
        at_rest(rig, 6.0)
    assert rig.logger.stops == 0
    texts = [e.text for e in rig.events if isinstance(e, ev.StatusText)]
    assert "refused COMMAND_LONG from 255/190: unsigned" in texts
    assert "refused COMMAND_LONG from 254/190: badly signed" in texts
    rig.ground.commander.stop_recording(1)
    at_rest(rig)
    assert rig.logger.stops == 1
    assert rig.link.downlink.rejected_frames == 2
    rig.close()


def test_refusals_that_come_close_together_are_all_told_of(tmp_path: Path) -> None:
    rig = keyed(tmp_path)
    at_rest(rig)
    for _ in range(4):
        rig._air.write(FrameEncoder(255, 190).message("COMMAND_LONG", command=c.LOGGING_STOP, target_system=1))
        at_rest(rig, 0.1)
    at_rest(rig, 8.0)
    texts = [e.text for e in rig.events if isinstance(e, ev.StatusText)]
    first = "refused COMMAND_LONG from 255/190: unsigned"
    assert texts == [first, f"{first} (and 2 more)"]
    rig.close()


def test_radio_status_is_heard_unsigned_but_only_within_limits(tmp_path: Path) -> None:
    rig = keyed(tmp_path)
    at_rest(rig)
    for _ in range(8):
        rig._air.write(FrameEncoder(51, 68).message("RADIO_STATUS", txbuf=0))
        at_rest(rig, 1.0)
    assert rig.link.downlink.rate_hz == 2.0
    before = sum(isinstance(e, ev.Heartbeat) for e in rig.events)
    at_rest(rig, 5.0)
    assert sum(isinstance(e, ev.Heartbeat) for e in rig.events) - before == 5
    rig.close()


DIGEST = "abcdef0123456789"


def test_only_a_proven_frame_starts_the_sequencer(tmp_path: Path) -> None:
    rig = keyed(tmp_path)
    at_rest(rig)
    rig.ground.commander.start_manoeuvre(1, DIGEST)
    at_rest(rig)
    assert rig.logger.asked == [0xABCDEF]
    assert (c.SEQUENCER, "accepted") in results(rig)
    parameters = {"param1": 1.0, "param2": float(0xABCDEF)}
    command = {"command": c.SEQUENCER, "target_system": 1, **parameters}
    unsigned = FrameEncoder(255, 190)
    wrong = FrameEncoder(255, 190, Signer(bytes(32), rig.clock.utc_ns))
    for encoder in (unsigned, wrong):
        rig._air.write(encoder.message("COMMAND_LONG", **command))
        at_rest(rig, 1.0)
    assert rig.logger.asked == [0xABCDEF]
    rig.close()


def test_without_a_key_the_sequencer_is_never_started_from_the_ground_but_stopped(rig: Rig) -> None:
    rig.ground.commander.start_manoeuvre(1, DIGEST)
    at_rest(rig)
    assert rig.logger.asked == []
    assert (c.SEQUENCER, "denied") in results(rig)
    assert any("no key" in e.text for e in rig.events if isinstance(e, ev.StatusText))
    rig.ground.commander.stop_manoeuvre(1)
    at_rest(rig)
    assert rig.logger.asked == [None]
    rig.close()


def test_a_refusal_of_the_sequencer_is_told_in_words(tmp_path: Path) -> None:
    rig = keyed(tmp_path)
    rig.logger.answer = "the pilot's switch is not at go"
    at_rest(rig)
    rig.ground.commander.start_manoeuvre(1, DIGEST)
    at_rest(rig)
    assert (c.SEQUENCER, "temporarily rejected") in results(rig)
    told = [e.text for e in rig.events if isinstance(e, ev.StatusText)]
    assert "sequencer does not start: the pilot's switch is not at go" in told
    rig.close()


@pytest.mark.parametrize("parameters", [(2.0, 0.0), (float("nan"), 0.0), (1.0, -1.0), (1.0, 2.0**24), (1.0, 1.0, 5.0)])
def test_nonsense_about_the_sequencer_is_unsupported(tmp_path: Path, parameters: tuple[float, ...]) -> None:
    rig = keyed(tmp_path)
    at_rest(rig)
    rig.ground.commander._send(1, c.SEQUENCER, *parameters)
    at_rest(rig)
    assert rig.logger.asked == []
    assert (c.SEQUENCER, "unsupported") in results(rig)
    rig.close()


def test_what_the_sequencer_does_reaches_the_ground(rig: Rig) -> None:
    frame = SequencerFrame(
        5_000_000, 0, 3, 3, 0, 3, elapsed_us=1_234_567, beating=True, increments=(0.0, -0.05, 0.0212)
    )
    rig.link.sequencer(frame)
    at_rest(rig, 1.0)
    found = [e for e in rig.events if isinstance(e, ev.SequencerStatus)]
    assert [(e.state, e.reason, e.switch, e.number, e.beating, e.limited) for e in found] == [(3, 0, 3, 3, True, False)]
    assert found[0].elapsed_s == pytest.approx(1.234)
    assert found[0].increments == pytest.approx((0.0, -0.05, 0.0212))
    rig.close()


def test_the_silence_of_the_ground_is_known(rig: Rig) -> None:
    """What the sequencer goes by where the link is wanted; a radio's own report is not the ground."""
    before = rig.link.uplink.silence_s(rig.clock.monotonic_ns())
    rig.up = lambda data: b""
    radio = FrameEncoder(51, 68)
    for _ in range(3):
        rig._air.write(
            radio.message("RADIO_STATUS", rssi=100, remrssi=100, txbuf=80, noise=40, remnoise=40, rxerrors=0, fixed=0)
        )
        at_rest(rig, 1.0)
    after = rig.link.uplink.silence_s(rig.clock.monotonic_ns())
    assert before is None or before < 1.5
    assert after is None or after > 2.5
    rig.close()
