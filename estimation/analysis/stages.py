"""Stages of an analysis, stored in its folder under a key of all their inputs: a rerun repeats those whose inputs changed."""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from daq.utilities.durable import write_text

FOLDER = "stages"


def digest(content: object) -> str:
    """SHA-256 of JSON-able content; other objects count by their text."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()


@dataclass(frozen=True)
class Stage:
    """content: result of the stage; key: digest of its inputs; repeated: whether this run did it."""

    content: Mapping[str, Any]
    key: str
    repeated: bool


@dataclass(frozen=True)
class Stages:
    """folder: of the analysis. software: its version, part of every key."""

    folder: Path
    software: str

    def path(self, name: str) -> Path:
        """A file of a stage."""
        return self.folder / FOLDER / name

    def run(self, name: str, inputs: object, work: Callable[[], Mapping[str, Any]], *files: Path) -> Stage:
        """The stage as stored, where its key is the same and its files exist; else the result of `work`, which is stored."""
        key = digest([self.software, name, inputs])
        stored = self._stored(name)
        if stored.get("key") == key and isinstance(stored.get("content"), Mapping) and all(f.is_file() for f in files):
            return Stage(stored["content"], key, False)
        content = work()
        self.path(name).parent.mkdir(parents=True, exist_ok=True)
        write_text(self.path(f"{name}.json"), json.dumps({"key": key, "content": content}, default=str))
        return Stage(content, key, True)

    def _stored(self, name: str) -> Mapping[str, Any]:
        try:
            stored = json.loads(self.path(f"{name}.json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {}  # not done yet, or cut off while it was written
        return stored if isinstance(stored, Mapping) else {}
