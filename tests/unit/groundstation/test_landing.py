"""The end of a flight is recognised once, and not before it."""

import math

from daq.contract.recordings.reading import read_recording
from groundstation.calibration.calibration_set import load_calibration
from groundstation.calibration.facts import reported
from groundstation.calibration.recording import embedded_calibration
from groundstation.live.aircraft_monitor import AircraftMonitor
from groundstation.live.config import GroundConfig
from groundstation.live.watches import LandingLimits, LandingWatch, Phase
from tests.support.paths import RECORDINGS


def run(watch: LandingWatch, start: float, seconds: float, speed: float, rate: float = 0.0) -> int:
    ends = 0
    for i in range(round(seconds * 10)):
        ends += watch.update(start + i * 0.1, {"V": speed, "p": rate, "q": 0.0, "r": 0.0})
    return ends


def test_a_flight_ends_once_and_another_may_follow() -> None:
    watch = LandingWatch(LandingLimits())
    assert run(watch, 0, 30, 0.2) == 0
    assert watch.phase is Phase.BEFORE
    assert run(watch, 30, 60, 17.0) == 0
    assert watch.phase is Phase.FLYING
    assert run(watch, 90, 30, 0.3) == 1
    assert watch.phase is Phase.LANDED
    assert run(watch, 120, 60, 17.0) == 0
    assert run(watch, 180, 30, 0.3) == 1


def test_a_gust_of_pitot_noise_before_take_off_is_not_a_flight() -> None:
    watch = LandingWatch(LandingLimits())
    run(watch, 0, 1.5, 15.0)
    run(watch, 1.5, 60, 0.0)
    assert watch.phase is Phase.BEFORE


def test_slow_but_turning_is_not_landed() -> None:
    watch = LandingWatch(LandingLimits())
    run(watch, 0, 10, 17.0)
    assert run(watch, 10, 30, 3.0, rate=0.5) == 0


def test_lost_pitot_in_flight_does_not_end_it_while_it_moves() -> None:
    watch = LandingWatch(LandingLimits())
    run(watch, 0, 10, 17.0)
    assert run(watch, 10, 30, math.nan, rate=0.5) == 0
    assert watch.phase is Phase.FLYING


def test_nothing_measured_decides_nothing() -> None:
    watch = LandingWatch(LandingLimits())
    run(watch, 0, 10, 17.0)
    assert not any(watch.update(10 + i, {}) for i in range(100))


def test_a_calibration_that_comes_in_flight_ends_neither_the_flight_nor_the_watch_over_its_radio() -> None:
    recording = read_recording(RECORDINGS / "cdfp_ld1_raw.mcap")
    said: list[str] = []
    monitor = AircraftMonitor(
        GroundConfig(), load_calibration("cdfp"), None, lambda time, level, text: said.append(text), utc_ns=lambda: 0
    )
    flown = list(recording.scans())[:120]
    for scan in flown:
        monitor.scan(scan, received_ns=round(scan.time * 1e9))
    assert monitor.phase is Phase.FLYING
    monitor.use_calibration(embedded_calibration(recording), reported(recording.info.details).facts)
    assert monitor.phase is Phase.FLYING
    monitor.silence(round((flown[-1].time + 3.5) * 1e9))
    assert any("no telemetry" in text for text in said)
    monitor.use_calibration(load_calibration("cdfp"), {"pitot.range_pa": "1.0"})
    assert monitor.phase is Phase.FLYING
