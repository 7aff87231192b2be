"""Whatever a sender says of itself, in whatever message, the ground station goes on, and says by name what it does not use."""

import json
import re
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from daq.contract.channels import CHANNELS, GROUP_NAMES
from daq.contract.recordings.reading import read_recording
from daq.transport.mavlink_codec import FrameEncoder, message_types
from daq.transport.ports import memory_pair
from groundstation.calibration.facts import reported
from groundstation.live.aircraft_monitor import MonitorView
from groundstation.live.config import GroundConfig
from groundstation.live.handover import hand_over
from groundstation.live.station import Station
from groundstation.receiver import events as ev
from groundstation.receiver.ports import LinkConfig
from groundstation.receiver.receive import Receiver
from groundstation.receiver.timeline import NS
from sideslip.live_aircraft import live_aircraft
from tests.support.link_rig import Rig, quiet_scan
from tests.unit.groundstation.test_hostile_papers import Impostor, altered

NUMBER_FACTS = (
    "imu.gyro_scale_rad_s", "imu.accel_scale_m_s2", "mag.scale_t", "capture.scale_s", "imu.accel_delay_s", "imu.gyro_delay_s",
    "pitot.zero_count", *(f"{g}.filter_delay_s" for g in GROUP_NAMES), *(f"{c.group}.{c.name}_after_s" for c in CHANNELS),
    *(f"{g}.scale_v" for g in GROUP_NAMES if g.startswith("analog")),
)  # fmt: skip
BAD = ("nan", "inf", "-inf", "1e999", "-1e300", "many", "", "\x1b[2J", "9" * 4000, "\u202e1", "0x10")


class Sky:
    """A running ground station with one sound aircraft, and a sender that says what the test wants."""

    def __init__(self, folder: Path, make_view: Callable[[int], MonitorView | None] | None = None) -> None:
        folder.mkdir(exist_ok=True)
        self.rig = Rig(None, ground=LinkConfig(ports=("memory",), transmit=False))
        self.ours, self.theirs = memory_pair()
        self.receiver = Receiver(
            LinkConfig(ports=("m",), backfill="all"), {"m": self.ours}, self.rig.clock, folder=folder
        )
        self.lines: list[str] = []
        self.station = Station(
            GroundConfig(), self.receiver, self.rig.clock, folder,
            make_view=make_view, echo=self.lines.append, aircraft=live_aircraft,
        )  # fmt: skip
        self.rng = np.random.default_rng(71)
        self.number = self.heard = 0
        self.last_sent = b""

    def fly(self, scans: int, impostor: Impostor | None = None) -> None:
        for _ in range(scans):
            self.rig.clock.advance(NS // 20)
            now = self.rig.clock.monotonic_ns()
            self.rig.link.offer(quiet_scan(self.number, self.rng, time_ns=now))
            self.rig.link.service(now)
            self.last_sent = self.rig._air.read(1 << 20)
            self.theirs.write(self.last_sent)
            self.number += 1
            self.heard += sum(isinstance(e, ev.ScanReceived) for e in self.station.step())
            if impostor is not None:
                impostor.reply(self.theirs)

    def land(self) -> None:
        self.station.close()
        self.rig.close()


@pytest.mark.parametrize("value", BAD)
def test_no_fact_of_a_sender_ends_the_session_and_each_refused_one_is_named_once(tmp_path: Path, value: str) -> None:
    sky = Sky(tmp_path)
    details = dict.fromkeys(NUMBER_FACTS, value) | {"static.nvm": "zz"}
    sky.fly(100, Impostor(tmp_path, zlib.compress(altered(details=details), 9), sky.rig))
    sky.land()
    assert sky.heard >= 45
    named = {str(row["what"]) for row in sky.receiver.summary()["quarantined"]}
    assert named == {f"fact {name}" for name in details}
    for name in details:
        assert sum(f"fact {name} not used" in line for line in sky.lines) == 1
    (path,) = tmp_path.glob("*.mcap")
    assert len(read_recording(path).numbers) == sky.heard


def test_the_flight_is_handed_over_with_a_note_for_each_fact_that_cannot_be(tmp_path: Path) -> None:
    sky = Sky(tmp_path)
    details = {"imu.gyro_scale_rad_s": "nan", "analog_a.alpha_vane_after_s": "inf"}
    said = altered(details=details, events=[[5, 6, 1, "logger", "pitot_zero count=999999.5 scans=3"]])
    sky.fly(80, Impostor(tmp_path, zlib.compress(said, 9), sky.rig))
    sky.land()
    (path,) = tmp_path.glob("*.mcap")
    notes = " ".join(note.text for note in hand_over(path, tmp_path, origin="a test").flight.notes)
    assert all(f"fact {name} = " in notes for name in (*details, "pitot.zero_count"))


def test_sound_facts_pass_as_they_are() -> None:
    sound = {"imu.gyro_scale_rad_s": "0.0011", "pitot.zero_count": "8192.5", "imu.range": "±500 °/s", "static.nvm": ""}
    assert reported(sound).facts == sound
    assert reported(sound).refused == {}


EDGES = {"b": 8, "B": 8, "h": 16, "H": 16, "i": 32, "I": 32, "q": 64, "Q": 64}


def _value(code: str, draw: st.DrawFn) -> Any:
    if code in "fd":
        return draw(st.sampled_from([float("nan"), float("inf"), -float("inf"), 3e38, -1.0, 0.0]))
    bits = EDGES[code]
    low, high = (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if code.islower() else (0, 2**bits - 1)
    return draw(st.sampled_from([low, high, 0, 1, high // 2]) | st.integers(low, high))


@st.composite
def hostile_frames(draw: st.DrawFn) -> list[bytes]:
    """Frames of aircraft 1 of any message, each field with an edge of its type; some cut, so that zeros are missing."""
    encoder, out = FrameEncoder(1, draw(st.sampled_from([1, 2, 190]))), []
    for made in draw(st.lists(st.sampled_from(sorted(message_types().values(), key=lambda m: m.msg_id)), max_size=12)):
        payload = draw(st.binary(min_size=made.codec.size, max_size=made.codec.size)) if draw(st.booleans()) else b""
        if not payload:
            runs = re.findall(r"(\d*)([a-zA-Z])", made.codec.format)
            codes = [code for count, code in runs if code != "s" for _ in range(int(count or 1))]
            values = iter(codes)
            fields: dict[str, Any] = {}
            for name, count, text in zip(made.fields, made.counts, made.text, strict=True):
                if text:
                    fields[name] = draw(st.sampled_from(["\x1b[31m", "\u202e", "nan", "", "\x00", "\r\n"]))
                else:
                    fields[name] = [_value(next(values), draw) for _ in range(count)]
                    fields[name] = fields[name] if count > 1 else fields[name][0]
            try:
                payload = made.pack(fields)
            except ValueError:
                payload = bytes(made.codec.size)
        out.append(encoder.frame(made.msg_id, payload))
    return out


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(frames=hostile_frames())
def test_no_message_of_a_sender_fails_within_a_running_ground_station(
    tmp_path_factory: pytest.TempPathFactory, frames: list[bytes]
) -> None:
    sky = Sky(tmp_path_factory.mktemp("sky"))
    sky.fly(5)
    for frame in frames:
        sky.theirs.write(frame)
        sky.fly(1)
    before = sky.heard
    sky.fly(40)
    sky.land()
    assert sky.heard > before
    assert (
        sky.receiver.summary()["quarantined"] == []
    )  # refused by a check of its type, not by the last line of defence
    json.dumps(sky.receiver.summary())


def test_what_fails_in_our_own_work_on_a_scan_is_named_and_the_next_scan_is_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sky = Sky(tmp_path)
    sky.fly(10)

    def broken(*_: Any, **__: Any) -> bool:
        raise ZeroDivisionError("float division by zero")

    monkeypatch.setattr(sky.station.monitor(1), "scan", broken)
    sky.fly(30)
    sky.land()
    assert sky.heard >= 15
    assert [r["what"] for r in sky.receiver.summary()["quarantined"]] == ["a ScanReceived"]
    (path,) = tmp_path.glob("*.mcap")
    assert len(read_recording(path).numbers) == sky.heard
