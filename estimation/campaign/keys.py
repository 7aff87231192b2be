"""Keys by content: what decides a number enters, and nothing else does. Names, paths and order stay out."""

import hashlib
import json
from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from estimation.engine.compiled_library import compiler

LIBRARIES = ("sideslip", "casadi", "numpy", "scipy")
ROOT = Path(__file__).parents[2]
DECIDING = (
    "estimation/aircraft",
    "estimation/campaign/workers/subjects.py",
    "estimation/campaign/workers/work.py",
    "estimation/compatibility",
    "estimation/engine",
    "estimation/estimators",
    "estimation/models",
    "estimation/session",
    "estimation/signals",
    "groundstation/flight",
    "daq/contract/channel_rows.py",
)
"""Our own files that decide a number: a checkout changes them without another version."""
SOURCES = (".py", ".c", ".toml")


@cache
def versions() -> Mapping[str, str]:
    """Version of each library that decides a number, the compiler of the equations (without one, sums are made in another order:
    1e-12 of a number), and a digest of our own deciding files as `code`."""
    libraries = {name: _version(name) for name in LIBRARIES}
    return {**libraries, "compiler": Path(compiler() or "none").name, "code": digest_of_files(DECIDING)}


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"


def digest_of_files(places: tuple[str, ...], root: Path = ROOT) -> str:
    """First 16 digits of the SHA-256 over names and bytes of the source files in `places`."""
    digest = hashlib.sha256()
    for place in places:
        path = root / place
        files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.suffix in SOURCES)
        for file in files:
            digest.update(file.relative_to(root).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def key_of(*content: Any) -> str:
    """SHA-256 over JSON-able content."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def seed_of(*content: Any) -> int:
    """A seed from content, so that another flight in the campaign changes no draw of this one."""
    return int(key_of("seed", *content)[:15], 16)
