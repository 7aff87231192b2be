"""The verb `info`: the content of a recording, flight or log."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from daq.utilities.errors import UserError
from daq.utilities.options import json_option
from daq.utilities.outputs import write_json

MOST_PRINTED = 40  # modes, and events with messages; the JSON has all
_READ_HERE = (".tlog", ".csv", ".parquet")
AFTER = {"raw": "sideslip calibrate {file} -o flight.mcap", "flight": "sideslip check {file}"}
AFTER_A_LOG = "sideslip import {file} -o flight.mcap"
"""Next step, by the kind of the file."""


@click.command(epilog="Example: sideslip info recordings/cdfp_ld1_raw.mcap --json info.json")
@click.argument("file", type=click.Path(path_type=Path))
@json_option()
def info(file: Path, json_path: Path | None) -> int:
    """What is in FILE: a raw recording, the directory of its segments, a flight, or a log of an autopilot."""
    content = content_of(file)
    if json_path is not None:
        write_json(content, json_path)
    for line in lines_of(file, content):
        click.echo(line)
    if not click.get_current_context().meta.get("sideslip.quiet"):
        click.echo(f"next: {AFTER.get(content['kind'], AFTER_A_LOG).format(file=file)}", err=True)
    return 0


def content_of(file: Path) -> dict[str, Any]:
    """The content of `info --json`. Raises UserError for a file that cannot be read, or a table that must be imported."""
    from groundstation.importers.about import is_foreign_log, log_info
    from groundstation.importers.endings import FOREIGN
    from groundstation.importers.run import refuse_others

    if file.suffix == ".tlog":
        return _tlog_info(file)
    if is_foreign_log(file):
        return log_info(file)
    refuse_others(file)
    if file.suffix.lower() in FOREIGN - {*_READ_HERE} and file.is_file():
        raise UserError(
            f"{file}: a log of another program; convert it to a flight with 'sideslip import {file} -o FLIGHT.mcap'"
        )
    if file.suffix in _READ_HERE:
        return _flight_info(file)
    from daq.contract.recordings.summary import info_mcap

    return info_mcap(file)


def _tlog_info(file: Path) -> dict[str, Any]:
    """Content of a telemetry log of our downlink or, without a scan of it, of an autopilot."""
    from groundstation.receiver.tlog import TlogError, info_tlog

    try:
        summary = info_tlog(file)
    except TlogError as error:
        if not file.is_file() or not file.stat().st_size:
            raise
        return _log_or(error, file)
    return summary if summary["scans"] else _log_or(summary, file)


def _log_or(other: "dict[str, Any] | Exception", file: Path) -> dict[str, Any]:
    """Content of a telemetry log of an autopilot; `other`, returned or raised, where it cannot be read as one."""
    from groundstation.importers.about import log_info
    from groundstation.importers.errors import ImportDataError

    try:
        return log_info(file)
    except ImportDataError:
        if isinstance(other, Exception):
            raise other from None
        return other


def lines_of(file: Path, content: dict[str, Any]) -> Iterator[str]:
    """The content of a file as lines for a person."""
    if "boots" in content:
        yield from _log_lines(content)
        return
    if "sound" in content:
        from daq.commands import info_lines

        yield from info_lines(file, content)
        return
    yield (
        f"{file}: {content['kind']}, {content['source']}, {content['scans']} scans in {content['duration_s']:.2f} s, "
        f"{content['rate_hz']:.2f} Hz"
    )
    for channel in content["channels"]:
        yield f"  {channel['name']:<24} {channel['unit'] or '-':<6} {channel['samples']:>8} samples"


def _log_lines(content: dict[str, Any]) -> Iterator[str]:
    from groundstation.importers.endings import BAGS

    boots = content["boots"]
    boot_note = f", {len(boots)} boots" if len(boots) > 1 else ""
    duration = f"{content['duration_s']:.2f} s{boot_note}"
    kind = content["kind"]
    kind = f"bag of {kind} messages" if str(content["file"]).endswith(BAGS) and kind != "bag" else f"{kind} log"
    yield f"{content['file']}: {kind}, {duration}; 'sideslip import' makes a flight of it"
    yield from (f"  note: {note}" for note in content.get("notes", []))
    yield from (
        f"  mode {m['mode']:<16} {m['from']:10.2f} to {m['to']:.2f} s" for m in content.get("modes", [])[:MOST_PRINTED]
    )
    marks = sorted([*content.get("events", []), *content.get("messages", [])], key=lambda m: m["time"])
    yield from (f"  {mark['time']:10.2f} s  {mark['text']}" for mark in marks[:MOST_PRINTED])
    if content.get("parameters"):
        yield f"  {len(content['parameters'])} parameters (--json lists them)"
    topics: dict[str, int] = {}
    for channel in content["channels"]:
        topic = channel["name"].rpartition(".")[0] or channel["name"]
        topics[topic] = max(topics.get(topic, 0), channel["samples"])
    yield from (f"  {topic:<32} {samples:>8} samples" for topic, samples in topics.items())


def _flight_info(file: Path) -> dict[str, Any]:
    import numpy as np

    from daq.contract.channels import COLUMN_BY_NAME
    from groundstation.flight import read_flight

    flight = read_flight(file)
    units = {n: c.unit for n, c in COLUMN_BY_NAME.items()}
    columns = [
        {"name": n, "unit": units.get(n, ""), "samples": int(np.isfinite(v).sum())} for n, v in flight.columns.items()
    ]
    return {
        "file": str(file),
        "kind": "flight",
        "source": flight.provenance.source,
        "aircraft": flight.provenance.aircraft,
        "duration_s": float(flight.time[-1] - flight.time[0]),
        "rate_hz": 1.0 / flight.sample_interval,
        "scans": len(flight),
        "first_scan": None,
        "last_scan": None,
        "channels": columns,
        "software": flight.provenance.software,
        "notes": [note.text for note in flight.notes],
    }
