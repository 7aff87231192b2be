"""A scan survives its protobuf form whatever raw values it carries."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from daq.contract.channels import CHANNELS, GROUP_NAMES
from daq.contract.scan import GroupStatus, Scan, ScanDecodeError, SensorState, decode_scan, encode_scan


def raw_value(kind: str) -> st.SearchStrategy[Any]:
    low, high = next(c for c in CHANNELS if c.raw_type == kind).limits()
    return st.integers(int(low), int(high))


@st.composite
def scans(draw: st.DrawFn) -> Scan:
    values = {c.name: draw(raw_value(c.raw_type)) for c in CHANNELS if draw(st.booleans())}
    groups = {
        g: GroupStatus(draw(st.sampled_from(SensorState)), draw(st.integers(-100_000, 100_000)))
        for g in GROUP_NAMES
        if draw(st.booleans())
    }
    return Scan(
        number=draw(st.integers(0, 2**32 - 1)),
        time_monotonic_ns=draw(st.integers(0, 2**63)),
        time_utc_ns=draw(st.integers(0, 2**63)),
        utc_accuracy_ns=draw(st.integers(0, 2**32 - 1)),
        lateness_us=draw(st.integers(0, 2**32 - 1)),
        groups=groups,
        values=values,
    )


@given(scans())
def test_encode_then_decode_is_the_same_scan(scan: Scan) -> None:
    assert decode_scan(encode_scan(scan)) == scan


def test_absent_and_zero_differ() -> None:
    scan = decode_scan(encode_scan(Scan(1, 2, values={"accel_x": 0})))
    assert scan.values == {"accel_x": 0}


def test_rubbish_is_refused_with_a_sentence() -> None:
    with pytest.raises(ScanDecodeError, match="not a scan"):
        decode_scan(b"\xff\xff\xff\xff")


def test_states_have_words() -> None:
    assert SensorState.OUT_OF_RANGE.words == "out of range"
    assert [s for s in SensorState if s.usable] == [SensorState.OK]
