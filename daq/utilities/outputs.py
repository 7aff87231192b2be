"""Output files of verbs: checked before any work is done, so that no result is lost at the end, and written atomically."""

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from daq.utilities import durable
from daq.utilities.durable import make_directories
from daq.utilities.errors import UserError

PICTURES = (".eps", ".jpeg", ".jpg", ".pdf", ".png", ".ps", ".svg", ".svgz", ".tif", ".tiff", ".webp")
"""File suffixes of figures."""


class OutputError(UserError):
    """A file or folder that cannot be written."""


def write_json(data: object, path: Path) -> None:
    """Write JSON atomically, making missing folders; numbers that are not finite become null. Raises OutputError."""
    write_text(json.dumps(_finite(data), indent=1, ensure_ascii=False, allow_nan=False) + "\n", path)


def write_text(text: str, path: Path) -> None:
    """Write a text file atomically, making missing folders. Raises OutputError where it cannot be written."""
    try:
        make_directories(path.parent)
        durable.write_text(path, text)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({error.strerror}); choose another place") from error


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    return [_finite(item) for item in value] if isinstance(value, list | tuple) else value


def check_file(option: str, path: Path | None) -> None:
    """Raise OutputError, naming the option, where its file could not be written. path: None where the option is not given."""
    if path is None:
        return
    if path.is_dir():
        raise OutputError(f"{option} {path}: that is a folder; give the name of a file")
    if path.exists() and not os.access(path, os.W_OK):
        raise OutputError(f"{option} {path}: that file may not be written; choose another name")
    check_folder(option, path.parent)


def check_folder(option: str, folder: Path | None) -> None:
    """Raise OutputError where the folder, or the nearest one above it that exists, cannot take a new entry."""
    if folder is None:
        return
    existing = folder
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir():
        raise OutputError(f"{option} {folder}: {existing} is a file, not a folder; choose another place")
    try:
        durable.try_folder(existing)
    except OSError as error:
        raise OutputError(f"{option} {folder}: cannot be written ({error.strerror}); choose another place") from error


def tried_file(_context: object, parameter: Any, path: Path | None) -> Path | None:
    """`check_file` as the callback of a command-line option, which runs before the verb; returns the path."""
    check_file(parameter.opts[-1], path)
    return path


def tried_folder(_context: object, parameter: Any, path: Path | None) -> Path | None:
    """`check_folder` as the callback of a command-line option."""
    check_folder(parameter.opts[-1], path)
    return path


def tried_picture(context: object, parameter: Any, path: Path | None) -> Path | None:
    """`tried_file` for a figure, whose suffix must be one of PICTURES."""
    if path is not None and path.suffix.lower() not in PICTURES:
        raise OutputError(f"{parameter.opts[-1]} {path}: no known kind of picture; end the name in .png, .pdf or .svg")
    return tried_file(context, parameter, path)


def tried_model(context: object, parameter: Any, path: Path | None) -> Path | None:
    """`tried_file` for a model or manoeuvre, whose suffix must be .toml."""
    if path is not None and path.suffix.lower() != ".toml":
        raise OutputError(f"{parameter.opts[-1]} {path}: it is written as TOML; end the name in .toml")
    return tried_file(context, parameter, path)
