"""An import contract that lists what a package may import; everything else of ours and of third parties is refused.

import-linter ships deny-lists and layers: with those, a room built tomorrow may be imported by everybody until somebody
thinks of forbidding it.
"""

import sys
from typing import Any

from grimp import ImportGraph
from importlinter import Contract, ContractCheck, fields, output


class AllowListContract(Contract):
    """`source_module` and what lies below it import, outside themselves, only `allowed_modules` and what lies below these.

    The standard library is always allowed.
    """

    type_name = "allow_list"

    source_module = fields.StringField()
    allowed_modules = fields.SetField(subfield=fields.StringField())

    def check(self, graph: ImportGraph, verbose: bool) -> ContractCheck:
        """Every import across the border that no entry of the list covers."""
        source = str(self.source_module)
        allowed: set[str] = {source, *self.allowed_modules}  # type: ignore[misc]
        inside = {source} | graph.find_descendants(source)
        broken = sorted(
            (importer, imported)
            for importer in inside
            for imported in graph.find_modules_directly_imported_by(importer)
            if imported.split(".")[0] not in sys.stdlib_module_names and not _covered(imported, allowed)
        )
        return ContractCheck(kept=not broken, metadata={"broken": broken})

    def render_broken_contract(self, check: ContractCheck) -> None:
        """One line for each import that is not on the list."""
        for importer, imported in check.metadata["broken"]:
            output.print_error(f"{importer} imports {imported}, which is not on the list of {self.source_module}")


def _covered(module: str, allowed: set[str]) -> bool:
    parts = module.split(".")
    return any(".".join(parts[:n]) in allowed for n in range(1, len(parts) + 1))


def configuration(pyproject: dict[str, Any]) -> list[dict[str, Any]]:
    """The contracts as `pyproject.toml` holds them."""
    return list(pyproject["tool"]["importlinter"]["contracts"])
