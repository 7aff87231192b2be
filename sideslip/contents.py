"""The verb `info`: what is in a file of any of our kinds."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from daq.contract.errors import UserError
from daq.contract.options import json_option
from daq.contract.outputs import write_json

_READ_HERE = (".tlog", ".csv", ".parquet")


@click.command(epilog="Example: sideslip info recordings/cdfp_ld1_raw.mcap --json info.json")
@click.argument("file", type=click.Path(path_type=Path))
@json_option("Write the same as JSON.")
def info(file: Path, json_path: Path | None) -> int:
    """What is in FILE: a raw recording, the directory of its segments, a flight, or a .tlog."""
    content = content_of(file)
    if json_path is not None:
        write_json(content, json_path)
    for line in lines_of(file, content):
        click.echo(line)
    return 0


def content_of(file: Path) -> dict[str, Any]:
    """What is in a file, as `info --json` has it. Raises UserError for another program's log, or what cannot be read."""
    from groundstation.importers.endings import FOREIGN

    if file.suffix.lower() in FOREIGN - {*_READ_HERE} and file.is_file():
        raise UserError(
            f"{file}: a log of another program; convert it to a flight with 'sideslip import {file} -o FLIGHT.mcap'"
        )
    if file.suffix not in _READ_HERE:
        from daq.contract.recordings.accounting import info_mcap

        return info_mcap(file)
    if file.suffix != ".tlog":
        return _flight_info(file)
    from groundstation.receiver.tlog import info_tlog

    return info_tlog(file)


def lines_of(file: Path, content: dict[str, Any]) -> Iterator[str]:
    """The same for a person."""
    if file.suffix not in _READ_HERE:
        from daq.commands import info_lines

        yield from info_lines(file, content)
        return
    yield (
        f"{file}: {content['kind']}, {content['source']}, {content['scans']} scans in {content['duration_s']:.2f} s, "
        f"{content['rate_hz']:.2f} Hz"
    )
    for channel in content["channels"]:
        yield f"  {channel['name']:<24} {channel['unit'] or '-':<6} {channel['samples']:>8} samples"


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
