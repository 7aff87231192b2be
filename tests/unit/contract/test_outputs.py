"""Files that verbs write: tried before any work, written in one step, never half."""

import json
import math
from pathlib import Path

import pytest

from daq.utilities.outputs import OutputError, check_file, check_folder, write_json, write_text


def test_json_replaces_in_one_step_and_makes_its_folder(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b.json"
    write_json({"x": [1.5, math.nan, -math.inf], "y": (True, None, "é")}, path)
    assert json.loads(path.read_text(encoding="utf-8")) == {"x": [1.5, None, None], "y": [True, None, "é"]}
    assert "é" in path.read_text(encoding="utf-8")
    write_json({}, path)
    assert [p.name for p in path.parent.iterdir()] == ["b.json"]


def test_a_result_that_is_no_json_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "b.json"
    path.write_text("old")
    with pytest.raises(TypeError):
        write_json({"x": object()}, path)
    assert path.read_text() == "old"


def test_a_place_that_cannot_be_written_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError, match=r"cannot be written .*; choose another place"):
        write_text("x", tmp_path / "file" / "b.json")
    with pytest.raises(OutputError, match=r"--json .*: that is a folder; give the name of a file"):
        check_file("--json", tmp_path)
    with pytest.raises(OutputError, match="file is a file, not a folder"):
        check_file("--json", tmp_path / "file" / "x" / "b.json")
    with pytest.raises(OutputError, match="--out /proc/x: cannot be written"):
        check_folder("--out", Path("/proc/x"))


def test_what_can_be_written_is_left_as_it_was(tmp_path: Path) -> None:
    check_file("--json", tmp_path / "a" / "b.json")
    check_folder("--out", tmp_path / "new")
    check_file("--json", None)
    check_folder("--out", None)
    assert list(tmp_path.iterdir()) == []
