"""The relation of monotonic time and UTC, against simulated clocks whose relation is known."""

import numpy as np
import pytest

from daq.sensors.timebase import TimeBase

NS, MS = 1_000_000_000, 1_000_000
UTC0 = 1_795_000_000 * NS  # true UTC at monotonic zero


def true_utc(monotonic_ns: int, ppm: float = 0.0) -> int:
    return UTC0 + monotonic_ns + round(monotonic_ns * ppm * 1e-6)


def arrivals(base: TimeBase, seconds: float, rng: np.random.Generator, ppm: float = 0.0, start: int = 0) -> int:
    """Ten fixes a second, each seen at the next 50 ms poll after 60 to 75 ms; returns the last poll's time."""
    poll = start
    for k in range(int(seconds * 10)):
        sent = start + k * 100 * MS + 13 * MS
        arrived = sent + 60 * MS + int(rng.integers(15 * MS))
        poll = -(-arrived // (50 * MS)) * 50 * MS + int(rng.integers(MS))
        base.observe_fix(poll, true_utc(sent, ppm), 30)
    return poll


def test_unknown_before_the_first_fix() -> None:
    base = TimeBase(60 * MS, 50 * MS)
    assert base.utc(5 * NS) == (0, 0)
    assert base.monotonic_ns(UTC0) is None
    base.observe_pulse(3 * NS)  # an edge alone does not say which second it is
    assert base.utc(5 * NS) == (0, 0)


def test_arrivals_alone_give_utc_within_the_stated_accuracy(rng: np.random.Generator) -> None:
    base = TimeBase(60 * MS, 50 * MS)
    now = arrivals(base, 60, rng)
    utc, accuracy = base.utc(now)
    assert abs(utc - true_utc(now)) < 3 * accuracy
    assert 10 * MS < accuracy < 30 * MS


def test_pulses_bring_microseconds_and_the_drift(rng: np.random.Generator) -> None:
    base = TimeBase(60 * MS, 50 * MS)
    ppm = 18.0
    arrivals(base, 5, rng, ppm)
    for second in range(6, 66):
        edge = round(second * NS / (1 + ppm * 1e-6))  # monotonic time of a whole UTC second
        base.observe_pulse(edge + int(rng.normal(0, 2000)))
    now = 66 * NS
    relation = base.relation(now)
    assert relation is not None
    assert relation.source == "pps"
    assert relation.drift == pytest.approx(ppm * 1e-6, abs=0.2e-6)
    utc, accuracy = base.utc(now)
    assert abs(utc - true_utc(now, ppm)) < 10_000
    assert accuracy < 20_000


def test_lost_pulses_fall_back_to_arrivals(rng: np.random.Generator) -> None:
    base = TimeBase(60 * MS, 50 * MS)
    arrivals(base, 3, rng)
    base.observe_pulse(4 * NS)
    assert base.relation(5 * NS).source == "pps"  # type: ignore[union-attr]
    assert base.relation(20 * NS).source == "fix"  # type: ignore[union-attr]


def test_one_wrong_fix_changes_nothing_but_a_lasting_step_does(rng: np.random.Generator) -> None:
    base = TimeBase(60 * MS, 50 * MS)
    now = arrivals(base, 10, rng)
    before, _ = base.utc(now)
    base.observe_fix(now, true_utc(now) + 3600 * NS, 30)
    assert base.utc(now)[0] == before
    for k in range(10):  # the receiver has learnt the leap second: one second less from now on
        at = now + k * 100 * MS
        base.observe_fix(at, true_utc(at) - NS - 80 * MS, 30)
    later = now + NS
    assert abs(base.utc(later)[0] - (true_utc(later) - NS)) < 60 * MS


def test_inverse(rng: np.random.Generator) -> None:
    base = TimeBase(60 * MS, 50 * MS)
    now = arrivals(base, 100, rng, ppm=-30.0)
    utc, _ = base.utc(now)
    back = base.monotonic_ns(utc)
    assert back is not None
    assert abs(back - now) < 100


def test_late_arrivals_do_not_pull_the_relation() -> None:
    """In every second a stalled scan reads three fixes at once, up to 0.25 s late: the prompt ones decide."""
    base = TimeBase(60 * MS, 50 * MS)
    for k in range(300):
        sent = k * 100 * MS
        late = {5: 250, 6: 150, 7: 50}.get(k % 10, 0) * MS if k > 20 else 0
        base.observe_fix(sent + 85 * MS + late, true_utc(sent), 30)
    utc, _ = base.utc(30 * NS)
    assert abs(utc - true_utc(30 * NS)) < 5 * MS
