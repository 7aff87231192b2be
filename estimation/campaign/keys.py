"""Keys of finished work: digests of all that affects its numbers, and of nothing else (no names, paths or order)."""

import hashlib
import json
import sys
from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from estimation.engine.compiled_library import compiler
from estimation.estimators.estimator import Estimator

LIBRARIES = ("sideslip", "casadi", "numpy", "scipy", "torch")
ROOT = Path(__file__).parents[2]
SOURCES_OF_RESULTS = (
    "daq/contract/channel_rows.py",
    "daq/contract/channels.py",
    "daq/contract/laboratory.py",
    "daq/contract/recordings",
    "daq/contract/scan.py",
    "daq/contract/seal.py",
    "daq/identification",
    "daq/utilities/constants.py",
    "estimation/aircraft",
    "estimation/campaign/workers/subjects.py",
    "estimation/campaign/workers/work.py",
    "estimation/compatibility",
    "estimation/engine",
    "estimation/estimators",
    "estimation/models",
    "estimation/prepare",
    "estimation/resolve.py",
    "estimation/session",
    "estimation/signals",
    "estimation/threads.py",
    "groundstation/flight",
)
"""Our own files that affect a number: a checkout may change them without a new version.

`estimation/structure` and `estimation/simulation` are not among them: a worker imports both, but tests no structure and attaches
no simulation. The model over the envelope adds `estimation/campaign/aerodynamics` to its key.
"""
SOURCE_SUFFIXES = (".py", ".c", ".toml")


@cache
def versions() -> Mapping[str, str]:
    """Library -> version; `compiler`: the one that compiles the equations; `code`: digest of SOURCES_OF_RESULTS.

    Without a compiler sums are taken in another order, which changes a number by 1e-12.
    """
    libraries = {name: _version(name) for name in LIBRARIES}
    return {**libraries, "compiler": Path(compiler() or "none").name, "code": digest_of_files(SOURCES_OF_RESULTS)}


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
        files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.suffix in SOURCE_SUFFIXES)
        for file in files:
            digest.update(file.relative_to(root).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def digest_of_own_code(estimator: Estimator) -> str:
    """Digest of the file of an estimator that does not come with Sideslip, empty for all others. Modules that it imports do not
    count."""
    module = sys.modules.get(getattr(estimator.fit, "__module__", ""))
    file = getattr(module, "__file__", None)
    if file is None or Path(file).is_relative_to(ROOT / "estimation"):
        return ""
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()[:16]


def key_of(*content: Any) -> str:
    """SHA-256 over JSON-able content."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def seed_of(*content: Any) -> int:
    """A seed from content, so that the random draws of a flight do not depend on the other flights of a campaign."""
    return int(key_of("seed", *content)[:15], 16)
