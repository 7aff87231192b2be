"""The command line at its edge: verbs, help, exit statuses, and nothing heavy imported for light work."""

import subprocess
import sys
from pathlib import Path

import pytest

import sideslip
from sideslip.cli import VERBS


def run(*arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "sideslip", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=100, cwd=cwd, check=False)


@pytest.mark.parametrize("verb", list(VERBS))
def test_every_verb_has_help_with_an_example(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        sideslip.main([verb, "--help"])
    assert ended.value.code == 0
    assert f"sideslip {verb}" in capsys.readouterr().out.split("Usage", 1)[1].split("Example", 1)[1]


@pytest.mark.parametrize("module", ["daq.logger", "daq.commands", "sideslip"])
def test_light_modules_import_nothing_heavy(module: str) -> None:
    heavy = "torch casadi rerun matplotlib scipy pyarrow"
    code = f"import sys, {module}; print([m for m in {heavy.split()!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(
    "arguments",
    [
        ("estimate", "none.csv"),
        ("check", "none.csv"),
        ("match", "none.toml", "none.csv"),
        ("frequency", "none.csv", "--input", "delta_a", "--output", "p"),
        ("gap", "none.csv"),
        ("view", "none.mcap", "--view", "none"),
        ("calibrate", "none.mcap", "-o", "out.mcap"),
        ("import", "none.csv", "-o", "out.mcap"),
        ("info", "none.mcap"),
        ("verify", "none.mcap"),
        ("recover", "none.mcap", "-o", "out.mcap"),
        ("record", "none.toml"),
        ("preflight", "none.toml"),
        ("ground", "none.toml"),
        ("fly", "none.toml"),
        ("fly", "no_such_scenario"),
    ],
    ids=" ".join,
)
def test_missing_input_is_one_sentence_and_status_2(
    arguments: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        sideslip.main(list(arguments))
    said = capsys.readouterr().err.strip()
    assert ended.value.code == 2, said
    assert said
    assert "Traceback" not in said
    assert len(said.splitlines()) == 1, said


def test_unknown_verb_and_option_are_status_2() -> None:
    for arguments in (("flap",), ("estimate", "--flap")):
        done = run(*arguments)
        assert done.returncode == 2
        assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [
        (("estimat", "x.csv"), "did you mean 'sideslip estimate'? See"),
        (("chek",), "did you mean 'sideslip check'?"),
        (("rec",), "did you mean 'sideslip record' or 'sideslip recover' or 'sideslip reconstruct'?"),
        (("Import",), "did you mean 'sideslip import'"),
        (("log.csv",), "it is a file: did you mean 'sideslip info log.csv'?"),
        (("info", "log.ulg"), "log.ulg: damaged ULog"),
        (("calibrate", "log.csv", "-o", "out.mcap"), "sideslip import"),
        (("estimate", "log.csv"), "sideslip import"),
        (("estimate", "none.csv", "--model", "latral"), "did you mean lateral?"),
        (("estimate", "none.csv", "--method", "mll"), "method 'mll' is unknown"),
        (("gap", "none.csv", "--model", "latral"), "did you mean lateral?"),
        (("gap", "none.csv", "--effects", "none.toml"), "effects none.toml: no such file"),
        (("match", "none.toml", "none.csv"), "none.toml: no such file"),
    ],
    ids=" ".join,
)
def test_what_is_mistyped_is_said_before_any_work_with_what_was_meant(
    arguments: tuple[str, ...],
    meant: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "log.csv").write_text("Timestamp;x\n1;2\n")
    (tmp_path / "log.ulg").write_bytes(b"ULog\x01\x12\x35\x01")
    with pytest.raises(SystemExit) as ended:
        sideslip.main(list(arguments))
    said = capsys.readouterr().err.strip()
    assert ended.value.code == 2
    assert meant in said
    assert len(said.splitlines()) == 1


def test_a_word_like_no_verb_is_not_guessed_at(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        sideslip.main(["flap"])
    assert "did you mean" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("typed", "completed"), [("sideslip est", "plain,estimate"), ("sideslip check --js", "plain,--json")]
)
def test_the_shell_completes_verbs_and_options(
    typed: str, completed: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("_SIDESLIP_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", typed)
    monkeypatch.setenv("COMP_CWORD", str(len(typed.split()) - 1))
    with pytest.raises(SystemExit) as ended:
        sideslip.main([])
    assert ended.value.code == 0
    assert capsys.readouterr().out.splitlines() == [completed]


def test_truncated_recording_and_wrong_columns_are_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "cut.mcap").write_bytes(b"\x89MCAP0\r\n\x01\x00")
    (tmp_path / "wrong.csv").write_text("time,speed\n0,1\n0.05,1\n0.1,1\n")
    for arguments, word in (
        (("estimate", "cut.mcap"), "cut.mcap"),
        (("estimate", "wrong.csv", "--aircraft", "cdfp"), "beta"),
    ):
        done = run(*arguments, cwd=tmp_path)
        assert done.returncode == 2
        assert word in done.stderr
        assert len(done.stderr.strip().splitlines()) == 1


def test_malformed_configuration_names_the_key(tmp_path: Path) -> None:
    (tmp_path / "ground.toml").write_text('[view]\nlayout = "huge"\n')
    done = run("ground", "ground.toml", cwd=tmp_path)
    assert done.returncode == 2
    assert "view.layout" in done.stderr


def test_busy_port_is_one_sentence(tmp_path: Path) -> None:
    import socket

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        (tmp_path / "ground.toml").write_text(f'[link]\nports = ["udpin:{port}"]\n[output]\ndirectory = "o"\n')
        done = run("ground", "ground.toml", "--duration", "1", cwd=tmp_path)
    assert done.returncode == 2
    assert str(port) in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
