"""No two files import one another, not even for types or inside a function, through however many others."""

import ast
from collections.abc import Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("daq", "groundstation", "estimation", "firmware_sim", "sideslip")


def modules() -> Mapping[str, Path]:
    """Dotted name -> file of every module of ours."""
    files = [f for p in PACKAGES for f in (ROOT / p).rglob("*.py")]
    return {".".join(f.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): f for f in files}


def imported(tree: ast.AST, known: Mapping[str, Path]) -> Iterator[str]:
    """Modules of ours that a file names in any import."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (a.name for a in node.names if a.name in known)
        elif isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                found = whole if whole in known else node.module
                if found in known:
                    yield found


def refuse_circle(graph: Mapping[str, set[str]]) -> None:
    """AssertionError naming the files of a circle."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def test_no_circle_of_files() -> None:
    known = modules()
    assert len(known) > 300
    trees = {name: ast.parse(file.read_text(encoding="utf-8")) for name, file in known.items()}
    refuse_circle({name: set(imported(tree, known)) - {name} for name, tree in trees.items()})


def test_a_circle_would_be_seen() -> None:
    known = {"a": Path("a.py"), "a.b": Path("a/b.py"), "c": Path("c.py")}
    late = ast.parse("def f():\n    from a import b\n")
    typed = ast.parse("if TYPE_CHECKING:\n    import c\n")
    assert (list(imported(late, known)), list(imported(typed, known))) == (["a.b"], ["c"])
    with pytest.raises(pytest.fail.Exception, match=r"a.b -> c|c -> a.b"):
        refuse_circle({"c": {"a.b"}, "a.b": {"c"}, "a": set()})
