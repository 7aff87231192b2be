"""Compiled libraries are kept between processes, and what a cut or a full disk leaves of one, or no home, stops no estimate."""

import ctypes
from pathlib import Path

import pytest

from estimation.engine import compiled_library
from estimation.engine.compiled_library import compiler, library_made

SOURCE = "int seven(void) { return 7; }\n"


def seven() -> int | None:
    """What the library says; None where there is none. As a process that has not opened it before."""
    compiled_library._open.cache_clear()
    library = library_made(lambda: SOURCE, SOURCE)
    return None if library is None else int(library.seven())


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file of a library that was made."""
    if compiler() is None:
        pytest.skip("no C compiler here")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert seven() == 7
    (made,) = tmp_path.rglob("*.so")
    assert list(made.parent.iterdir()) == [made]
    return made


@pytest.mark.parametrize("rest", [0, 1, 70, 4096, -1])
@pytest.mark.parametrize("filled", [False, True])
def test_a_library_cut_short_is_made_anew(rest: int, filled: bool, kept: Path) -> None:
    sound = kept.read_bytes()
    kept.unlink()  # it is mapped: a new file has the spoilt bytes
    kept.write_bytes(sound[:rest].ljust(len(sound) if filled else 0, b"\0"))
    assert seven() == 7
    assert kept.read_bytes() == sound


def test_one_made_by_an_earlier_process_is_taken_without_a_compiler(
    kept: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SIDESLIP_COMPILER", "none")
    assert seven() == 7
    kept.unlink()
    assert seven() is None


def test_a_folder_that_holds_no_programs_is_done_without(kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(path: str) -> None:
        raise OSError(f"{path}: failed to map segment from shared object")

    monkeypatch.setattr(ctypes, "CDLL", refused)
    assert seven() is None


@pytest.mark.parametrize("home", ["none", "", "here", "/dev/null"])
def test_a_user_without_a_home_is_done_without(home: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.chdir(tmp_path)

    def nobody() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", nobody if home == "none" else lambda: Path(home))
    assert seven() is None
    assert list(tmp_path.iterdir()) == []


def test_no_place_for_temporary_files_is_done_without(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise FileNotFoundError(2, "No usable temporary directory found in ['/tmp']")

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(compiled_library, "TemporaryDirectory", full)
    assert seven() is None
