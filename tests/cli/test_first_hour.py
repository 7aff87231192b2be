"""What a newcomer meets: the greeting, help, doctor, completion, what to do next, --quiet, and colours on a terminal alone."""

import json
import os
import pty
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import sideslip
from groundstation.flight import Flight, Provenance, write_flight
from sideslip.cli import VERBS
from sideslip.first_hour import AFTER_A_FAILED_CHECK, NEXT, next_line
from tests.support.paths import RECORDINGS

RAW = str(RECORDINGS / "cdfp_ld3_raw.mcap")
HELPERS = {"help", "completion"}
SAY_IT_THEMSELVES = {"estimate", "ground", "info"}


def run(words: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as ended:
        sideslip.main(words)
    out, err = capsys.readouterr()
    return int(ended.value.code or 0), out, err


def test_alone_it_greets_and_every_command_of_the_greeting_exists(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, err = run([], capsys)
    assert (status, err) == (0, "")
    commands = [line.split()[1] for line in out.splitlines() if line.startswith("  sideslip ")]
    assert len(commands) == 3
    assert {*commands} <= {*VERBS}
    assert len(out.splitlines()) < 12


def test_help_of_a_verb_is_its_help_and_a_mistyped_one_is_answered(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["help", "match"], capsys)[1] == run(["match", "--help"], capsys)[1]
    assert "Commands:" in run(["help"], capsys)[1]
    status, _, err = run(["help", "estimat"], capsys)
    assert status == 2
    assert "did you mean 'sideslip estimate'" in err


def test_the_next_step_names_the_checked_aircraft_wherever_it_stands() -> None:
    expected = "sideslip estimate FLIGHT --aircraft glider.toml"
    assert next_line(["aircraft", "check", "glider.toml"], failed=False) == expected
    assert next_line(["aircraft", "check", "--json", "a.json", "glider.toml"], failed=False) == expected
    assert next_line(["aircraft", "check", "glider.toml", "--json", "a.json"], failed=False) == expected
    assert next_line(["aircraft"], failed=False).endswith("AIRCRAFT.toml")


def test_doctor_names_every_extra_and_what_it_lacks(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("daq.utilities.packages.installed", lambda modules: "torch" not in modules)
    monkeypatch.setattr("sideslip.verbs.doctor.installed", lambda modules: "torch" not in modules)
    status, out, _ = run(["doctor", "--json", str(tmp_path / "d.json")], capsys)
    assert status == 0
    assert "lacks torch; pip install 'sideslip[ngn]'" in out
    assert re.search(r"estimation +installed: casadi \d", out)
    assert re.search(r"ground +installed: .*rerun \d", out)
    facts = json.loads((tmp_path / "d.json").read_text())
    assert facts["extras"]["ngn"] == ["torch"]
    assert facts["extras"]["estimation"] == []
    assert facts["cores"] >= 1


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_prints_what_the_shell_reads(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    _, out, _ = run(["completion", shell], capsys)
    assert "_SIDESLIP_COMPLETE" in out


def test_the_printed_completion_completes_a_verb() -> None:
    script = f'eval "$({sys.executable} -m sideslip completion bash)"; COMP_WORDS=(sideslip est); COMP_CWORD=1; '
    script += f'sideslip() {{ {sys.executable} -m sideslip "$@"; }}; export -f sideslip; '
    script += f"COMP_WORDS='sideslip est' COMP_CWORD=1 _SIDESLIP_COMPLETE=bash_complete {Path(sys.executable).parent}/sideslip"
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout.split() == ["plain,estimate"]


@pytest.mark.parametrize(
    ("ground", "segments"),
    [("", ""), ("[ground]\nbefore_s = 5.0\nlaunch_s = 20\nafter_s = 4.0\n", " --segments 25:65")],
)
def test_after_a_simulated_flight_only_what_forces_flew_is_estimated(
    ground: str, segments: str, tmp_path: Path
) -> None:
    (tmp_path / "scenario.toml").write_text(f"[flight]\nduration_s = 40.0\n{ground}")
    line = next_line(["fly", "quiet", "--out", str(tmp_path)], failed=False)
    assert line == f"sideslip estimate {tmp_path}/flight.mcap{segments}"


def test_after_a_flight_the_next_step_names_where_it_went(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("quiet", "bench_faces"):
        Path("flights", name).mkdir(parents=True)
    Path("flights/bench_faces/plan.toml").touch()
    assert next_line(["fly", "--list"], failed=False) == "sideslip fly NAME"
    assert next_line(["fly", "quiet"], failed=False) == "sideslip estimate flights/quiet/flight.mcap"
    bench = next_line(["fly", "bench_faces"], failed=False)
    assert bench == "sideslip bench flights/bench_faces/onboard --plan flights/bench_faces/plan.toml -o calibration"
    assert next_line(["fly", "quiet", "--port", "udp:h:1", "--out", "f"], failed=False).endswith(
        "f/onboard -o flight.mcap"
    )


def test_after_the_gap_workflow_the_model_found_is_named(tmp_path: Path) -> None:
    words = ["gap", "a.mcap", "--report", str(tmp_path)]
    assert next_line(words, failed=False) == f"open {tmp_path}/index.html: its first screen says what to fly"
    (tmp_path / "models").mkdir()
    for name in ("lateral", "lateral+Cn_da"):
        (tmp_path / "models" / f"{name}.toml").touch()
    assert next_line(words, failed=False).startswith(f"sideslip match {tmp_path}/models/lateral+Cn_da.toml FLIGHT")
    assert "--report" in next_line(["gap", "a.mcap"], failed=False)


def test_every_verb_says_what_to_do_next_and_quiet_does_not(capsys: pytest.CaptureFixture[str]) -> None:
    assert {*NEXT} == {*VERBS} - HELPERS - SAY_IT_THEMSELVES
    assert {*AFTER_A_FAILED_CHECK} <= {*VERBS}
    status, _, err = run(["verify", RAW], capsys)
    assert (status, err) == (0, f"next: sideslip calibrate {RAW} -o flight.mcap\n")
    for words in (["--quiet", "verify", RAW], ["verify", "--quiet", RAW]):
        assert run(words, capsys)[2] == ""
    assert next_line(["calibrate", RAW, "-o", "a.mcap"], failed=False).startswith("sideslip check a.mcap")
    assert next_line(["verify", RAW], failed=True) == f"sideslip recover {RAW} -o recovered.mcap"
    assert next_line(["verify", "--help"], failed=False) == ""
    assert next_line(["aircraft", "new", "glider"], failed=False) == ""
    assert next_line(["aircraft", "check", "cdfp"], failed=False) == "sideslip estimate FLIGHT --aircraft cdfp"
    assert "missing" in next_line(["aircraft", "check", RAW], failed=True)
    drafted = next_line(["import", RAW, "--draft-map", "-o", "map.toml"], failed=False)
    assert drafted.endswith(f"then sideslip import {RAW} --map map.toml -o flight.mcap")
    assert (
        next_line(["check", "--aircraft", RAW, "my.mcap"], failed=False) == f"sideslip estimate FLIGHT --aircraft {RAW}"
    )
    held = next_line(["match", "lateral", RAW], failed=True)
    assert held.startswith(f"sideslip gap {RAW} --model lateral,")
    assert next_line(["watch", RAW], failed=True) == ""
    assert "alarm" in next_line(["watch", RAW], failed=False)
    assert "report" not in next_line(["campaign", "a.mcap", "--no-report", "--out", "c"], failed=False)
    right = next_line(["check", RAW, "--write", "right"], failed=False)
    assert right == f"sideslip estimate right/{Path(RAW).stem}.mcap"


@pytest.mark.parametrize(("aircraft", "words"), [("", " --aircraft AIRCRAFT.toml"), ("cdfp", "")])
def test_the_next_step_names_the_aircraft_that_an_estimate_needs(aircraft: str, words: str, tmp_path: Path) -> None:
    file = tmp_path / "a.mcap"
    time = np.arange(40) / 20
    write_flight(
        Flight.build("a", time, {"p": np.sin(time)}, provenance=Provenance(source="imported", aircraft=aircraft)), file
    )
    assert next_line(["check", str(file)], failed=False) == f"sideslip estimate {file}{words}"
    assert next_line(["frequency", str(file), "--aircraft", "mine.toml"], failed=False).endswith("--aircraft mine.toml")


def test_info_names_the_one_step_that_suits_the_file(capsys: pytest.CaptureFixture[str]) -> None:
    flight = str(RECORDINGS / "cdfp_ld3.mcap")
    for file, step in (
        (RAW, f"sideslip calibrate {RAW} -o flight.mcap"),
        (flight, f"sideslip check {flight}"),
    ):
        assert run(["info", file], capsys)[2] == f"next: {step}\n"
        assert run(["--quiet", "info", file], capsys)[2] == ""


def test_colours_stand_on_a_terminal_and_not_in_a_pipe(tmp_path: Path) -> None:
    flight = RECORDINGS / "cdfp_ld3.mcap"
    command = [sys.executable, "-m", "sideslip", "--quiet", "check", str(flight)]
    environment = {k: v for k, v in os.environ.items() if k not in ("NO_COLOR", "TERM")} | {"TERM": "xterm-256color"}
    piped = subprocess.run(command, capture_output=True, env=environment, timeout=120, check=False).stdout
    assert b"\x1b" not in piped
    ours, theirs = pty.openpty()
    with subprocess.Popen(command, stdout=theirs, stderr=subprocess.DEVNULL, env=environment) as process:
        os.close(theirs)
        shown = b""
        while True:
            try:
                block = os.read(ours, 65536)
            except OSError:
                break
            if not block:
                break
            shown += block
    os.close(ours)
    assert process.returncode in (0, 1)
    assert b"\x1b[" in shown
