"""A plan of somebody else: it runs no program unasked, and asks for no more than there is."""

import os
from pathlib import Path

import pytest

import sideslip
from daq.utilities import limits
from estimation.campaign.plan import plan_from, read_plan
from estimation.campaign.sources import entries_of, fetched
from estimation.campaign.tasks import CampaignError

TRAP = "from pathlib import Path\nPath('sprung').write_text('x')\nclass Model: pass\nOWN = 1\n"


@pytest.mark.parametrize("line", ['model = "trap:Model"', 'methods = ["ml", "trap:OWN"]', 'methods = "trap:OWN"'])
def test_a_program_that_a_plan_names_runs_only_when_it_is_trusted(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("trap.py").write_text(TRAP)
    Path("plan.toml").write_text(f'flights = ["none.mcap"]\n{line}\n')
    with pytest.raises(SystemExit) as ended:
        sideslip.main(["campaign", "plan.toml", "--out", "o"])
    said = capsys.readouterr().err
    assert ended.value.code == 2
    assert "trap:" in said
    assert "--trust-code" in said
    assert not Path("sprung").exists()


def test_a_trusted_program_runs_and_that_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("trap2.py").write_text(TRAP)
    Path("plan.toml").write_text('flights = ["none.mcap"]\nmodel = "trap2:Model"\n')
    with pytest.raises(SystemExit):
        sideslip.main(["campaign", "plan.toml", "--out", "o", "--serial", "--trust-code"])
    assert "trap2:Model: a program, which runs because of --trust-code" in capsys.readouterr().err


@pytest.mark.parametrize(
    "text",
    [
        "a" + ".a" * 3000 + " = 1",
        "x = " + "[" * 5000,
        "x = " + "9" * 5000,
        "x = 1" + "#" * 2_000_000,
        "x = '\\ud800'",
        "\0",
    ],
)
def test_a_plan_that_nests_or_swells_is_a_sentence(text: str, tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(text)
    with pytest.raises(CampaignError):
        read_plan(path)


@pytest.mark.parametrize("table", ["/dev/zero", "pipe.csv", "folder.csv"])
def test_a_table_that_is_no_file_is_a_sentence(table: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(CampaignError, match="ordinary file"):
        entries_of(plan_from({"table": table}, "p"), tmp_path)


def test_more_simulated_flights_than_can_be_made_are_refused_at_once(tmp_path: Path) -> None:
    many = [{"scenario": "rich", "count": limits.FLIGHTS}] * 3
    with pytest.raises(CampaignError, match="at most"):
        entries_of(plan_from({"simulate": many}, "p"), tmp_path)


@pytest.mark.parametrize(
    "address",
    [
        "zip://a.csv::https://x/y.zip",
        "simplecache::file:///etc/passwd",
        "python://x",
        "reference://x",
        "dask://h",
        "data://,x",
        "://x",
    ],
)
def test_addresses_of_odd_kinds_are_not_opened(address: str) -> None:
    with pytest.raises(CampaignError):
        fetched(address)


def test_a_flight_whose_name_is_no_text_is_a_flight(tmp_path: Path) -> None:
    name = os.fsdecode(b"fl\xffug.csv")
    (tmp_path / name).write_text("time,p\n0,0\n1,0\n")
    (entry,) = entries_of(plan_from({"flights": [name]}, "p"), tmp_path)
    assert entry.source is not None
    assert entry.name == "fl\\udcffug"
