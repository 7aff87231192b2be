"""Rows of a laboratory's package: what they become, and every mistake in them one sentence that says what to do."""

import os
import subprocess
import sys
from dataclasses import replace
from operator import add
from pathlib import Path

import pytest

from daq.contract.channel_rows import Channel, ChannelGroup, FlightColumn, Rate
from daq.contract.channels import BUILT_IN_CHANNELS, BUILT_IN_COLUMNS, BUILT_IN_GROUPS
from daq.contract.laboratory import LaboratoryError, TableRows, check, package_folder, read_rows
from daq.contract.link.wire import SCAN_FAST_ID, SCAN_LABORATORY_ID, UserError, layouts, pack_scan, unpack_scan
from daq.contract.scan import GroupStatus, Scan, SensorState
from daq.telemetry.downlink import _GroupRotation
from daq.transport.mavlink_codec import FrameDecoder, FrameEncoder, MavlinkFrame
from groundstation.receiver.decode import AircraftDecoder
from groundstation.receiver.events import ScanReceived, StatusText

ROWS = """
[[group]]
name = "smoke"
title = "smoke detector"
device = "SD1"

[[channel]]
name = "smoke"
group = "smoke"
raw_type = "i16"
unit = "V"
meaning = "smoke in the cockpit"
scale = 1e-3
downlink = "fast"
"""
BUILT_IN = TableRows(BUILT_IN_GROUPS, BUILT_IN_CHANNELS, BUILT_IN_COLUMNS)


def rows_of(folder: Path, text: str = ROWS) -> TableRows:
    (folder / "channels.toml").write_text(text)
    return read_rows(folder / "channels.toml", "lab")


def test_a_channel_is_a_column_of_its_own_name_and_unit(tmp_path: Path) -> None:
    rows = rows_of(tmp_path)
    assert rows.groups == (ChannelGroup("smoke", "smoke detector", "SD1", "lab"),)
    assert rows.channels == (
        Channel(
            "smoke", "smoke", "i16", "V", "smoke in the cockpit", 1e-3, 0.0, Rate.SCAN, True, "fast", ("smoke",), "lab"
        ),
    )
    assert rows.columns == (FlightColumn("smoke", "V", "smoke in the cockpit", "/smoke", (-32.768, 32.767)),)
    check(TableRows(*map(add, BUILT_IN, rows)), "here")
    assert rows_of(tmp_path, ROWS + "columns = []\n").columns == ()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (('raw_type = "i16"', 'raw_type = "i17"'), r"channel\.0\.raw_type: Input should be"),
        (('unit = "V"', 'unit = "V"\ncolour = "red"'), r"channel\.0\.colour: Extra inputs are not permitted"),
        (("scale = 1e-3", "scale = nan"), r"channel\.0\.scale: Input should be a finite number"),
        (('name = "smoke"', 'name = "Smoke"'), r"group\.0\.name"),
        (("[[group]]", "[[group"), "not valid TOML"),
    ],
)
def test_a_row_that_is_wrong_is_named_with_file_and_key(tmp_path: Path, change: tuple[str, str], says: str) -> None:
    with pytest.raises(LaboratoryError, match=rf"channels\.toml: {says}"):
        rows_of(tmp_path, ROWS.replace(*change, 1))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (ROWS.replace("smoke", "pitot"), "group pitot is already in the channel table"),
        (ROWS.replace('name = "smoke"\ngroup', 'name = "supply"\ngroup'), "channel or state supply is already"),
        (ROWS.replace('name = "smoke"\ngroup', 'name = "beta"\ngroup'), "column beta is already in the channel table"),
        (ROWS.replace('group = "smoke"', 'group = "fire"'), "channel smoke: no group 'fire'; add"),
        (ROWS + 'columns = ["fire"]\n', "channel smoke: no column 'fire'; add"),
    ],
)
def test_rows_that_do_not_fit_the_table_are_refused(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(LaboratoryError, match=f"here: {says}"):
        check(TableRows(*map(add, BUILT_IN, rows_of(tmp_path, text))), "here")


def test_missing_package_and_missing_file_are_said(tmp_path: Path) -> None:
    with pytest.raises(LaboratoryError, match="'no_such_lab' is no package"):
        package_folder("no_such_lab")
    with pytest.raises(LaboratoryError, match=r"channels\.toml: no such file of a laboratory"):
        read_rows(tmp_path / "channels.toml", "lab")


def test_laboratory_channels_go_down_in_a_message_of_their_own(tmp_path: Path) -> None:
    table = (*BUILT_IN_CHANNELS, *rows_of(tmp_path).channels)
    made = layouts(table)
    standard = layouts(BUILT_IN_CHANNELS)
    assert {i: made[i].fields for i in standard} == {i: made.fields for i, made in standard.items()}
    layout = made[SCAN_LABORATORY_ID]
    scan = Scan(7, 10**9, groups={"smoke": GroupStatus(SensorState.OK, 120)}, values={"smoke": -5})
    part = unpack_scan(layout, pack_scan(layout, scan, 3))
    assert (part.number, part.boot, part.values, part.groups) == (7, 3, scan.values, scan.groups)
    other = layouts((*BUILT_IN_CHANNELS, replace(table[-1], name="smoke2")))[SCAN_LABORATORY_ID]
    with pytest.raises(ValueError, match="another table"):
        unpack_scan(other, pack_scan(layout, scan, 3))


def test_more_than_a_frame_holds_is_refused(tmp_path: Path) -> None:
    many = [replace(rows_of(tmp_path).channels[0], name=f"smoke_{i}") for i in range(100)]
    with pytest.raises(UserError, match=r"take 2\d\d bytes of a frame, 200 at most"):
        layouts((*BUILT_IN_CHANNELS, *many))


def test_sensors_that_come_in_different_scans_take_turns_on_the_link(tmp_path: Path) -> None:
    """Two sensors, each in every fifth scan, never in the same one: once a second one of them, in turn."""
    [smoke] = rows_of(tmp_path).channels
    turns = _GroupRotation((smoke, replace(smoke, name="ozone", group="ozone")))
    sent = {"smoke": 0, "ozone": 0}
    for number in range(400):
        values = {name: 1 for name, phase in (("smoke", 0), ("ozone", 2)) if number % 5 == phase}
        scan = Scan(number, number * 50_000_000, values=values)
        if turns.due(scan):
            turns.next = scan.time + 1.0
            for name in values:
                sent[name] += 1
    assert sent["smoke"] >= 8
    assert sent["ozone"] >= 8


def test_a_sensor_that_is_gone_holds_the_others_up_by_a_second_at_most(tmp_path: Path) -> None:
    [smoke] = rows_of(tmp_path).channels
    turns = _GroupRotation((smoke, replace(smoke, name="ozone", group="ozone")))
    times = []
    for number in range(400):
        scan = Scan(number, number * 50_000_000, values={"smoke": 1})
        if turns.due(scan):
            turns.next = scan.time + 1.0
            times.append(scan.time)
    assert max(b - a for a, b in zip(times, times[1:], strict=False)) <= 2.06


def test_ground_without_the_package_says_so_once_and_receives_the_rest(tmp_path: Path) -> None:
    layout = layouts((*BUILT_IN_CHANNELS, *rows_of(tmp_path).channels))[SCAN_LABORATORY_ID]
    encoder, decoder = FrameEncoder(1, 1), AircraftDecoder(1)
    events = []
    for number in range(3):
        scan = Scan(number, 10**9 + number * 10**8, values={"smoke": -5, "supply": 9})
        for i, made in ((SCAN_LABORATORY_ID, layout), (SCAN_FAST_ID, layouts()[SCAN_FAST_ID])):
            [frame] = FrameDecoder().feed(encoder.frame(i, pack_scan(made, scan, 3)))
            assert isinstance(frame, MavlinkFrame)
            events += decoder.decode_frame(frame, number, 0)
    told = [e.text for e in events if isinstance(e, StatusText)]
    assert len(told) == 1
    assert "no package installed here describes" in told[0]
    assert sum(isinstance(e, ScanReceived) for e in events) == 3


def install(folder: Path, rows: str, package: str) -> None:
    """A package as pip leaves it: its folder, and an entry point beside it."""
    (folder / package).mkdir(parents=True)
    (folder / package / "__init__.py").write_text("raise RuntimeError('a package is read as data, not imported')\n")
    (folder / package / "channels.toml").write_text(rows)
    info = folder / f"{package}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[sideslip.channels]\nmine = {package}\n")


def run_with(folder: Path, code: str, root: Path) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(folder), str(root)])
    return subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def test_a_scan_is_read_right_or_not_at_all_whatever_packages_are_installed(root: Path, tmp_path: Path) -> None:
    """Two laboratories number their first channel alike in no case: values never come back under another name."""
    install(tmp_path / "a", ROWS, "lab_a")
    install(tmp_path / "b", ROWS.replace("smoke", "ozone"), "lab_b")
    write = (
        "from daq.contract.scan import *\n"
        "s = Scan(1, 2, groups={'smoke': GroupStatus(SensorState.OK)}, values={'smoke': -5, 'supply': 9})\n"
        "print(encode_scan(s).hex())"
    )
    read = (
        "from daq.contract.scan import *\ns = decode_scan(bytes.fromhex('{}'))\nprint(dict(s.values), list(s.groups))"
    )
    made = run_with(tmp_path / "a", write, root)
    assert made.returncode == 0, made.stderr
    text = made.stdout.strip()
    found = [run_with(tmp_path / f, read.format(text), root).stdout.strip() for f in ("a", "b", "none")]
    assert found == ["{'supply': 9, 'smoke': -5} ['smoke']", "{'supply': 9} []", "{'supply': 9} []"]


def test_a_package_with_a_mistake_ends_the_command_with_one_line(root: Path, tmp_path: Path) -> None:
    install(tmp_path, ROWS.replace("i16", "i17"), "lab_c")
    code = "from sideslip import main; main(['verify', 'recordings/cdfp_ld1_raw.mcap'])"
    done = run_with(tmp_path, code, root)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert "lab_c/channels.toml: channel.0.raw_type" in done.stderr
