"""The lowest version of everything that the extras of users name, as constraints for pip: `make lowest`."""

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

from packaging.requirements import Requirement

TOOLS = ("dev", "study")
"""Extras whose versions are no promise to anybody."""


def lowest(project: Path) -> Iterator[str]:
    """`name==version` for each requirement that states a lowest one."""
    table = tomllib.loads(project.read_text(encoding="utf-8"))["project"]
    extras = table["optional-dependencies"]
    texts = [*table["dependencies"], *(t for name, listed in extras.items() if name not in TOOLS for t in listed)]
    for text in dict.fromkeys(texts):
        requirement = Requirement(text)
        bound = re.search(r">=([^,]+)", str(requirement.specifier))
        if bound is not None:
            yield f"{requirement.name}=={bound.group(1)}"


if __name__ == "__main__":
    print("\n".join(lowest(Path(__file__).parents[2] / "pyproject.toml")))
