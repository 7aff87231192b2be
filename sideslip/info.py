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
    """What is in FILE: a raw recording, the directory of its segments, a flight, or a .tlog."""
    from groundstation.importers.endings import FOREIGN

    if file.suffix.lower() in FOREIGN - {*_READ_HERE} and file.is_file():
        raise UserError(
            f"{file}: a log of another program; convert it to a flight with 'sideslip import {file} -o FLIGHT.mcap'"
        )
    if file.suffix not in _READ_HERE:
        from daq.commands import info as recording_info

        ctx.invoke(recording_info, recording=file, json_path=json_path)
        return 0
    if file.suffix == ".tlog":
        from groundstation.receiver.tlog import info_tlog

        found = info_tlog(file)
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
