"""Command-line verbs of the aircraft side: record, preflight, verify, recover; and what a person reads of a recording."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from daq.utilities.options import json_option, path_option
from daq.utilities.outputs import tried_file, write_json

if TYPE_CHECKING:
    from daq.contract.recordings.accounting import Verification

_JSON = json_option()
_RECORDING = click.argument("recording", metavar="FILE", type=click.Path(path_type=Path))


def _write_json(path: Path | None, result: Mapping[str, Any]) -> None:
    if path is not None:
        write_json(result, path)


def info_lines(recording: Path, result: Mapping[str, Any]) -> Iterator[str]:
    """What a person reads of a recording, from `info_mcap`."""
    sessions = result.get("sessions", [result])
    for part in sessions:
        session = f", session {part.get('session') or 'unknown'}" if len(sessions) > 1 else ""
        yield f"{part['file']}: {part['kind']}, {part['source']}, aircraft {part['aircraft'] or 'not named'}{session}"
        yield (
            f"  {part['scans']} scans in {part['duration_s']:.2f} s, {part['rate_hz']:.2f} Hz, "
            f"numbers {part['first_scan']} to {part['last_scan']}"
            + (f", recorded by sideslip {part['software']}" if part["software"] else "")
        )
    if not result["sound"]:
        yield f"  damaged or not closed in order: see 'sideslip verify {recording}'"
    for event in result.get("events", ()):
        yield f"  event at {event['time']:.2f} s ({event['origin']}): {event['text']}"
    for channel in result["channels"]:
        yield f"  {channel['name']:<24} {channel['unit'] or '-':<6} {channel['samples']:>8} samples"


@click.command(epilog="Example: sideslip verify recordings/demo/onboard")
@_RECORDING
@_JSON
def verify(recording: Path, json_path: Path | None) -> None:
    """Check every byte and account for every scan of a recording. Exit status 1 when something is wrong."""
    from daq.contract.recordings.accounting import verify as check

    result = check(recording)
    _write_json(json_path, result.to_dict())
    for line in verify_lines(recording, result):
        click.echo(line)
    if not result.ok:
        raise click.exceptions.Exit(1)


def verify_lines(recording: Path, result: "Verification") -> Iterator[str]:
    """What a person reads of a check: the sentence, and each damage."""
    yield f"{recording}: {result.text}"
    for path, damage in result.damages:
        yield f"  {path.name} byte {damage.at_byte}: {damage.what}"


@click.command(epilog="Example: sideslip recover flight_000.mcap -o recovered.mcap")
@_RECORDING
@path_option("-o", "--out", "--output", text="The new recording.", tried=tried_file, required=True)
@_JSON
def recover(recording: Path, out: Path, json_path: Path | None) -> None:
    """Save everything undamaged in a recording, FILE or directory, to a new and sound one.

    Of several sessions in one FILE the first goes to OUT.mcap, the others to OUT_2.mcap and so on.
    Exit status as with 'sideslip verify': 1 when FILE is not sound, though all that can be saved is in the new recording.
    """
    from daq.contract.recordings.recovery import recover as salvage

    result = salvage(recording, out)
    _write_json(json_path, result.to_dict())
    click.echo(result.to_dict()["text"])
    if not result.verification.ok:
        raise click.exceptions.Exit(1)


@click.command(epilog="Example: sideslip preflight /etc/sideslip/aircraft.toml")
@click.argument("config", type=click.Path(path_type=Path))
@_JSON
def preflight(config: Path, json_path: Path | None) -> None:
    """Go or no-go: sensors, values, clock, card and radio of the logger. Exit status 1 for no-go."""
    from daq.service.run import preflight_on_hardware

    table = preflight_on_hardware(config)
    _write_json(json_path, table.to_dict())
    click.echo(table.text())
    if not table.go:
        raise click.exceptions.Exit(1)


@click.command(epilog="Example: sideslip record /etc/sideslip/aircraft.toml")
@click.argument("config", type=click.Path(path_type=Path))
@click.option("--override", metavar="REASON", help="Record in spite of a no-go; the reason goes into the recording.")
@click.option("--skip-preflight", is_flag=True, help="Record at once; that too goes into the recording.")
@_JSON
def record(config: Path, override: str | None, skip_preflight: bool, json_path: Path | None) -> None:
    """Run the logger on this machine's sensors until SIGTERM or Ctrl-C. Refuses to start on a no-go.

    Exit status 1 when scans were dropped or lost; else 0 after SIGTERM and 130 after Ctrl-C, all files closed.
    """
    from daq.service.run import record_on_hardware

    outcome = record_on_hardware(config, override=override, skip_preflight=skip_preflight)
    _write_json(json_path, outcome.to_dict())
    click.echo(outcome.text)
    raise click.exceptions.Exit(outcome.exit_status)
