"""Repeated values: a coarse step, a slow sensor and a stuck one are told apart by what the motion must have done."""

import numpy as np
import pytest

from groundstation.flight import Flight
from groundstation.flight.quality.repeats import quantum, repeats
from groundstation.flight.quality.report import quality_report

RATE = 25.0
TIME = np.arange(1500) / RATE


def steady_then_moving(noise: float = 1e-3) -> Flight:
    """A minute whose attitude hardly moves for 20 s and then swings; gyros with noise. noise: [rad/s]."""
    rng = np.random.default_rng(4)
    swing = np.where(TIME > 20.0, 0.15 * np.sin(1.2 * (TIME - 20.0)), 0.0)
    theta = 0.08 + 2e-4 * np.sin(0.1 * TIME) + swing
    rate = np.gradient(theta, TIME)
    zero = np.zeros_like(TIME)
    columns = {
        "phi": zero + 0.01 * np.sin(0.3 * TIME),
        "theta": theta,
        "p": 0.003 * np.cos(0.3 * TIME),
        "q": rate,
        "r": zero,
        "V": 120 + np.sin(0.2 * TIME),
        "alpha": 0.05 + 0.3 * swing,
    }
    for name in ("p", "q", "r"):
        columns[name] = columns[name] + noise * rng.standard_normal(TIME.size)
    return Flight.build("steady", TIME, columns)


def rounded(flight: Flight, column: str, step: float) -> Flight:
    return flight.with_columns(**{column: np.round(flight[column] / step) * step})


@pytest.mark.parametrize("step", [9.6e-5, 1.5e-3])
def test_the_quantum_is_read_off_the_data(step: float) -> None:
    flight = rounded(steady_then_moving(), "theta", step)
    assert quantum(flight["theta"]) == pytest.approx(step, rel=1e-6)
    assert repeats(flight, "theta").quantum == pytest.approx(step, rel=1e-6)


@pytest.mark.parametrize("step", [9.6e-5, 5e-4, 1.5e-3])
def test_a_coarse_channel_in_steady_flight_is_neither_stuck_nor_slow(step: float) -> None:
    flight = rounded(steady_then_moving(), "theta", step)
    longest = max(len(run) for run in np.split(flight["theta"], np.flatnonzero(np.diff(flight["theta"])) + 1))
    assert longest > 25, "it repeats for more than a second"
    found = repeats(flight, "theta")
    assert not found.stuck.any()
    assert not found.slow
    stale = next(f for f in quality_report(flight) if f.kind == "stale samples")
    assert "theta" not in stale.text or "coarse" in stale.text


def test_the_same_attitude_stuck_while_the_gyro_turns_is_caught() -> None:
    flight = rounded(steady_then_moving(), "theta", 9.6e-5)
    at = (flight.time > 30.0) & (flight.time < 33.0)
    stuck = flight.with_columns(theta=np.where(at, flight["theta"][750], flight["theta"]))
    found = repeats(stuck, "theta").stuck
    assert found[at][1:].all()
    assert found.sum() <= at.sum() + 2
    stale = next(f for f in quality_report(stuck) if f.kind == "stale samples")
    assert "theta stands still" in stale.text


def test_a_noisy_sensor_stuck_in_steady_flight_is_caught_by_its_missing_noise() -> None:
    flight = steady_then_moving()
    at = (flight.time > 5.0) & (flight.time < 8.0)
    stuck = flight.with_columns(q=np.where(at, flight["q"][125], flight["q"]))
    assert repeats(stuck, "q").stuck[at][1:].all()
    assert not repeats(stuck, "p").stuck.any()


def test_one_device_stuck_is_caught_though_its_channels_agree() -> None:
    flight = steady_then_moving()
    at = (flight.time > 30.0) & (flight.time < 33.0)
    stuck = flight.with_columns(**{c: np.where(at, flight[c][750], flight[c]) for c in ("p", "q", "r")})
    for column in ("p", "q", "r"):
        assert repeats(stuck, column).stuck[at][1:].all()


def test_a_record_that_rests_altogether_is_not_stuck() -> None:
    """The first seconds of a simulated record, before anything moves."""
    swing = np.where(TIME > 3.0, np.sin(1.7 * (TIME - 3.0)), 0.0)
    walk = np.where(TIME > 3.0, np.cumsum(np.random.default_rng(2).standard_normal(TIME.size)) * 0.02, 0.0)
    flight = Flight.build("simulated", TIME, {"p": swing, "phi": 0.3 * swing, "ay": walk, "beta": 0.1 * swing})
    for column in flight.columns:
        assert not repeats(flight, column).stuck.any()
    assert repeats(flight, "ay").at_rest[:70].all()


@pytest.mark.parametrize("hold", [2, 4, 5])
@pytest.mark.parametrize("noise", [0.0, 0.005])
def test_a_slow_sensor_is_told_with_its_rate(hold: int, noise: float) -> None:
    flight = steady_then_moving()
    rng = np.random.default_rng(3)
    beta = 0.1 * np.sin(1.5 * TIME) + noise * rng.standard_normal(TIME.size)
    slow = flight.with_columns(beta=beta[(np.arange(TIME.size) // hold) * hold])
    found = repeats(slow, "beta")
    assert found.slow
    assert found.rate == pytest.approx(RATE / hold, rel=0.05)
    assert found.held.sum() == pytest.approx(TIME.size * (1 - 1 / hold), rel=0.02)
    assert not repeats(flight.with_columns(beta=beta), "beta").slow


def test_commanded_steps_are_no_slow_sensor() -> None:
    edges = np.array([2.0, 2.8, 3.6, 10.0, 11.2, 12.0, 12.4, 20.0, 20.6, 25.0, 25.5, 26.0])
    command = 0.1 * np.sin(np.searchsorted(edges, TIME) * 2.1)
    flight = steady_then_moving().with_columns(delta_a=command)
    assert not repeats(flight, "delta_a").slow
    assert not repeats(flight, "delta_a").stuck.any()


@pytest.mark.parametrize("change", ["stuck", "slow", "coarse"])
def test_dither_far_below_the_quantum_changes_nothing(change: str) -> None:
    flight = rounded(steady_then_moving(), "theta", 9.6e-5)
    if change == "stuck":
        at = (flight.time > 30.0) & (flight.time < 33.0)
        flight = flight.with_columns(theta=np.where(at, flight["theta"][750], flight["theta"]))
    if change == "slow":
        flight = flight.with_columns(theta=flight["theta"][(np.arange(TIME.size) // 5) * 5])
    dither = 1e-11 * np.random.default_rng(1).standard_normal(TIME.size) * np.ptp(flight["theta"])
    plain, dithered = (repeats(f, "theta") for f in (flight, flight.with_columns(theta=flight["theta"] + dither)))
    assert np.array_equal(plain.stuck, dithered.stuck)
    assert np.array_equal(plain.held, dithered.held)


def test_a_resting_control_is_not_clipped_and_a_stopped_one_is() -> None:
    rest = np.where((TIME > 10) & (TIME < 11), 0.1, 0.0)
    flight = steady_then_moving().with_columns(delta_e=rest, delta_a=np.minimum(0.2 * np.sin(TIME), 0.15))
    clipping = next(f for f in quality_report(flight) if f.kind == "clipping")
    assert clipping.severity == "ok", clipping.text
    asked = flight.with_columns(cmd_a=0.2 * np.sin(TIME), cmd_e=rest)
    clipping = next(f for f in quality_report(asked) if f.kind == "clipping")
    assert "delta_a stays at its largest value" in clipping.text
    assert "delta_e" not in clipping.text


def test_the_flat_top_of_a_coarse_channel_is_not_clipped() -> None:
    swing = rounded(steady_then_moving().with_columns(beta=0.02 * np.sin(0.5 * TIME)), "beta", 2e-3)
    assert next(f for f in quality_report(swing) if f.kind == "clipping").severity == "ok"
    cut = swing.with_columns(beta=np.clip(0.2 * np.sin(2.0 * TIME), -0.1, 0.1))
    assert "beta stays at its largest value" in next(f for f in quality_report(cut) if f.kind == "clipping").text


@pytest.mark.parametrize("share", [0.58, 0.62, 0.66])
def test_a_control_mixed_of_two_servo_outputs_is_neither_slow_nor_stuck(share: float) -> None:
    """Elevons in whole microseconds of two sizes: their difference has hardly a quantum, its moves of one microsecond at any time
    looked like new values of a sensor of 25 Hz, and its rest like noise that stops."""
    rng = np.random.default_rng(8)
    moves = rng.random(1500) < share
    moves[700:775] = False
    left, right = (np.cumsum(moves * rng.choice([-1, 1], 1500)) for _ in range(2))
    aileron = 0.5 * (4.99e-4 * left - 5.06e-4 * right)
    flight = Flight.build("f", np.arange(1500) / 50.0, {"delta_a": aileron, "p": rng.standard_normal(1500)})
    found = repeats(flight, "delta_a")
    assert not found.slow
    assert not found.stuck.any()


@pytest.mark.parametrize(("noise", "stuck"), [(0.0, False), (1e-3, True)])
def test_a_rudder_recorded_without_noise_may_rest_between_pulses(noise: float, stuck: bool) -> None:
    """As a simulation records it: a servo of 35 ms settles to the last bit, and none of its changes is as large as another."""
    flight, arm, arms = steady_then_moving(), 0.0, []
    pulse = 0.05 * (np.floor((TIME % 15.0) / 0.7) == 5) - 0.05 * (np.floor((TIME % 15.0) / 0.7) == 6)
    for wanted in np.repeat(pulse, 40):
        arm += 1e-3 / 0.035 * (wanted - arm)
        arms.append(arm if abs(arm) > 1e-12 else 0.0)
    rudder = np.array(arms)[::40]
    at_rest = rudder == 0.0
    assert at_rest.mean() > 0.5
    rudder = np.where(at_rest, 0.0, rudder + noise * np.random.default_rng(6).standard_normal(TIME.size))
    assert repeats(flight.with_columns(delta_r=rudder), "delta_r").stuck.any() == stuck
