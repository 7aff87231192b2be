"""Recordings offered to the ground: odd dates, odd files, links, very many of them, and nothing of it in the scan loop."""

import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from daq.telemetry import log_files
from daq.telemetry.log_files import MAX_FILES, LogFiles
from daq.telemetry.log_server import LISTING_VALID_NS, LogServer
from daq.telemetry.send_queue import item
from daq.telemetry.worker import Worker
from daq.transport.mavlink_codec import message_types

Fields = dict[str, object]


class Served:
    """A log server and what it says, decoded."""

    def __init__(self, *folders: Path) -> None:
        self.now_ns = 0
        self.server = LogServer(folders, lambda: self.now_ns)

    def all(self) -> list[Fields]:
        """Messages until there is nothing more to do; the worker works in real time."""
        out: list[Fields] = []
        deadline = time.monotonic() + 60.0
        while self.server.busy and time.monotonic() < deadline:
            made = self.server.next_item()
            if made is None:
                time.sleep(0.0005)
            else:
                out.append(dict(message_types()[made.msg_id].unpack(made.payload)))
        assert not self.server.busy
        return out

    def list(self, first: int = 0, last: int = 0xFFFF) -> list[Fields]:
        self.server.request_list(first, last)
        return self.all()

    def fetch(self, number: int) -> bytes:
        self.server.request_data(number, 0, 0xFFFFFFFF)
        return b"".join(bytes(m["data"][: m["count"]]) for m in self.all())  # type: ignore[index,arg-type]


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    (tmp_path / "recordings").mkdir()
    made = Served(tmp_path / "recordings")
    yield made
    made.server.close()


def put(path: Path, content: bytes = b"content", time_s: float = 1e9) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    os.utime(path, (time_s, time_s))
    return path


def test_dates_before_1970_and_after_2106_are_told_as_near_as_can_be(served: Served, tmp_path: Path) -> None:
    for name, seconds in (("a", -31_536_000.0), ("b", 7_258_118_400.0), ("c", 1e9)):
        put(tmp_path / f"recordings/{name}.mcap", time_s=seconds)
    assert [e["time_utc"] for e in served.list()] == [0, 2**32 - 1, 10**9]


def test_links_that_lead_out_are_neither_listed_nor_served(served: Served, tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    secret = put(tmp_path / "elsewhere/secret.mcap", b"secret")
    put(folder / "s/b.mcap")
    (folder / "a.mcap").symlink_to(secret)
    (folder / "directory").symlink_to(secret.parent)
    (folder / "d.mcap").symlink_to("nowhere")
    (folder / "e.mcap").symlink_to("e.mcap")
    (folder / "f.mcap").symlink_to(folder / "s/b.mcap")
    entries = served.list()
    assert [(e["id"], e["num_logs"], e["size"]) for e in entries] == [(1, 2, 7), (2, 2, 7)], "b, and f that is b"
    assert [served.fetch(n) for n in (1, 2, 3)] == [b"content", b"content", b""]


def test_a_file_that_becomes_a_link_after_it_was_listed_is_not_served(served: Served, tmp_path: Path) -> None:
    secret = put(tmp_path / "elsewhere/a.mcap", b"secret")
    path = put(tmp_path / "recordings/s/a.mcap")
    assert len(served.list()) == 1
    path.unlink()
    path.symlink_to(secret)
    assert served.fetch(1) == b""
    path.unlink()
    path.parent.rmdir()
    path.parent.symlink_to(secret.parent)
    assert served.fetch(1) == b""
    served.now_ns += LISTING_VALID_NS
    (answer,) = served.list()
    assert (answer["num_logs"], answer["id"]) == (0, 0)


def test_pipes_and_devices_are_not_opened(served: Served, tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    path = put(folder / "a.mcap")
    os.mkfifo(folder / "b.mcap")
    (folder / "c.mcap").mkdir()
    assert [e["num_logs"] for e in served.list()] == [1]
    path.unlink()
    os.mkfifo(path)
    assert served.fetch(1) == b"", "nobody writes into it: to open it would last for ever"


def test_a_configured_directory_may_itself_be_a_link(tmp_path: Path) -> None:
    put(tmp_path / "card/a.mcap")
    (tmp_path / "recordings").symlink_to(tmp_path / "card")
    served = Served(tmp_path / "recordings")
    assert len(served.list()) == 1
    assert served.fetch(1) == b"content"
    served.server.close()


@pytest.mark.study
def test_more_files_than_there_are_ids(served: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log_files, "_PAUSE_S", 0.0)
    folder = tmp_path / "recordings"
    files = put(folder / "000000.mcap"), put(folder / "000001.mcap")  # one may have 65,000 names
    for n in range(2, 70_000):
        os.link(files[n % 2], folder / f"{n:06d}.mcap")
    entries = served.list(65_530, 0xFFFF)
    assert [e["id"] for e in entries] == list(range(65_530, 65_536))
    assert {(e["num_logs"], e["last_log_num"]) for e in entries} == {(65_535, 65_535)}
    assert LogFiles([folder], lambda: True).listing() == ()


def test_of_more_files_than_are_offered_the_newest_by_name_are(
    served: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert item("LOG_ENTRY", id=MAX_FILES, num_logs=MAX_FILES, last_log_num=MAX_FILES).payload[-6:] == b"\xff" * 6
    monkeypatch.setattr(log_files, "MAX_FILES", 3)
    for name in "abcde":
        put(tmp_path / f"recordings/{name}.mcap", name.encode())
    assert len(served.list()) == 3
    assert [served.fetch(n) for n in (1, 2, 3, 4)] == [b"c", b"d", b"e", b""]


def test_ids_stay_what_they_were_when_files_come_and_go(served: Served, tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    put(folder / "b.mcap", b"b")
    put(folder / "c.mcap", b"c")
    assert [e["id"] for e in served.list()] == [1, 2]
    put(folder / "a.mcap", b"a")
    (folder / "b.mcap").unlink()
    assert [e["id"] for e in served.list()] == [1, 2], "asked again at once, the last listing is told again"
    served.now_ns += LISTING_VALID_NS
    assert [(e["id"], e["num_logs"]) for e in served.list()] == [(2, 2), (3, 2)]
    assert served.fetch(3) == b"a"


def test_however_often_it_is_asked_the_card_is_looked_at_once(
    served: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put(tmp_path / "recordings/a.mcap")
    looked: list[int] = []
    begin = threading.Event()
    real = LogFiles.listing

    def listing(files: LogFiles) -> object:
        looked.append(threading.get_ident())
        assert begin.wait(20.0)
        return real(files)

    monkeypatch.setattr(LogFiles, "listing", listing)
    for _ in range(1000):
        served.server.request_list(0, 0xFFFF)
        assert served.server.next_item() is None
    begin.set()
    assert len(served.all()) == 1
    assert len(looked) == 1
    assert threading.get_ident() not in looked


def test_many_requests_for_data_leave_one_reading_under_way(
    served: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put(tmp_path / "recordings/a.mcap", bytes(range(200)))
    reads: list[int] = []
    real = LogFiles.read

    def read(files: LogFiles, number: int, offset: int, size: int) -> bytes:
        reads.append(offset)
        time.sleep(0.02)
        return real(files, number, offset, size)

    monkeypatch.setattr(LogFiles, "read", read)
    for offset in range(100):
        served.server.request_data(1, offset, 90)
        served.server.next_item()
    (last,) = served.all()
    assert (last["ofs"], bytes(last["data"])) == (99, bytes(range(99, 189)))  # type: ignore[arg-type]
    assert len(reads) <= 3


def test_offsets_at_the_end_of_their_range_end_the_log(served: Served, tmp_path: Path) -> None:
    put(tmp_path / "recordings/a.mcap")
    served.server.request_data(1, 2**32 - 1, 2**32 - 1)
    (end,) = served.all()
    assert (end["ofs"], end["count"]) == (2**32 - 1, 0)


def test_closing_ends_a_long_listing(served: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for n in range(300):
        put(tmp_path / f"recordings/{n}.mcap")
    monkeypatch.setattr(log_files, "_PAUSE_S", 0.01)
    monkeypatch.setattr(log_files, "_PAUSE_EVERY", 1)
    served.server.request_list(0, 0xFFFF)
    served.server.next_item()
    thread = served.server._worker._thread
    served.server.close()
    assert thread is not None
    assert not thread.is_alive()


def test_a_worker_takes_no_more_jobs_than_it_has_room_for_and_does_them_in_order() -> None:
    begin, done = threading.Event(), []
    worker = Worker("test", capacity=3)
    jobs = [worker.submit(lambda n=n: (begin.wait(20.0), done.append(n), n)[-1]) for n in range(5)]
    assert [j is None for j in jobs] == [False, False, False, True, True]
    assert worker.busy
    begin.set()
    assert [j.result(20.0) for j in jobs if j is not None] == done == [0, 1, 2]
    assert not worker.busy
    failing = worker.submit(os.stat, "/nowhere/at/all")
    assert failing is not None
    assert isinstance(failing.exception(20.0), FileNotFoundError)
    assert worker.close(20.0)


def test_closing_a_worker_gives_up_what_waits_and_does_not_wait_for_a_card_that_hangs() -> None:
    began, hung = threading.Event(), threading.Event()
    worker = Worker("test", capacity=2)
    first, second = worker.submit(lambda: (began.set(), hung.wait(20.0))[1]), worker.submit(hung.wait, 20.0)
    assert began.wait(20.0)
    assert worker.close(0.01) is False
    assert second is not None
    assert second.cancelled()
    hung.set()
    assert first is not None
    assert first.result(20.0)
