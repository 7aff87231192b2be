"""Stages of an analysis, each kept in its folder under the key of all that went into it: a rerun does what has changed."""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from daq.utilities.durable import write_text

FOLDER = "stages"


def digest(content: object) -> str:
    """Of anything that JSON can say."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()


@dataclass(frozen=True)
class Stage:
    """content: what a stage has found; key: of all that went into it; repeated: whether it was done in this run."""

    content: Mapping[str, Any]
    key: str
    repeated: bool


@dataclass(frozen=True)
class Stages:
    """folder: of the analysis. software: version, on which every key depends."""

    folder: Path
    software: str

    def path(self, name: str) -> Path:
        """A file of a stage."""
        return self.folder / FOLDER / name

    def run(self, name: str, made_of: object, work: Callable[[], Mapping[str, Any]], *files: Path) -> Stage:
        """The content of a stage: as kept where its key is the same and its files are there, else made by `work` and kept."""
        key = digest([self.software, name, made_of])
        stored = self._kept(name)
        if stored.get("key") == key and isinstance(stored.get("content"), Mapping) and all(f.is_file() for f in files):
            return Stage(stored["content"], key, False)
        content = work()
        self.path(name).parent.mkdir(parents=True, exist_ok=True)
        write_text(self.path(f"{name}.json"), json.dumps({"key": key, "content": content}, default=str))
        return Stage(content, key, True)

    def _kept(self, name: str) -> Mapping[str, Any]:
        try:
            stored = json.loads(self.path(f"{name}.json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {}  # not done yet, or cut off: done anew
        return stored if isinstance(stored, Mapping) else {}
