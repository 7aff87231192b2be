"""The clocks: a simulated one jumps for its driver, waits for others, and paces if asked to."""

import threading
import time

from daq.clock import NS, RealClock, SimulatedClock


def test_simulated_time_moves_only_with_its_driver() -> None:
    clock = SimulatedClock(start_utc_ns=1000 * NS)
    seen: list[int] = []
    clock.on_advance(seen.append)
    clock.sleep_until(5 * NS)
    clock.sleep_until(4 * NS)
    clock.advance(NS)
    assert clock.monotonic_ns() == 6 * NS
    assert clock.utc_ns() == 1006 * NS
    assert seen == [5 * NS, 6 * NS]


def test_a_step_of_utc_leaves_monotonic_time_alone() -> None:
    clock = SimulatedClock(start_utc_ns=1000 * NS)
    clock.advance(NS)
    clock.step_utc(-3600 * NS)
    assert clock.monotonic_ns() == NS
    assert clock.utc_ns() == (1001 - 3600) * NS


def test_another_thread_sleeps_simulated_time() -> None:
    clock = SimulatedClock()
    woke: list[int] = []

    def sleeper() -> None:
        clock.sleep_until(3 * NS)
        woke.append(clock.monotonic_ns())

    thread = threading.Thread(target=sleeper)
    thread.start()
    for _ in range(400):
        clock.advance(NS // 100)
        time.sleep(0)
    thread.join()
    assert woke
    assert woke[0] >= 3 * NS


def test_time_waits_for_a_busy_follower() -> None:
    clock = SimulatedClock()
    work: list[int] = []
    gate = threading.Event()

    def worker() -> None:
        gate.wait()
        work.clear()

    clock.follow(lambda: bool(work))
    work.append(1)
    thread = threading.Thread(target=worker)
    thread.start()
    release = threading.Timer(0.02, gate.set)
    release.start()
    clock.advance(NS)
    assert not work
    thread.join()
    release.join()


def test_speed_paces_against_real_time() -> None:
    clock = SimulatedClock(speed=100.0)
    before = time.monotonic()
    clock.sleep_until(5 * NS)
    assert time.monotonic() - before >= 0.049


def test_real_clock_sleeps_until_a_deadline_and_not_for_a_past_one() -> None:
    clock = RealClock()
    deadline = clock.monotonic_ns() + 5_000_000
    clock.sleep_until(deadline)
    assert clock.monotonic_ns() >= deadline
    clock.sleep_until(deadline - NS)
    assert abs(clock.utc_ns() - time.time_ns()) < NS
