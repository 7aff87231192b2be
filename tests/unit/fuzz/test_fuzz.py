"""Whatever the bytes of a file: a result or one sentence, within ten seconds of processor time and 500 MB.

A small part of `python -m tests.unit.fuzz.study`, always the same, and every input that once did harm.
"""

import os
from pathlib import Path

import pytest

from tests.unit.fuzz.kept import Kept, kept
from tests.unit.fuzz.kinds import KINDS
from tests.unit.fuzz.study import run_case

SEED = 7

pytestmark = pytest.mark.filterwarnings("default")  # the fence judges warnings itself: they would reach the terminal


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("name", list(KINDS))
def test_sound_inputs_are_read(name: str, tmp_path: Path) -> None:
    """The inputs that are spoilt are sound: a study of refusals alone would prove nothing."""
    kind = KINDS[name]
    answers = [run_case(kind, data, reader, tmp_path) for data in kind.inputs() for reader in kind.readers]
    assert not [a.fault for a in answers if a.fault]
    assert any(a.status == 0 for a in answers)


@pytest.mark.parametrize("name", KINDS)
def test_spoilt_inputs_are_answered(name: str, tmp_path: Path) -> None:
    kind = KINDS[name]
    faults = []
    for number in range(kind.quick):
        data, reader = kind.case(SEED, number)
        answer = run_case(kind, data, reader, tmp_path)
        if answer.fault:
            faults.append((number, answer.fault))
    assert not faults


def _case(case: Kept, tmp_path: Path) -> None:
    kind = KINDS[case.kind]
    data = case.data()
    for reader in kind.readers:
        answer = run_case(kind, data, reader, tmp_path)
        assert not answer.fault, (answer.fault, answer.said)


@pytest.mark.parametrize("kind", list(dict.fromkeys(case.kind for case in kept())))
def test_inputs_that_once_did_harm_are_answered(kind: str, tmp_path: Path) -> None:
    for case in kept():
        if case.kind == kind and not case.large:
            _case(case, tmp_path)


@pytest.mark.study
@pytest.mark.timeout(0)
@pytest.mark.parametrize("case", [c for c in kept() if c.large], ids=lambda c: f"{c.kind}: {c.what}")
def test_largest_inputs_are_answered(case: Kept, tmp_path: Path) -> None:
    _case(case, tmp_path)


@pytest.mark.parametrize("kind", ["csv", "parquet", "ulog", "dataflash", "tlog", "mapping", "logger", "ground", "scenario",
                                  "bench plan", "aircraft", "model", "effects", "signing key", "recording"])  # fmt: skip
@pytest.mark.parametrize("place", ["folder", "pipe", "device", "loop", "absent", "forbidden"])
def test_names_that_are_no_files_are_answered(kind: str, place: str, tmp_path: Path) -> None:
    """A folder, a pipe that nobody writes, /dev/zero, a loop of links, nothing, and a file that may not be read."""
    entry = KINDS[kind]
    path = tmp_path / f"case{entry.suffix}"
    match place:
        case "folder":
            path.mkdir()
        case "pipe":
            os.mkfifo(path)
        case "device":
            path.symlink_to("/dev/zero")
        case "loop":
            path.symlink_to(path)
        case "forbidden":
            path.write_bytes(b"\xff\0")  # root may read it all the same
            path.chmod(0)
    from tests.unit.fuzz.fence import answered

    for reader in entry.readers:
        (tmp_path / "scratch").mkdir(exist_ok=True)
        answer = answered(lambda reader=reader: reader(path, tmp_path / "scratch"))  # type: ignore[misc]
        assert not answer.fault, answer.fault
        assert answer.status in (1, 2)
