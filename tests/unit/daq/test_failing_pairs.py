"""Each sensor alone, and any two, fail while the logger scans: no scan is missed and each scan says what is missing."""

from itertools import combinations, pairwise

import pytest

from daq.contract.channels import channels_of
from daq.contract.scan import Scan, SensorState
from tests.unit.daq.rig import rig

DEVICES = ("imu", "mag", "analog_a", "analog_b", "analog_c", "pitot", "static", "thrust", "capture", "gnss")
GONE = frozenset({SensorState.ABSENT, SensorState.FAULT, SensorState.STALE})
AWAY_S, BACK_S, SCANS = 0.9, 1.4, 70
PERIOD_NS = 50_000_000
NOTICED_S = 0.7
"""A receiver is silent for half a second before it counts as gone."""
RETURN_S = 2.4
"""From its plug to values: the longest pause between two tries, and the set-up of the slowest chip."""


def missing(scans: list[Scan], group: str) -> list[Scan]:
    """The scans that say that a group has no value."""
    return [s for s in scans if group in s.groups and s.groups[group].state in GONE]


PAIRS = list(combinations(DEVICES, 2))


@pytest.mark.parametrize(
    "failing",
    [
        *((device,) for device in DEVICES),
        *PAIRS,
    ],
    ids="+".join,
)
def test_scan_goes_on_and_says_what_is_missing(failing: tuple[str, ...]) -> None:
    faults = tuple({"kind": "absent", "device": d, "start_s": AWAY_S, "stop_s": BACK_S} for d in failing)
    r = rig(faults, start=False)
    origin_s = r.clock.monotonic_ns() * 1e-9
    r.sampler.start()
    scans = r.fly(SCANS * PERIOD_NS * 1e-9)
    assert {b.time_monotonic_ns - a.time_monotonic_ns for a, b in pairwise(scans)} == {PERIOD_NS}
    assert r.longest_ns < PERIOD_NS
    with_package = {*failing, *(("mag",) if "imu" in failing else ())}
    for group in with_package:
        gone = missing(scans, group)
        assert AWAY_S - 0.05 <= gone[0].time - origin_s <= AWAY_S + NOTICED_S, group
        assert gone[-1].time - origin_s <= BACK_S + RETURN_S, group
        names = {c.name for c in channels_of(group)}
        assert not any(names & s.values.keys() for s in gone), group
        assert scans[-1].groups[group].state in (SensorState.OK, SensorState.RECOVERING), group
    for group in set(DEVICES) - with_package:
        assert len(missing(scans, group)) <= 1, group
