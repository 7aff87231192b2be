"""The card that forgets: its rules, first as a model, then as a mounted file system that programs use."""

import errno
import os
import stat
from pathlib import Path

import pytest

from tests.chain.card.forgetting import CUTS, PAGE, SECTOR, Cut, ForgettingFiles, Inode, Metadata, Pages
from tests.chain.card.mounted import MountedCard
from tests.chain.card.troubles import Troubles

NOTHING = CUTS[0]
NAMES_ONLY = CUTS[1]
TORN = next(c for c in CUTS if c.torn and c.pages is Pages.KEPT)


def make(files: ForgettingFiles, path: str, data: bytes = b"") -> Inode:
    inode = files.make(path, stat.S_IFREG | 0o644)
    files.write(inode, data, 0)
    return inode


def secure(files: ForgettingFiles, path: str) -> None:
    """Sync a file and the directory it is in."""
    files.sync_file(files.find(path))
    files.sync_directory(files.find(str(Path(path).parent)))


def left(files: ForgettingFiles, cut: Cut, seed: int = 0) -> dict[str, bytes]:
    return dict(files.survivors(cut, seed).files())


def test_data_needs_a_sync_and_a_name_another() -> None:
    files = ForgettingFiles()
    make(files, "/a", b"x" * 10)
    assert left(files, NOTHING) == {}
    files.sync_file(files.find("/a"))
    assert left(files, NOTHING) == {}, "the name is not on the medium"
    files.sync_directory(files.find("/"))
    assert left(files, NOTHING) == {"/a": b"x" * 10}


def test_a_name_may_come_before_its_data() -> None:
    files = ForgettingFiles()
    make(files, "/a", b"x" * 10)
    assert left(files, NAMES_ONLY) == {"/a": bytes(10)}


def test_a_file_is_lost_with_the_directory_it_is_in() -> None:
    files = ForgettingFiles()
    files.make("/d", stat.S_IFDIR | 0o755)
    make(files, "/d/a", b"x")
    secure(files, "/d/a")
    assert left(files, NOTHING) == {}
    files.sync_directory(files.find("/"))
    assert left(files, NOTHING) == {"/d/": b"", "/d/a": b"x"}


def test_rename_is_whole_or_not_at_all_and_may_come_before_the_data() -> None:
    files = ForgettingFiles()
    make(files, "/state", b"old")
    secure(files, "/state")
    make(files, "/state.new", b"new")
    files.rename("/state.new", "/state")
    assert left(files, NOTHING) == {"/state": b"old"}
    assert left(files, NAMES_ONLY) == {"/state": bytes(3)}, "the well-known empty file"
    seen = {left(files, CUTS[2], seed).get("/state") for seed in range(40)}
    assert seen <= {b"old", bytes(3), b""}
    assert len(seen) == 3


def test_removal_may_be_forgotten() -> None:
    files = ForgettingFiles()
    make(files, "/a", b"x")
    secure(files, "/a")
    files.remove("/a")
    assert left(files, NOTHING) == {"/a": b"x"}
    files.sync_directory(files.find("/"))
    assert left(files, NOTHING) == {}


def test_pages_come_in_any_order_and_only_the_unsynced_are_in_doubt() -> None:
    files = ForgettingFiles()
    make(files, "/a", b"s" * (4 * PAGE))
    secure(files, "/a")
    files.write(files.find("/a"), b"n" * (8 * PAGE), 4 * PAGE)
    patterns = set()
    for seed in range(30):
        data = left(files, CUTS[3], seed)["/a"]
        assert data[: 4 * PAGE] == b"s" * (4 * PAGE)
        assert len(data) == 12 * PAGE
        pages = [data[i : i + PAGE] for i in range(4 * PAGE, 12 * PAGE, PAGE)]
        assert all(p in (b"n" * PAGE, bytes(PAGE)) for p in pages), "a page is there or it is not"
        patterns.add(tuple(p[0] for p in pages))
    assert len(patterns) > 20


def test_the_last_page_is_torn_at_a_sector() -> None:
    files = ForgettingFiles()
    make(files, "/a", b"x" * (3 * PAGE))
    lengths = {len(left(files, TORN, seed)["/a"].rstrip(b"\0")) for seed in range(40)}
    assert lengths <= {2 * PAGE + SECTOR * n for n in range(PAGE // SECTOR)}
    assert len(lengths) > 4


def test_a_file_cut_shorter_and_written_anew() -> None:
    """What "w" does to a state file without a rename: old, empty, or anything between."""
    files = ForgettingFiles()
    make(files, "/a", b"old old")
    secure(files, "/a")
    files.truncate(files.find("/a"), 0)
    files.write(files.find("/a"), b"new", 0)
    assert left(files, NOTHING) == {"/a": b"old old"}
    assert left(files, NAMES_ONLY) == {"/a": bytes(3)}


def test_pages_of_a_failed_sync_never_come() -> None:
    """Linux marks them clean: a later sync that succeeds does not bring them."""
    files = ForgettingFiles()
    make(files, "/a", b"x" * PAGE)
    files.sync_directory(files.find("/"))
    files.sync_fails(files.find("/a"))
    files.write(files.find("/a"), b"y" * PAGE, PAGE)
    files.sync_file(files.find("/a"))
    assert left(files, NOTHING) == {"/a": bytes(PAGE) + b"y" * PAGE}


def test_the_same_seed_is_the_same_cut() -> None:
    files = ForgettingFiles()
    make(files, "/a", bytes(range(256)) * 400)
    for cut in CUTS:
        assert left(files, cut, 5) == left(files, cut, 5)
    assert Metadata.SOME in {c.metadata for c in CUTS}


# --------------------------------------------------------------------------------------------------- as it is mounted


def sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def test_programs_see_what_they_wrote_and_a_cut_takes_it(card: MountedCard, tmp_path: Path) -> None:
    folder = card.path / "folder"
    folder.mkdir()
    (folder / "a").write_bytes(b"a" * 10_000)
    (folder / "b").write_bytes(b"b")
    assert (folder / "a").read_bytes() == b"a" * 10_000
    assert sorted(p.name for p in folder.iterdir()) == ["a", "b"]
    sync(folder / "a")
    sync(folder)
    sync(card.path)
    copy = card.survivors(NOTHING, tmp_path / "copy")
    assert {p.name: p.stat().st_size for p in (copy / "folder").iterdir()} == {"a": 10_000, "b": 0}
    with (folder / "a").open("ab", buffering=0) as held:
        held.write(b"more")
        card.cut(NOTHING)
        with pytest.raises(OSError) as dead:
            held.write(b"and more")
    assert dead.value.errno == errno.EIO
    assert (folder / "a").read_bytes() == b"a" * 10_000
    (folder / "c").write_bytes(b"life goes on")
    assert (folder / "c").read_bytes() == b"life goes on"


def test_the_card_fills_up_and_fails_as_told(card: MountedCard) -> None:
    card.room(10_000)
    with pytest.raises(OSError) as full:
        (card.path / "a").write_bytes(bytes(20_000))
    assert full.value.errno == errno.ENOSPC
    assert os.statvfs(card.path).f_bavail == 0
    card.room(None)
    card.trouble(Troubles(fails={"sync": errno.EIO}))
    with pytest.raises(OSError) as failed:
        sync(card.path / "a")
    assert failed.value.errno == errno.EIO
    card.trouble(Troubles())
    sync(card.path / "a")


def test_the_power_goes_after_so_many_operations(card: MountedCard) -> None:
    card.trip(None)
    (card.path / "a").write_bytes(b"x")
    assert card.trip(1) == 2, "a name and a write"
    with pytest.raises(OSError):
        (card.path / "b").write_bytes(b"x")
    assert (card.path / "b").read_bytes() == b""
