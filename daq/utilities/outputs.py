"""Files that verbs are asked to write: looked at before any work is done, and written in one step.

So that no result is lost at the end for a name that cannot be written, and no reader finds half a file.
"""

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
"""Endings of pictures that figures are written as."""


class OutputError(UserError):
    """A file or folder that cannot be written."""


def write_json(data: object, path: Path) -> None:
    """Write JSON, replacing the file in one step; folders are made. A number that is not finite is written as null."""
    write_text(json.dumps(_finite(data), indent=1, ensure_ascii=False, allow_nan=False) + "\n", path)


def write_text(text: str, path: Path) -> None:
    """Write a text file whole or not at all, synced; folders are made. Raises OutputError where that is not possible."""
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
    """Raise OutputError naming the option whose file could not be written. None: not asked for."""
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
    """`check_file` as the callback of a command-line option: so it is tried before the verb begins."""
    check_file(parameter.opts[-1], path)
    return path


def tried_folder(_context: object, parameter: Any, path: Path | None) -> Path | None:
    """`check_folder` as the callback of a command-line option."""
    check_folder(parameter.opts[-1], path)
    return path


def tried_picture(context: object, parameter: Any, path: Path | None) -> Path | None:
    """`tried_file` of a figure, whose ending says what kind of picture it is."""
    if path is not None and path.suffix.lower() not in PICTURES:
        raise OutputError(f"{parameter.opts[-1]} {path}: no known kind of picture; end the name in .png, .pdf or .svg")
    return tried_file(context, parameter, path)


def tried_model(context: object, parameter: Any, path: Path | None) -> Path | None:
    """`tried_file` of a model or manoeuvre."""
    if path is not None and path.suffix.lower() != ".toml":
        raise OutputError(f"{parameter.opts[-1]} {path}: it is written as TOML; end the name in .toml")
    return tried_file(context, parameter, path)
