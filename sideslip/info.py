"""The verb `info`: what is in a file of any of our kinds."""

from pathlib import Path
from typing import Any

import click

from daq.contract.errors import UserError
from daq.contract.outputs import tried_file, write_json

_READ_HERE = (".tlog", ".csv", ".parquet")


@click.command(epilog="Example: sideslip info recordings/cdfp_ld1_raw.mcap --json info.json")
@click.argument("file", type=click.Path(path_type=Path))
@click.option(
    "--json", "json_path", type=click.Path(path_type=Path), callback=tried_file, help="Write the same as JSON."
)
@click.pass_context
def info(ctx: click.Context, file: Path, json_path: Path | None) -> int:
    """What is in FILE: a raw recording, the directory of its segments, a flight, or a log of an autopilot."""
    from groundstation.importers.about import is_foreign_log, log_info
    from groundstation.importers.endings import FOREIGN

    if file.suffix != ".tlog" and is_foreign_log(file):
        _say_log(log_info(file), json_path)
        return 0
    if file.suffix.lower() in FOREIGN - {*_READ_HERE} and file.is_file():
        raise UserError(
            f"{file}: a log of another program; convert it to a flight with 'sideslip import {file} -o FLIGHT.mcap'"
        )
    if file.suffix not in _READ_HERE:
        from daq.commands import info as recording_info

        ctx.invoke(recording_info, recording=file, json_path=json_path)
        return 0
    if file.suffix == ".tlog":
        from groundstation.receiver.tlog import TlogError, info_tlog

        try:
            found = info_tlog(file)
        except TlogError as error:
            if not file.is_file() or not file.stat().st_size:
                raise
            _say_log(_log_or(error, file), json_path)
            return 0
        if not found["scans"]:  # not one of ours: an autopilot's
            _say_log(_log_or(found, file), json_path)
            return 0
    else:
        found = _flight_info(file)
    if json_path is not None:
        write_json(found, json_path)
    click.echo(
        f"{file}: {found['kind']}, {found['source']}, {found['scans']} scans in {found['duration_s']:.2f} s, "
        f"{found['rate_hz']:.2f} Hz"
    )
    for channel in found["channels"]:
        click.echo(f"  {channel['name']:<24} {channel['unit'] or '-':<6} {channel['samples']:>8} samples")
    return 0


def _log_or(other: "dict[str, Any] | Exception", file: Path) -> dict[str, Any]:
    """What is in a telemetry log of an autopilot; the other answer where nothing can be read of it."""
    from groundstation.importers.about import log_info
    from groundstation.importers.errors import ImportDataError

    try:
        return log_info(file)
    except ImportDataError:
        if isinstance(other, Exception):
            raise other from None
        return other


def _say_log(found: dict[str, Any], json_path: Path | None) -> None:
    if json_path is not None:
        write_json(found, json_path)
    boots = found.get("boots", [])
    many = f", {len(boots)} boots" if len(boots) > 1 else ""
    click.echo(
        f"{found['file']}: {found['kind']} log, {found['duration_s']:.2f} s{many}; 'sideslip import' makes a flight of it"
    )
    for note in found.get("notes", []):
        click.echo(f"  note: {note}")
    topics: dict[str, int] = {}
    for channel in found["channels"]:
        topic = channel["name"].rpartition(".")[0] or channel["name"]
        topics[topic] = max(topics.get(topic, 0), channel["samples"])
    for topic, samples in topics.items():
        click.echo(f"  {topic:<32} {samples:>8} samples")


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
