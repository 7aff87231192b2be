"""`sideslip fly --manoeuvre`: a file through the onboard sequencer, and what is refused before anything flies."""

import json
import math
import re
from collections.abc import Callable
from pathlib import Path

import pytest
import tomli_w

import sideslip
from daq.contract.manoeuvre import Manoeuvre
from daq.contract.recordings.reading import read_recording
from daq.contract.sequencing import Reason, State


def written(path: Path, peak_deg: float = 4.0, seconds: float = 1.0) -> Path:
    """A sine on the rudder."""
    count = round(seconds / 0.02) + 1
    values = tuple(math.radians(peak_deg) * math.sin(2.0 * math.pi * i / (count - 1)) for i in range(count))
    path.write_text(tomli_w.dumps(Manoeuvre("test", 0.02, {"delta_r": values}).to_dict()))
    return path


def scenario(path: Path, duration_s: float = 10.0, more: str = "") -> Path:
    path.write_text(f'[flight]\nduration_s = {duration_s}\nmanoeuvres = "rich"\n{more}')
    return path


def fly(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        sideslip.main(["fly", *map(str, arguments)])
    return int(ended.value.code or 0)


def test_on_a_scenario_without_a_switch_the_pilot_arms_it_in_the_air(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = written(tmp_path / "m.toml")
    summary = tmp_path / "summary.json"
    out = tmp_path / "out"
    assert fly(scenario(tmp_path / "s.toml"), "--manoeuvre", file, "--out", out, "--json", summary) == 0
    said = capsys.readouterr().out
    assert "sequencer running" in said
    assert "flown to its end" in said
    frames = read_recording(out / "onboard").sequencer
    assert any(f.state == State.RUNNING for f in frames)
    assert any(f.reason == Reason.COMPLETE for f in frames)
    assert json.loads(summary.read_text())["scans_lost"] == []


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda text: text.replace("version = 1", "version = 9"), "not a manoeuvre of version 1"),
        (lambda text: re.sub(r" 0\.01\d+", " 0.0017", text, count=1), "its digest does not fit its values"),
        (lambda text: text[: len(text) // 2], "not a TOML file"),
    ],
)
def test_a_file_that_is_not_what_was_designed(
    spoil: Callable[[str], str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = written(tmp_path / "m.toml")
    file.write_text(spoil(file.read_text()))
    assert fly("quiet", "--manoeuvre", file, "--out", tmp_path / "out") == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_flight_too_short_and_an_aircraft_that_must_not(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = written(tmp_path / "m.toml")
    assert fly(scenario(tmp_path / "s.toml", 6.0), "--manoeuvre", file, "--out", tmp_path / "a") == 2
    assert "raise flight.duration_s" in capsys.readouterr().err
    strict = scenario(tmp_path / "t.toml", 20.0, "[logger.sequencer.limits]\nlargest_deg = 3.0\n")
    assert fly(strict, "--manoeuvre", file, "--out", tmp_path / "b") == 2
    assert "sequencer.limits.largest_deg allows 3" in capsys.readouterr().err
    assert not (tmp_path / "b").exists()
