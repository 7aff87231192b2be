"""Estimators by name; one more is one file, in a package of somebody's own."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from estimation.errors import EstimationError
from estimation.estimators import registry
from estimation.estimators.estimator import Estimator, Extra, Extras
from estimation.estimators.registry import built_in, check_extras, estimator_names, find_estimator, listed_words
from groundstation.flight import Flight, write_flight
from sideslip.verbs.estimate import estimate
from tests.support.paths import ROOT

PAGE = (ROOT / "docs" / "estimators.md").read_text()
OWN = PAGE.split("```python\n# half_fit.py\n")[1].split("```")[0]
POINT = PAGE.split('```toml\n[project.entry-points."sideslip.estimators"]\n')[1].split("```")[0].replace('"', "")


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A folder as pip would leave it: the estimator of the documentation in a package, and what that tells of itself."""
    folder = tmp_path / "site"
    (folder / "half_fit").mkdir(parents=True)
    (folder / "half_fit" / "__init__.py").write_text(OWN)
    told = folder / "half_fit-1.0.dist-info"
    told.mkdir()
    (told / "METADATA").write_text("Metadata-Version: 2.1\nName: half-fit\nVersion: 1.0\n")
    (told / "entry_points.txt").write_text(f"[sideslip.estimators]\n{POINT}")
    return folder


@pytest.fixture
def installed(package: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The package among the installed ones of this process."""
    monkeypatch.syspath_prepend(package)
    registry._installed.cache_clear()
    yield package
    registry._installed.cache_clear()
    for name in ("half_fit", "twice"):
        sys.modules.pop(name, None)


def sideslip(*arguments: object, path: Path | None = None, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """The command as a process of its own, with `path` among the installed packages."""
    there = os.pathsep.join(str(p) for p in (ROOT, path) if p is not None)
    return subprocess.run(
        [sys.executable, "-c", "import sideslip; sideslip.main()", *(str(a) for a in arguments)],
        env={**os.environ, "PYTHONPATH": there},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        cwd=cwd,
    )


def test_names_and_titles() -> None:
    assert tuple(built_in()) == ("ml", "fem", "fem-noise", "ml-frequency", "ngn", "ngn-improved", "ls", "live")
    assert all(e.title and e.look is not None for e in built_in().values())
    assert estimator_names(Extra.STEPWISE) == ("ls",)
    with pytest.raises(
        EstimationError,
        match=r"method 'guess' is unknown; known are ml, fem, fem-noise, ml-frequency, ngn, ngn-improved, ls",
    ):
        find_estimator("guess")


def test_every_estimator_has_its_section_in_the_docs() -> None:
    assert [n for n in built_in() if f"\n## `{n}`" not in PAGE] == []


def test_extras_that_nobody_chosen_heeds_are_refused() -> None:
    check_extras(Extras(stepwise=True).asked, [find_estimator("ml"), find_estimator("ls")])
    with pytest.raises(EstimationError, match="--stepwise is for method ls: add ls to --method"):
        check_extras(Extras(stepwise=True).asked, [find_estimator("ml")])
    with pytest.raises(
        EstimationError, match="--raw-inputs is for methods ml, fem, fem-noise, ml-frequency and ls: add ml to --method"
    ):
        check_extras(Extras(raw_inputs=True).asked, [find_estimator("ngn")])
    assert [listed_words(w) for w in (["a"], ["a", "b"], ["a", "b", "c"])] == ["a", "a and b", "a, b and c"]


@pytest.mark.usefixtures("installed", "unwritten_figures")
def test_an_estimator_of_a_package_of_ones_own(made_flights: list[Flight], tmp_path: Path) -> None:
    """Its numbers in the terminal, the JSON and every table of the page, whose figures are drawn in other tests."""
    write_flight(made_flights[0], tmp_path / "ld.csv")
    words = [
        str(tmp_path / "ld.csv"), "--aircraft", "cdfp", "--method", "ls,own", "--joint", "--raw-inputs",
        "--json", str(tmp_path / "e.json"), "--report", str(tmp_path / "page"),
    ]  # fmt: skip
    out = CliRunner().invoke(estimate, words, standalone_mode=False, catch_exceptions=False)
    assert out.return_value == 0
    assert "warning" not in out.output.lower()
    assert "ld (601 samples), own: solved" in out.output
    data = json.loads((tmp_path / "e.json").read_text())
    for methods in (data["flights"][0]["methods"], data["joint"]):
        assert list(methods) == ["ls", "own"]
        for name, e in methods["own"]["parameters"].items():
            assert e["estimate"] == pytest.approx(0.5 * methods["ls"]["parameters"][name]["estimate"])
    page = (tmp_path / "page" / "index.html").read_text()
    assert "methods: ls, own" in page
    table = (tmp_path / "page" / "tables" / "estimates_ld.csv").read_text().splitlines()[0]
    assert "own" in table


def test_a_package_of_ones_own_is_offered_by_the_command(package: Path) -> None:
    told = sideslip("estimate", "--help", path=package)
    assert "live, own;" in " ".join(told.stdout.split())


def test_an_estimator_that_is_not_installed(made_flights: list[Flight], tmp_path: Path) -> None:
    write_flight(made_flights[0], tmp_path / "ld.csv")
    (tmp_path / "half_fit.py").write_text(OWN)
    out = sideslip(
        "estimate", "ld.csv", "--aircraft", "cdfp", "--json", "e.json", "--method", "half_fit:OWN", cwd=tmp_path
    )
    assert (out.returncode, out.stderr) == (0, "")
    assert list(json.loads((tmp_path / "e.json").read_text())["flights"][0]["methods"]) == ["own"]
    out = sideslip("estimate", "ld.csv", "--aircraft", "cdfp", "--method", "half_fit:none", cwd=tmp_path)
    assert (out.returncode, out.stderr) == (2, "sideslip: method 'half_fit:none': half_fit has no 'none'\n")


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("half_fit:fit", "is function, not an estimation.Estimator"),
        ("x y:z", "write it as module:NAME"),
        ("twice:OWN", "the name is taken"),
    ],
)
def test_names_of_modules_that_do_not_fit(installed: Path, name: str, why: str) -> None:
    (installed / "twice.py").write_text(OWN.replace('"own", "half', '"ml", "half'))
    with pytest.raises(EstimationError, match=why):
        find_estimator(name)


@pytest.mark.parametrize(
    ("point", "why"),
    [
        ("ml = half_fit:OWN", "the name is taken"),
        ("own = half_fit:OWEN", "cannot be loaded"),
        ("own = half_fit:fit", "is function, not an estimation.Estimator"),
        ("other = half_fit:OWN", "calls itself 'own'"),
    ],
)
def test_packages_that_do_not_fit(installed: Path, point: str, why: str) -> None:
    (installed / "half_fit-1.0.dist-info" / "entry_points.txt").write_text(f"[sideslip.estimators]\n{point}\n")
    registry._installed.cache_clear()
    with pytest.raises(EstimationError, match=why):
        find_estimator(point.split(maxsplit=1)[0])
    assert find_estimator("fem").name == "fem"  # the others go on working


def test_an_estimator_is_a_plain_record() -> None:
    assert find_estimator("ml").fit_each is None
    assert find_estimator("ngn").fit_each is not None
    assert isinstance(find_estimator("ls"), Estimator)
