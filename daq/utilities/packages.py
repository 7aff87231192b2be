"""Packages that come with an extra: which extra, and one sentence where one is missing."""

import importlib
import importlib.util
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from daq.utilities.errors import UserError

EXTRAS: Mapping[str, tuple[str, ...]] = {
    "estimation": ("casadi", "jinja2", "markupsafe", "matplotlib", "rich", "scipy", "threadpoolctl", "tomli_w"),
    "ground": ("foxglove_schemas_protobuf", "h5py", "mcap_protobuf", "mcap_ros2", "pymavlink", "pyulog", "rerun", "rerun_cli"),
    "ngn": ("torch",),
    "campaign": ("aiohttp", "dask", "distributed", "fsspec"),
    "jsbsim": ("jsbsim",),
    "notebook": ("pandas", "xarray"),
    "parquet": ("pyarrow",),
}  # fmt: skip
"""Extra -> modules, for the smallest extra that brings them. pyproject.toml declares them by the names of their packages."""

OURS = ("daq", "groundstation", "estimation", "firmware_sim", "sideslip")


class MissingPackageError(UserError, ImportError):
    """A package of an extra that is not installed, or a file of somebody else's that hides one of ours."""


def extra_of(module: str) -> str | None:
    """The extra that brings a module; None where none does."""
    root = module.partition(".")[0]
    return next((extra for extra, modules in EXTRAS.items() if root in modules), None)


def installed(modules: Iterable[str]) -> bool:
    """Whether all of these modules can be found, without importing them."""
    return all(importlib.util.find_spec(module) is not None for module in modules)


def missing(error: ImportError, what: str = "this") -> MissingPackageError:
    """The sentence for a module that could not be imported. what: needs it."""
    module = error.name or str(error)
    root, extra = module.partition(".")[0], extra_of(module)
    if root in OURS:
        hiding = getattr(importlib.import_module(root), "__file__", None) or "a folder of this name"
        place = Path(hiding).parent if Path(hiding).name == "__init__.py" else Path(hiding)
        return MissingPackageError(
            f"{place} hides Sideslip's own package {root!r}; rename it, or start in another folder", name=module
        )
    if root in sys.stdlib_module_names:
        return MissingPackageError(
            f"{what} needs {root!r}, which Python has not got on this system; run it on Linux", name=module
        )
    if extra is None:
        return MissingPackageError(
            f"{what} needs the package {root!r}, which is not installed; pip install {root}", name=module
        )
    text = f"{what} needs the package {root!r}, which is not installed; pip install 'sideslip[{extra}]'"
    return MissingPackageError(text, name=module)


def optional(module: str, what: str) -> Any:
    """A module of an extra. what: needs it. Raises MissingPackageError, one sentence with the command, where it is missing."""
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise missing(error, what) from error
