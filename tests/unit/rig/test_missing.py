"""Where the rig cannot run it says what to do, and that is no failure."""

import shutil

import pytest

from tests.rig import __main__ as rig


def test_what_is_missing_is_named_with_the_way_to_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None if name.startswith("qemu") else f"/usr/bin/{name}")
    monkeypatch.setattr("sys.argv", ["rig"])
    assert rig.main() == 0
    said = capsys.readouterr().out
    assert "skipped: qemu-system-x86_64 not found; apt-get install" in said
    assert "debootstrap, " not in said


def test_a_user_who_is_not_root_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: f"/usr/bin/{name}")
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    assert "be root" in rig.missing()
