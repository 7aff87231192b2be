"""The files and commands that a page of docs/ tells its reader to write and run."""

import re
from pathlib import Path

_BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def files_of(page: Path) -> dict[str, str]:
    """Path -> content of every code block whose first line is a comment that names a file."""
    found = {}
    for _, body in _BLOCK.findall(page.read_text(encoding="utf-8")):
        named = re.match(r"# ([\w./-]+\.\w+)\n", body)
        if named:
            found[named[1]] = body
    return found


def commands_of(page: Path) -> list[str]:
    """Every line after a `$ ` in the page's console blocks, in order."""
    return commands_in(page.read_text(encoding="utf-8"))


def commands_in(text: str) -> list[str]:
    """The same of a page's text, or of some of its sections."""
    blocks = [body for kind, body in _BLOCK.findall(text) if kind == "console"]
    return [line[2:].split("  #")[0].strip() for body in blocks for line in body.splitlines() if line.startswith("$ ")]


def write_files(files: dict[str, str], folder: Path) -> None:
    """Write the files below `folder`, as a reader would."""
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
