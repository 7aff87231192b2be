"""The user's own Python, named as `module:NAME`: imported from the working directory or the path, its mistakes reported."""

import importlib
import sys
from pathlib import Path

from estimation.errors import EstimationError

MISTAKES = (
    ImportError, SyntaxError, NameError, AttributeError, TypeError, ValueError, KeyError, IndexError, ZeroDivisionError,
)  # fmt: skip
"""What a mistake in the user's module or class raises."""


def import_named(text: str, what: str, example: str, error: type[EstimationError] = EstimationError) -> object:
    """The object that `module:NAME` names.

    what: first words of the error's sentence; example: how such a name is written. Raises `error` where there is no such object
    or its module cannot be imported.
    """
    module_name, _, name = text.partition(":")
    if not all(part.isidentifier() for part in (*module_name.split("."), name)):
        raise error(f"{what}: write it as {example}")
    folder = str(Path.cwd())
    inserted = folder not in sys.path
    if inserted:
        sys.path.insert(0, folder)
    try:
        module = importlib.import_module(module_name)
    except MISTAKES as mistake:
        raise error(f"{what}: cannot import {module_name}: {mistake_text(mistake)}") from mistake
    finally:
        if inserted:
            sys.path.remove(folder)
    if not hasattr(module, name):
        raise error(f"{what}: {module_name} has no {name!r}")
    return getattr(module, name)


def mistake_text(error: Exception) -> str:
    """An error of the user's Python text, with its line where that is known."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    place = (
        f" (line {error.lineno})" if isinstance(error, SyntaxError) else f" (line {trace.tb_lineno})" if trace else ""
    )
    return f"{type(error).__name__}: {error}{place if not isinstance(error, ImportError) else ''}"
