"""The verb `export`: flights, recordings and models for other programs."""

from pathlib import Path

import click

from daq.contract.outputs import tried_file

_MODELS = (".toml", ".json")


@click.command(epilog="Example: sideslip export ld4.mcap -o ld4.parquet")
@click.argument("file", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    callback=tried_file,
    required=True,
    help="Its ending chooses the format.",
)
@click.option("--units-row", is_flag=True, help="CSV: a second line with the units.")
@click.option("--raw", is_flag=True, help="Of a raw recording: counts as recorded, not calibrated columns.")
@click.option(
    "--calibration", type=click.Path(path_type=Path), help="Directory of calibration files instead of the embedded set."
)
def export(file: Path, output: Path, units_row: bool, raw: bool, calibration: Path | None) -> int:
    """Write FILE for other programs.

    A flight or recording: .csv .parquet .mat .kml .gpx .rrd .mcap (the last draws in Foxglove). A model .toml or what
    estimate --json wrote: .json .tex .csv. Units travel along.
    """
    if file.suffix.lower() in _MODELS:
        from estimation.report.model_export import export_model

        export_model(file, output)
        click.echo(f"{output}: written")
        return 0
    from groundstation.export.run import export_file

    done = export_file(file, output, units_row=units_row, raw=raw, calibration=calibration)
    click.echo(f"{done.path}: written")
    for note in done.notes:
        click.echo(f"  note: {note}")
    return 0
