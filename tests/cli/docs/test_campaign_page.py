"""The questions on the page of campaigns are asked of a real data set, and its columns are those there are."""

import re
import runpy
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from estimation.campaign.schema import GROUPS, RESULTS
from tests.cli.docs.blocks import files_of, write_files
from tests.unit.estimation.campaign.running import ROOT, environment

PAGE = ROOT / "docs" / "campaign.md"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where a reader stands: the examples, and a campaign of three flights, one of which is no flight."""
    place = tmp_path_factory.mktemp("reader")
    write_files(files_of(PAGE), place)
    flights = [str(ROOT / "recordings" / "foreign" / f"ordinary_{i}.csv") for i in range(2)]
    (place / "empty.csv").write_text("")
    words = [
        *flights,
        "empty.csv",
        "--aircraft",
        "cdfp",
        "--method",
        "ls",
        "--out",
        "campaign",
        "--serial",
        "--no-report",
    ]
    command = [sys.executable, "-m", "sideslip", "campaign", *words]
    done = subprocess.run(command, cwd=place, env=environment(), capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stderr
    assert "empty" in done.stdout
    return place


def asked(folder: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> dict[str, object]:
    monkeypatch.chdir(folder)
    return runpy.run_path(name)


def test_with_duckdb(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = asked(folder, "with_duckdb.py", monkeypatch)["scatter"]
    assert isinstance(rows, list)
    assert {"Cl_p", "Cn_r"} <= {r[0] for r in rows}
    assert {r[2] for r in rows} == {2}


def test_with_pandas(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = asked(folder, "with_pandas.py", monkeypatch)
    assert found["failed"].flight.tolist() == ["empty"]  # type: ignore[attr-defined]
    assert found["over_alpha"].alpha.is_monotonic_increasing  # type: ignore[attr-defined]
    assert len(found["over_alpha"]) == 2  # type: ignore[arg-type]


def test_with_polars(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = asked(folder, "with_polars.py", monkeypatch)
    r2 = found["worst"]["r2"].to_list()  # type: ignore[index]
    assert r2 == sorted(r2)
    assert len(r2) == 10
    assert isinstance(found["groups"], list)


def test_the_page_names_every_column_there_is(folder: Path) -> None:
    table = PAGE.read_text(encoding="utf-8").partition("### Columns of the results")[2].partition("### Rows")[0]
    named = {n for row in re.findall(r"^\| (.*?) \|", table, flags=re.M) for n in re.findall(r"`(\w+)`", row)}
    assert named == set(RESULTS)
    assert pq.read_schema(next((folder / "campaign" / "results").iterdir())).names == list(RESULTS)
    assert pq.read_schema(folder / "campaign" / "groups" / "groups.parquet").names == list(GROUPS)
