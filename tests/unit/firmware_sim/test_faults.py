"""Faults: each line does what it says, where it says, when it says, and nothing else."""

import errno
from pathlib import Path

import numpy as np
import pytest

from firmware_sim.hardware.board import ADDRESSES
from firmware_sim.hardware.card import SimulatedCard
from firmware_sim.hardware.faults import FaultEvents, FaultSet, parse_faults
from firmware_sim.tables import ScenarioError
from tests.unit.firmware_sim.hardware import CountingClock, steady

SECOND = 1_000_000_000


def faults(*lines: dict[str, object], seed: int = 1) -> FaultSet:
    return FaultSet(parse_faults(lines, "test"), 0, seed)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ({"kind": "broken"}, r"faults\.1\.kind"),
        ({"kind": "absent"}, "needs a device"),
        ({"kind": "absent", "device": "radar"}, "radar"),
        ({"kind": "spikes", "device": "pitot"}, "needs a size"),
        ({"kind": "stuck_bus", "start_s": 5.0, "stop_s": 4.0}, "after"),
        ({"kind": "stuck_bus", "begin": 5.0}, "begin"),
        ({"kind": "nack", "device": "imu", "probability": 1.5}, r"faults\.1\.probability"),
    ],
)
def test_mistakes_are_named(line: dict[str, object], words: str) -> None:
    with pytest.raises(ScenarioError, match=words):
        parse_faults([line], "test")


def test_refusals_within_their_window_only() -> None:
    set_ = faults({"kind": "nack", "device": "pitot", "start_s": 2.0, "stop_s": 3.0})
    for time_s, refused in ((1.9, False), (2.0, True), (2.9, True), (3.0, False)):
        found = set_.disturb(ADDRESSES["pitot"], round(time_s * SECOND))
        assert (found is not None and found.refused) is refused
    assert set_.disturb(ADDRESSES["imu"], round(2.5 * SECOND)) is None


def test_nack_bursts_hit_their_share() -> None:
    set_ = faults({"kind": "nack", "device": "imu", "probability": 0.3})
    hits = sum(set_.disturb(ADDRESSES["imu"], k) is not None for k in range(5000))
    assert hits == pytest.approx(1500, abs=130)


def test_stuck_and_slow_bus_concern_everybody() -> None:
    set_ = faults({"kind": "stuck_bus", "stop_s": 1.0}, {"kind": "slow_bus", "start_s": 2.0, "size": 10.0})
    for address in ADDRESSES.values():
        held = set_.disturb(address, 0)
        slow = set_.disturb(address, 3 * SECOND)
        assert held is not None
        assert held.held
        assert slow is not None
        assert slow.stretch == 10.0
        assert set_.disturb(address, round(1.5 * SECOND)) is None


def test_stuck_value_holds_what_it_first_saw() -> None:
    set_ = faults({"kind": "stuck_value", "device": "static", "start_s": 1.0, "stop_s": 2.0})
    bent = set_.bend("static", lambda time_ns: np.array([time_ns / SECOND, 0.0]))
    assert [float(bent(round(t * SECOND))[0]) for t in (0.5, 1.0, 1.5, 2.0)] == [0.5, 1.0, 1.0, 2.0]
    assert set_.quiet("static", round(1.5 * SECOND))
    assert not set_.quiet("static", round(2.5 * SECOND))


def test_spikes_have_their_size_and_share() -> None:
    set_ = faults({"kind": "spikes", "device": "pitot", "probability": 0.1, "size": 50.0})
    bent = set_.bend("pitot", steady(10.0, 300.0))
    off = np.array([bent(k)[0] - 10.0 for k in range(3000)])
    assert set(np.abs(off)) == {0.0, 50.0}
    assert np.count_nonzero(off) == pytest.approx(300, abs=60)


def test_inputs_without_faults_are_left_alone() -> None:
    inputs = steady(1.0)
    assert faults({"kind": "stuck_value", "device": "mag"}).bend("pitot", inputs) is inputs


def test_torn_gps_messages_are_shorter() -> None:
    set_ = faults({"kind": "torn_gnss", "probability": 0.5, "start_s": 1.0})
    message = bytes(range(100))
    assert set_.gnss_corrupt(message, 0) == message
    torn = [set_.gnss_corrupt(message, 2 * SECOND) for _ in range(400)]
    assert sum(t != message for t in torn) == pytest.approx(200, abs=50)
    assert all(len(t) < 100 for t in torn if t != message)


class Lamp:
    def __init__(self) -> None:
        self.switched: list[tuple[bool, int]] = []

    def set_power(self, on: bool, now_ns: int) -> None:
        self.switched.append((on, now_ns))


def test_a_dip_shorter_than_a_step_of_the_clock_still_happens() -> None:
    lamp, steps = Lamp(), []
    set_ = faults(
        {"kind": "power_dip", "start_s": 1.0, "stop_s": 1.001}, {"kind": "clock_step", "start_s": 2.0, "size": -3.5}
    )
    events = FaultEvents(set_, {"lamp": lamp}, steps.append)
    events.at(round(0.9 * SECOND))
    assert lamp.switched == []
    events.at(round(1.5 * SECOND))
    assert lamp.switched == [(False, SECOND), (True, round(1.001 * SECOND))]
    events.at(round(2.5 * SECOND))
    assert steps == [-round(3.5 * SECOND)]
    assert not events.any_left


def test_an_unplugged_imu_takes_its_magnetometer_along() -> None:
    imu, mag, pitot = Lamp(), Lamp(), Lamp()
    events = FaultEvents(
        faults({"kind": "absent", "device": "imu", "start_s": 1.0, "stop_s": 2.0}),
        {"imu": imu, "mag": mag, "pitot": pitot},
        lambda by_ns: None,
    )
    events.at(3 * SECOND)
    assert imu.switched == mag.switched == [(False, SECOND), (True, 2 * SECOND)]
    assert pitot.switched == []


def card(tmp_path: Path, clock: CountingClock, *lines: dict[str, object]) -> SimulatedCard:
    return SimulatedCard(faults(*lines), clock)


def test_stall_lasts_simulated_time_and_loses_nothing(tmp_path: Path) -> None:
    clock = CountingClock()
    storage = card(tmp_path, clock, {"kind": "sd_stall", "start_s": 1.0, "stop_s": 31.0})
    file = storage.create(tmp_path / "a.mcap")
    file.write(b"before")
    clock.now_ns = 5 * SECOND
    file.write(b"-after")
    assert clock.now_ns == 31 * SECOND
    file.close()
    assert (tmp_path / "a.mcap").read_bytes() == b"before-after"


def test_full_card_takes_part_and_then_refuses(tmp_path: Path) -> None:
    clock = CountingClock()
    storage = card(tmp_path, clock, {"kind": "disk_full", "start_s": 1.0, "stop_s": 2.0})
    file = storage.create(tmp_path / "a.mcap")
    assert storage.free_bytes(tmp_path) > 0
    clock.now_ns = round(1.5 * SECOND)
    assert storage.free_bytes(tmp_path) == 0
    with pytest.raises(OSError, match="No space") as caught:
        file.write(b"0123456789")
    assert caught.value.errno == errno.ENOSPC
    clock.now_ns = 3 * SECOND
    file.write(b"again")
    file.close()
    assert (tmp_path / "a.mcap").read_bytes() == b"01234again"


def test_card_gone_fails_everything(tmp_path: Path) -> None:
    clock = CountingClock()
    storage = card(tmp_path, clock, {"kind": "card_gone", "start_s": 1.0})
    file = storage.create(tmp_path / "a.mcap")
    clock.now_ns = 2 * SECOND
    for act in (lambda: file.write(b"x"), file.sync, lambda: storage.create(tmp_path / "b.mcap")):
        with pytest.raises(OSError, match="Input/output"):
            act()
    file.close()


def test_slow_card(tmp_path: Path) -> None:
    clock = CountingClock()
    storage = card(tmp_path, clock, {"kind": "sd_slow", "size": 0.2})
    file = storage.create(tmp_path / "a.mcap")
    before = clock.now_ns
    file.write(b"x")
    assert clock.now_ns - before == round(0.2 * SECOND)
    file.close()
