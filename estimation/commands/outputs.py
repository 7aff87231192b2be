"""Options of the estimation verbs that name files to write, looked at before any work is done."""

from pathlib import Path

from daq.contract.outputs import check_file, check_folder, write_json
from estimation.errors import EstimationError

__all__ = ["check_outputs", "write_json"]

PICTURES = (".eps", ".jpeg", ".jpg", ".pdf", ".png", ".ps", ".svg", ".svgz", ".tif", ".tiff", ".webp")


def check_outputs(
    *,
    json: Path | None = None,
    output: Path | None = None,
    figure: Path | None = None,
    report: Path | None = None,
    save_model: Path | None = None,
    histories: Path | None = None,
    write: Path | None = None,
) -> None:
    """Raise a UserError naming the option whose file could not be written, or whose suffix says no known format."""
    for option, path in (("--json", json), ("--output", output), ("--figure", figure), ("--save-model", save_model)):
        check_file(option, path)
    for option, path in (("--report", report), ("--histories", histories), ("--write", write)):
        check_folder(option, path)
    if figure is not None and figure.suffix.lower() not in PICTURES:
        raise EstimationError(f"--figure {figure}: no known kind of picture; end the name in .png, .pdf or .svg")
    if save_model is not None and save_model.suffix != ".toml":
        raise EstimationError(f"--save-model {save_model}: a model is written as TOML; end the name in .toml")
