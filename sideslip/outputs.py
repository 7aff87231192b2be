"""What verbs write and say while they work."""

import json
import sys
from pathlib import Path
from typing import Any

import click


def write_json(path: Path | None, content: dict[str, Any]) -> None:
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


class Bar:
    """Progress on a terminal as a bar, in a log as plain lines at every quarter."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._live = sys.stderr.isatty()
        self._next = 0.0

    def __enter__(self) -> "Bar":
        return self

    def __exit__(self, *_: object) -> None:
        if self._live:
            click.echo("\r" + " " * 72 + "\r", nl=False, err=True)

    def __call__(self, share: float) -> None:
        share = min(share, 1.0)
        if share < self._next:
            return
        if self._live:
            self._next = 2.0 if share >= 1.0 else share + 0.02
            full = round(30 * share)
            click.echo(f"\r{self._title:<30} [{'#' * full}{'.' * (30 - full)}]", nl=False, err=True)
        else:
            self._next = 2.0 if share >= 1.0 else 0.5 * (int(2 * share) + 1)
            click.echo(f"{self._title}: {100 * share:.0f} %", err=True)
