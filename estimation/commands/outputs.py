"""Files to write: their options looked at before any work is done, so that no result is lost at the end."""

import os
from pathlib import Path

from estimation.errors import EstimationError

PICTURES = (".eps", ".jpeg", ".jpg", ".pdf", ".png", ".ps", ".svg", ".svgz", ".tif", ".tiff", ".webp")


def check_outputs(
    *,
    json: Path | None = None,
    figure: Path | None = None,
    report: Path | None = None,
    save_model: Path | None = None,
    histories: Path | None = None,
) -> None:
    """Raise EstimationError naming the option whose file could not be written, or whose suffix says no known format."""
    for option, path in (("--json", json), ("--figure", figure), ("--save-model", save_model)):
        if path is not None:
            _check_file(option, path)
    for option, path in (("--report", report), ("--histories", histories)):
        if path is not None:
            _check_folder(option, path)
    if figure is not None and figure.suffix.lower() not in PICTURES:
        raise EstimationError(f"--figure {figure}: no known kind of picture; end the name in .png, .pdf or .svg")
    if save_model is not None and save_model.suffix != ".toml":
        raise EstimationError(f"--save-model {save_model}: a model is written as TOML; end the name in .toml")


def _check_file(option: str, path: Path) -> None:
    if path.is_dir():
        raise EstimationError(f"{option} {path}: that is a folder; give the name of a file")
    if path.exists() and not os.access(path, os.W_OK):
        raise EstimationError(f"{option} {path}: that file may not be written; choose another name")
    _check_folder(option, path.parent)


def _check_folder(option: str, folder: Path) -> None:
    """Whether the folder, or the nearest one above it that exists, can take a new entry."""
    existing = folder
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir():
        raise EstimationError(f"{option} {folder}: {existing} is a file, not a folder; choose another place")
    try:
        probe = existing / f".sideslip-{os.getpid()}"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise EstimationError(
            f"{option} {folder}: cannot be written ({error.strerror}); choose another place"
        ) from error


def write_json(data: object, path: Path) -> None:
    """JSON to a file, in one step."""
    import json

    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".part")
    partial.write_text(json.dumps(data, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    partial.replace(path)
