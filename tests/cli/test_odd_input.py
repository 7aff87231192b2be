"""Odd inputs and unwritable outputs at the command line: one sentence, exit status 2, no traceback."""

from pathlib import Path

import numpy as np
import pytest

import sideslip
from tests.support.paths import ROOT

FOREIGN = ROOT / "recordings" / "foreign" / "ordinary_0.csv"


def ended(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[object, str]:
    with pytest.raises(SystemExit) as exit_:
        sideslip.main(arguments)
    return exit_.value.code, capsys.readouterr().err.strip()


@pytest.mark.parametrize("result", ["file/result.json", "folder"])
@pytest.mark.parametrize("verb", [["info"], ["import", "-o", "flight.mcap"]], ids=["info", "import"])
def test_result_that_cannot_be_written_is_named(
    verb: list[str], result: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("in the way", encoding="utf-8")
    Path("folder").mkdir()
    code, said = ended([*verb, str(FOREIGN), "--json", result], capsys)
    assert code == 2
    assert said.startswith(f"sideslip: --json {result.split('/', maxsplit=1)[0]}")
    assert "\n" not in said


@pytest.mark.parametrize(
    ("name", "arguments", "words"),
    [
        ("empty.tlog", ["info"], "empty"),
        ("empty.rrd", ["view", "--view", "none", "--duration", "0.1"], "not a recording of rerun"),
    ],
)
def test_empty_file_is_no_success(
    name: str, arguments: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name).write_bytes(b"")
    code, said = ended([*arguments, str(tmp_path / name)], capsys)
    assert code == 2
    assert words in said


def test_one_row_without_a_time_does_not_stop_the_import(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = FOREIGN.read_text(encoding="utf-8").splitlines()
    lines[6] = "nan," + lines[6].split(",", 1)[1]
    source = tmp_path / "log.csv"
    source.write_text("\n".join(lines), encoding="utf-8")
    code, _ = ended(["import", str(source), "-o", str(tmp_path / "flight.csv")], capsys)
    assert code == 0
    time = np.genfromtxt(tmp_path / "flight.csv", delimiter=",", names=True)["time"]
    assert time.size == len(lines) - 2
