"""Every verb that writes looks at where it is to write before it reads or computes anything."""

from pathlib import Path

import pytest

import sideslip

NOWHERE = "/proc/no/such.json"
VERBS = [
    ["info", "none.mcap"],
    ["verify", "none.mcap"],
    ["recover", "none.mcap", "-o", "out.mcap"],
    ["preflight", "none.toml"],
    ["record", "none.toml"],
    ["fly", "nominal", "--out", "out"],
    ["ground", "none.toml"],
    ["calibrate", "none.mcap", "-o", "out.mcap"],
    ["import", "none.csv", "-o", "out.mcap"],
    ["bench", "none.mcap", "--plan", "none.toml", "-o", "out"],
    ["check", "none.mcap"],
    ["estimate", "none.mcap"],
    ["match", "none.toml", "none.mcap"],
    ["frequency", "none.mcap", "--input", "delta_a", "--output", "p"],
    ["gap", "none.mcap"],
    ["campaign", "none.mcap", "--out", "out"],
    ["aircraft", "check", "cdfp"],
]
PLACES = [
    ["recover", "none.mcap", "-o", NOWHERE],
    ["calibrate", "none.mcap", "-o", NOWHERE],
    ["import", "none.csv", "-o", NOWHERE],
    ["bench", "none.mcap", "--plan", "none.toml", "-o", NOWHERE],
    ["fly", "nominal", "--out", NOWHERE],
    ["demo", "--out", NOWHERE],
    ["ground", "none.toml", "--out", NOWHERE],
    ["check", "none.mcap", "--write", NOWHERE],
    ["check", "none.mcap", "--report", NOWHERE],
    ["estimate", "none.mcap", "--report", NOWHERE],
    ["estimate", "none.mcap", "--save-model", "/proc/no/model.toml"],
    ["match", "none.toml", "none.mcap", "--figure", "/proc/no/such.png"],
    ["gap", "none.mcap", "--report", NOWHERE],
    ["campaign", "none.mcap", "--out", NOWHERE],
    ["aircraft", "new", "glider", "-o", "/proc/no/glider.toml"],
]


@pytest.mark.parametrize("words", [[*v, "--json", NOWHERE] for v in VERBS] + PLACES, ids=" ".join)
def test_a_place_that_cannot_be_written_is_refused_at_once(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The inputs do not exist either: were they looked at first, the sentence would be about them."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        sideslip.main(words)
    said = capsys.readouterr().err
    assert ended.value.code == 2
    assert "/proc/no" in said
    assert "cannot be written" in said
    assert len(said.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []
