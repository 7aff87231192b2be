"""Extras: the table that errors speak from is what pyproject.toml declares, and every missing package is asked for."""

import re
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

import sideslip as ss
from daq.utilities.packages import EXTRAS, MissingPackageError, extra_of, missing, optional
from tests.support.lowest import lowest
from tests.support.paths import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def declared(extra: str) -> set[str]:
    """Names of packages that an extra brings, those of its other extras too."""
    names = set()
    for text in PROJECT["optional-dependencies"][extra]:
        name = re.split(r"[\[>=<; ]", text, maxsplit=1)[0]
        if name == "sideslip":
            for other in re.search(r"\[(.*?)\]", text).group(1).split(","):  # type: ignore[union-attr]
                names |= declared(other)
        else:
            names.add(name.lower())
    return names


@pytest.mark.parametrize("extra", EXTRAS)
def test_every_module_of_the_table_comes_with_its_extra(extra: str) -> None:
    homes = packages_distributions()
    brought = declared(extra)
    indirect = {"markupsafe": "jinja2", "dask": "distributed", "rerun_cli": "rerun-sdk"}
    for module in EXTRAS[extra]:
        packages = {p.lower().replace("_", "-") for p in homes.get(module, [module])} | {indirect.get(module, "")}
        assert packages & brought, f"{module} of extra {extra}"


def test_what_flies_needs_no_extra() -> None:
    base = {re.split(r"[>=<]", text)[0] for text in PROJECT["dependencies"]}
    assert not base & {"pymavlink", "scipy", "torch", "casadi", "rerun-sdk", "matplotlib", "pyarrow"}
    assert "torch" not in declared("estimation")


def test_a_missing_package_is_one_sentence_with_the_command(monkeypatch: pytest.MonkeyPatch) -> None:
    assert extra_of("torch.nn") == "ngn"
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingPackageError, match=r"needs the package 'pandas'.*pip install 'sideslip\[notebook\]'"):
        optional("pandas", "a table")
    with pytest.raises(ImportError):
        optional("pandas", "a table")
    flight = ss.open(ROOT / "recordings" / "cdfp_ld1.mcap")
    with pytest.raises(MissingPackageError, match="notebook"):
        flight.to_pandas()


def test_a_file_that_hides_ours_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hiding = tmp_path / "estimation.py"
    hiding.write_text("")
    module = type(sys)("estimation")
    module.__file__ = str(hiding)
    monkeypatch.setitem(sys.modules, "estimation", module)
    error = ModuleNotFoundError("No module named 'estimation.answers'", name="estimation.answers")
    assert str(hiding) in str(missing(error))


def test_the_lowest_versions_are_those_declared() -> None:
    rows = list(lowest(ROOT / "pyproject.toml"))
    assert "click==8.1" in rows
    assert any(row.startswith("torch==") for row in rows)
    assert not any(row.startswith(("pytest", "ruff", "sideslip")) for row in rows)
