"""The packed messages are derived from the channel table, fit the radio, and carry raw counts exactly."""

import errno
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daq.contract.channels import CHANNELS, GROUP_NAMES, Channel, Rate
from daq.contract.link.dialect import build, generate, sideslip_dialect
from daq.contract.link.wire import (
    _CODE,
    MAX_FAST_PAYLOAD,
    SCAN_FAST_ID,
    SCAN_RARE_ID,
    SCAN_SLOW_ID,
    join_parts,
    layouts,
    pack_scan,
    unpack_scan,
)
from daq.contract.scan import GroupStatus, Scan, SensorState
from tests.support.link_rig import random_scan

SENT = tuple(c for c in CHANNELS if c.downlink != "none")


def test_definitions_are_what_the_generator_makes() -> None:
    assert build.DEFINITION.read_text() == generate.definition()
    assert generate.WITH_STANDARD.read_text() == generate.definition_with_standard()


def test_a_module_of_another_definition_is_made_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A pull that changes the XML must not leave an editable install with yesterday's messages."""
    monkeypatch.setattr(build, "HERE", tmp_path)
    monkeypatch.setattr(build, "DEFINITION", Path(shutil.copy(build.DEFINITION, tmp_path)))
    build.ensure_module()
    module = tmp_path / build.MODULE
    first = module.read_text()
    build.ensure_module()
    changed = build.DEFINITION.read_text().replace("LOGGER_STATUS", "LOGGER_STATE")
    build.DEFINITION.write_text(changed)
    build.ensure_module()
    assert "MAVLINK_MSG_ID_LOGGER_STATUS" in first
    assert "MAVLINK_MSG_ID_LOGGER_STATE" in module.read_text()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["sideslip.xml", build.MODULE]


def test_a_module_cut_short_is_made_anew_and_a_full_disk_leaves_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its first line alone does not tell that a power cut left the rest."""
    made = build.write_module(tmp_path)
    whole = made.read_bytes()
    monkeypatch.setattr(build, "HERE", tmp_path)
    monkeypatch.setattr(build, "module_text", lambda definition: whole.decode())
    for rest in (whole[:90_000], whole[:-1], b"", whole[:90_000].ljust(len(whole), b"\0")):
        made.write_bytes(rest)
        build.ensure_module()
        assert made.read_bytes() == whole
    made.unlink()

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(ImportError, match="No space left"):
        build.ensure_module()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("language", "made"), [("Python3", "sideslip.py"), ("WLua", "sideslip.lua")])
def test_other_programs_can_load_our_messages_beside_the_standard_ones(
    tmp_path: Path, language: str, made: str
) -> None:
    """As docs/mavlink.md has it: MAVProxy a Python module, Wireshark a dissector, with the same checksums as ours."""
    for xml in Path(import_module("pymavlink.dialects.v20").__path__[0]).glob("*.xml"):
        shutil.copy(xml, tmp_path)
    shutil.copy(generate.WITH_STANDARD, tmp_path / "sideslip.xml")
    command = [sys.executable, "-m", "pymavlink.tools.mavgen", f"--lang={language}", "--wire-protocol=2.0"]
    output = "sideslip.py" if language == "Python3" else "sideslip"
    subprocess.run([*command, f"--output={output}", "sideslip.xml"], cwd=tmp_path, check=True, capture_output=True)
    text = (tmp_path / made).read_text()
    assert "LOGGER_STATUS" in text
    assert "AOA_SSA" in text
    if language == "Python3":
        module: dict[str, Any] = {"__name__": "made", "__file__": made}
        exec(compile(text, made, "exec"), module)  # noqa: S102 - it is ours
        theirs = module["mavlink_map"]
        for msg_id, own in sideslip_dialect.mavlink_map.items():
            assert (theirs[msg_id].crc_extra, theirs[msg_id].unpacker.format) == (own.crc_extra, own.unpacker.format)


def test_standard_messages_are_compatible_with_the_common_dialect() -> None:
    common = import_module("pymavlink.dialects.v20.ardupilotmega").mavlink_map  # includes common
    shared = [i for i in sideslip_dialect.mavlink_map if i < generate.layouts()[SCAN_FAST_ID].msg_id]
    assert len(shared) == len(generate.STANDARD)
    for msg_id in shared:
        ours, theirs = sideslip_dialect.mavlink_map[msg_id], common[msg_id]
        assert (ours.crc_extra, ours.unpacker.format) == (theirs.crc_extra, theirs.unpacker.format), ours.msgname


def test_every_sent_channel_is_in_exactly_one_message_and_no_other_is() -> None:
    carried = [c.name for layout in layouts().values() for c in layout.channels]
    assert sorted(carried) == sorted(c.name for c in SENT)
    groups = [g for layout in layouts().values() for g in layout.groups]
    assert sorted(groups) == sorted({c.group for c in SENT})
    assert {c.name for c in layouts()[SCAN_FAST_ID].channels} == {c.name for c in SENT if c.downlink == "fast"}
    assert all(c.rate is Rate.SLOW for c in layouts()[SCAN_RARE_ID].channels)


def test_layouts_agree_with_the_dialect_to_the_byte() -> None:
    for layout in layouts().values():
        made = sideslip_dialect.mavlink_map[layout.msg_id]
        codes = (f"{f.count or ''}{_CODE[f.raw_type]}" for f in layout.fields)
        assert "<" + "".join(codes) == made.unpacker.format
        assert [f.name for f in layout.fields] == made.ordered_fieldnames


def test_fast_payload_fits_an_error_corrected_packet_when_signed() -> None:
    assert layouts()[SCAN_FAST_ID].size <= MAX_FAST_PAYLOAD
    assert layouts()[SCAN_FAST_ID].size + 12 + 13 <= 118


def test_a_new_row_of_the_table_appears_on_the_wire() -> None:
    row = Channel("fuel_flow", "capture", "u16", "kg/s", "fuel flow", downlink="slow")
    table = layouts((*CHANNELS, row))
    assert row in table[SCAN_SLOW_ID].channels
    assert table[SCAN_SLOW_ID].size > layouts()[SCAN_SLOW_ID].size


@pytest.mark.parametrize("seed", range(20))
def test_round_trip_is_exact(seed: int) -> None:
    scan = random_scan(seed, np.random.default_rng(seed), gnss=True)
    values = {k: v for k, v in scan.values.items() if k in {c.name for c in SENT}}
    if seed % 2:  # some channels without a value, some groups the scan says nothing of
        values = {k: v for i, (k, v) in enumerate(values.items()) if (i + seed) % 5}
    groups = {g: s for i, (g, s) in enumerate(scan.groups.items()) if seed % 3 or i % 4}
    scan = replace(scan, values=values, groups=groups)
    parts = [unpack_scan(layout, pack_scan(layout, scan, 200)) for layout in layouts().values()]
    assert join_parts(parts) == scan
    assert {p.boot for p in parts} == {200}


@pytest.mark.parametrize("extreme", [0, 1])
def test_extremes_of_every_raw_type_survive(extreme: int) -> None:
    narrow = {
        "static_pressure": (0, 2**24 - 1),
        "static_temperature": (0, 2**24 - 1),
        "thrust_load": (-(2**23), 2**23 - 1),
    }
    values = {c.name: int(narrow.get(c.name, c.limits())[extreme]) for c in SENT}
    scan = Scan(2**32 - 1, 2**56 - 1, 2**64 - 1, 2**32 - 1, 2**32 - 1, {}, values)
    assert join_parts(unpack_scan(la, pack_scan(la, scan, 1)) for la in layouts().values()).values == values


def test_what_does_not_fit_is_missing_never_clamped() -> None:
    values = {"accel_x": 40000, "accel_y": -7, "static_pressure": 2**24, "alpha_vane": 12}
    groups = {"analog_a": GroupStatus(SensorState.STALE, 40_000), "imu": GroupStatus(SensorState.OK, 9)}
    layout = layouts()[SCAN_FAST_ID]
    part = unpack_scan(layout, pack_scan(layout, Scan(1, 2, groups=groups, values=values), 1))
    assert part.values == {"accel_y": -7}  # alpha's read offset does not fit, so alpha is left out too
    assert part.groups["analog_a"].state is SensorState.STALE
    assert set(part.groups) == {"analog_a", "imu"}


def test_healthy_frames_are_shorter_because_trailing_zeros_are_left_out() -> None:
    groups = {g: GroupStatus(SensorState.OK, 500) for g in GROUP_NAMES}
    scan = Scan(1, 2, groups=groups, values={c.name: 1 if c.raw_type != "bit" else 0 for c in SENT})
    payload = pack_scan(layouts()[SCAN_FAST_ID], scan, 1)
    assert payload.endswith(bytes(8))


def test_wrong_length_is_an_error() -> None:
    with pytest.raises(ValueError, match="92 bytes, not 93"):
        unpack_scan(layouts()[SCAN_FAST_ID], bytes(92))
