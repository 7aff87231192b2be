"""What stood under a name stands there, or the new content does, and nothing beside it: whatever ends the writing."""

import errno
import multiprocessing
import os
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest

from daq.utilities import durable
from daq.utilities.durable import (
    clear_leftovers,
    open_log,
    replacing,
    replacing_folder,
    whole,
    whole_text,
    write_bytes,
    write_text,
)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_the_hidden_file_is_in_the_same_folder_and_no_glob_of_recordings_sees_it(tmp_path: Path) -> None:
    with whole(tmp_path / "a.mcap") as new:
        new.write_bytes(b"x")
        assert new.parent == tmp_path
        assert new.name.startswith(".")
        assert list(tmp_path.rglob("*.mcap")) == []
    assert names(tmp_path) == ["a.mcap"]


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "x"), KeyboardInterrupt(), SystemExit(3), ValueError()])
def test_what_fails_leaves_the_old_content_and_nothing_beside_it(tmp_path: Path, error: BaseException) -> None:
    path = tmp_path / "result.csv"
    path.write_text("old")
    with pytest.raises(type(error)), whole_text(path) as file:
        file.write("half")
        raise error
    assert path.read_text() == "old"
    assert names(tmp_path) == ["result.csv"]


@pytest.mark.parametrize("call", ["fsync", "rename"])
def test_a_disk_that_fails_at_the_last_moment_is_named_with_the_file_that_was_meant(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    path = tmp_path / "result.json"
    write_text(path, "old")

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "a story of Arrow about bytes")

    monkeypatch.setattr(*((os, "fsync") if call == "fsync" else (Path, "replace")), full)
    with pytest.raises(OSError, match="No space left on device") as caught:
        write_text(path, "new")
    assert caught.value.filename == str(path)
    assert path.read_text() == "old"
    assert names(tmp_path) == ["result.json"]


def _write_often(path: Path, letter: str) -> None:
    for _ in range(100):
        write_bytes(path, letter.encode() * 5000)


def test_two_writers_of_one_name_both_succeed_and_one_content_stands(tmp_path: Path) -> None:
    path = tmp_path / "same.toml"
    context = multiprocessing.get_context("fork")
    writers = [context.Process(target=_write_often, args=(path, letter)) for letter in "ab"]
    for w in writers:
        w.start()
    for w in writers:
        w.join()
    assert [w.exitcode for w in writers] == [0, 0]
    assert path.read_bytes() in (b"a" * 5000, b"b" * 5000)
    assert names(tmp_path) == ["same.toml"]


CHILD = """
import sys, time
from pathlib import Path
from daq.utilities.durable import whole
with whole(Path(sys.argv[1])) as new:
    new.write_text("half")
    print("writing", flush=True)
    time.sleep(60)
"""


def _killed_while_writing(path: Path, how: signal.Signals) -> None:
    child = subprocess.Popen([sys.executable, "-c", CHILD, str(path)], stdout=subprocess.PIPE)
    assert child.stdout is not None
    child.stdout.readline()
    child.send_signal(how)
    child.wait()
    child.stdout.close()


def test_what_a_killed_process_has_left_is_cleared_by_the_next_writer_in_the_folder(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_text("old")
    _killed_while_writing(path, signal.SIGKILL)
    assert path.read_text() == "old"
    assert len(names(tmp_path)) == 2
    write_text(tmp_path / "other.csv", "x")
    assert names(tmp_path) == ["a.mcap", "other.csv"]


def test_what_a_living_process_writes_is_left_alone(tmp_path: Path) -> None:
    with whole(tmp_path / "a") as new:
        new.write_text("half")
        child = subprocess.run(
            [sys.executable, "-c", f"from daq.utilities.durable import *; clear_leftovers(Path({str(tmp_path)!r}))"],
            check=True,
        )
        assert child.returncode == 0
        assert new.exists()
    assert (tmp_path / "a").read_text() == "half"


def test_a_number_that_was_given_again_does_not_save_a_leftover_for_ever(tmp_path: Path) -> None:
    left = tmp_path / f".a.csv.{os.getppid()}.0011aabb{durable.ENDING}"
    left.write_text("x")
    clear_leftovers(tmp_path)
    assert left.exists()
    os.utime(left, (time.time() - 7200,) * 2)
    clear_leftovers(tmp_path)
    assert not left.exists()


def test_a_link_stays_and_what_it_leads_to_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "file").write_text("old")
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "there" / "file")
    write_text(link, "new")
    assert link.is_symlink()
    assert (tmp_path / "there" / "file").read_text() == "new"


def test_a_pipe_takes_it_as_it_comes(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", "from daq.utilities.durable import *; write_text(Path('/dev/stdout'), 'hello')"],
        capture_output=True,
        check=True,
    )
    assert done.stdout == b"hello"


def test_the_mode_of_the_old_file_stays_and_a_new_one_follows_the_umask(tmp_path: Path) -> None:
    path = tmp_path / "a"
    before = os.umask(0o027)
    try:
        write_text(path, "x")
        assert stat.S_IMODE(path.stat().st_mode) == 0o640
        path.chmod(0o600)
        write_text(path, "y")
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
    finally:
        os.umask(before)


def test_the_longest_name_that_a_folder_takes_can_be_written(tmp_path: Path) -> None:
    path = tmp_path / ("ä" * 125 + ".csv")
    write_text(path, "x")
    assert names(tmp_path) == [path.name]


def test_a_folder_is_replaced_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "aircraft"
    path.mkdir()
    (path / "old.xml").write_text("old")
    with pytest.raises(OSError, match="No space"), replacing_folder(path) as new:
        (new / "new.xml").write_text("half")
        raise OSError(errno.ENOSPC, "No space left on device")
    assert names(path) == ["old.xml"]
    with replacing_folder(path) as new:
        (new / "new.xml").write_text("new")
    assert names(path) == ["new.xml"]
    assert names(tmp_path) == ["aircraft"]


def test_a_log_grows_at_its_end_and_makes_its_folder(tmp_path: Path) -> None:
    for word in (b"a", b"b"):
        with open_log(tmp_path / "deep" / "x.log") as file:
            file.write(word)
    assert (tmp_path / "deep" / "x.log").read_bytes() == b"ab"


def test_replacing_waits_for_nobody(tmp_path: Path) -> None:
    with replacing(tmp_path / "a") as one, replacing(tmp_path / "a") as two:
        assert one != two
        one.write_text("1")
        two.write_text("2")
    assert (tmp_path / "a").read_text() == "1"


def test_the_look_whether_a_folder_takes_files_leaves_nothing_even_when_it_is_killed(tmp_path: Path) -> None:
    program = (
        "import os, pathlib\nfrom daq.utilities import durable\nfrom daq.utilities.outputs import check_folder\n"
        "pathlib.Path.unlink = lambda *_, **__: os.kill(os.getpid(), 9)\n"
        f"check_folder('--json', pathlib.Path({str(tmp_path)!r}))\n"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == -9
    assert len(list(tmp_path.iterdir())) == 1
    durable.try_folder(tmp_path)
    assert list(tmp_path.iterdir()) == []
