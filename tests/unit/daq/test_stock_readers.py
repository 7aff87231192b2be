"""Recordings open in programs that know nothing of us: the stock MCAP reader with its protobuf decoder, and rerun."""

import subprocess
import sys
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from daq.contract.channels import CHANNELS
from tests.unit.daq.synthetic import SCANS, make_scan, write_recording


@pytest.mark.parametrize("compress", [False, True])
def test_stock_reader_decodes_every_channel_by_name(tmp_path: Path, compress: bool) -> None:
    path = tmp_path / "s1_000.mcap"
    write_recording(path, compress=compress)
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        decoded = {(c.topic, m.sequence): d for _, c, m, d in reader.iter_decoded_messages()}
        names = {a.name for a in reader.iter_attachments()}
        identity = next(m for m in reader.iter_metadata() if m.name == "sideslip.recording")
        summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == SCANS + 3
    assert names == {"sideslip.recording.json", "channels.json", "config.toml", "calibration/pitot.toml"}
    assert identity.metadata["source"] == "simulated"
    for n in (0, 17, SCANS - 1):
        values = make_scan(n).values
        assert {c.name: getattr(decoded["/scan", n], c.name) for c in CHANNELS} == values
    assert decoded["/log", 0].message == "recording ends"


def test_rerun_shows_channels_and_log(tmp_path: Path) -> None:
    rr = pytest.importorskip("rerun")
    path, out = tmp_path / "s1_000.mcap", tmp_path / "out.rrd"
    write_recording(path)
    recording = rr.RecordingStream("sideslip-test")
    recording.save(str(out))
    recording.log_file_from_path(str(path))
    recording.flush()
    recording.disconnect()
    command = [sys.executable, "-m", "rerun", "rrd", "print", "-vv", str(out)]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "/scan" in printed
    assert "accel_x" in printed, "the fields of a scan are decoded by name"
    assert "TextLog" in printed, "log lines are recognised as such"
