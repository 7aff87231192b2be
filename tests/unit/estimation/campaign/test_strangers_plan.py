"""A plan of somebody else: it runs no program unasked, and asks for no more than there is."""

import contextlib
import io
import os
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import IO, cast

import pytest

import sideslip
from daq.utilities import limits
from estimation.campaign.plan import plan_from, read_plan
from estimation.campaign.sources import _chunks, entries_of, fetched
from estimation.campaign.tasks import CampaignError
from estimation.campaign.workers.subjects import bytes_of

TRAP = "from pathlib import Path\nPath('sprung').write_text('x')\nclass Model: pass\nOWN = 1\n"


@pytest.mark.parametrize("line", ['model = "trap:Model"', 'methods = ["ml", "trap:OWN"]', 'methods = "trap:OWN"'])
def test_a_program_that_a_plan_names_runs_only_when_it_is_trusted(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("trap.py").write_text(TRAP)
    Path("plan.toml").write_text(f'flights = ["none.mcap"]\n{line}\n')
    with pytest.raises(SystemExit) as ended:
        sideslip.main(["campaign", "plan.toml", "--out", "o"])
    said = capsys.readouterr().err
    assert ended.value.code == 2
    assert "trap:" in said
    assert "--trust-code" in said
    assert not Path("sprung").exists()


def test_a_trusted_program_runs_and_that_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("trap2.py").write_text(TRAP)
    Path("plan.toml").write_text('flights = ["none.mcap"]\nmodel = "trap2:Model"\n')
    with pytest.raises(SystemExit):
        sideslip.main(["campaign", "plan.toml", "--out", "o", "--serial", "--trust-code"])
    assert "trap2:Model: a program, which runs because of --trust-code" in capsys.readouterr().err


@pytest.mark.parametrize(
    "text",
    [
        "a" + ".a" * 3000 + " = 1",
        "x = " + "[" * 5000,
        "x = " + "9" * 5000,
        "x = 1" + "#" * 2_000_000,
        "x = '\\ud800'",
        "\0",
    ],
)
def test_a_plan_that_nests_or_swells_is_a_sentence(text: str, tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(text)
    with pytest.raises(CampaignError):
        read_plan(path)


@pytest.mark.parametrize("table", ["/dev/zero", "pipe.csv", "folder.csv"])
def test_a_table_that_is_no_file_is_a_sentence(table: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(CampaignError, match="ordinary file"):
        entries_of(plan_from({"table": table}, "p"), tmp_path)


def test_more_simulated_flights_than_can_be_made_are_refused_at_once(tmp_path: Path) -> None:
    many = [{"scenario": "rich", "count": limits.FLIGHTS}] * 3
    with pytest.raises(CampaignError, match="at most"):
        entries_of(plan_from({"simulate": many}, "p"), tmp_path)


@pytest.mark.parametrize(
    "address",
    [
        "zip://a.csv::https://x/y.zip",
        "simplecache::file:///etc/passwd",
        "python://x",
        "reference://x",
        "dask://h",
        "data://,x",
        "://x",
    ],
)
def test_addresses_of_odd_kinds_are_not_opened(address: str) -> None:
    with pytest.raises(CampaignError):
        fetched(address)


def test_a_pattern_over_everything_names_flights_alone_and_nothing_endless_is_read(tmp_path: Path) -> None:
    (tmp_path / "in" / "deeper.csv").mkdir(parents=True)
    (tmp_path / "in" / "flight.csv").write_text("time,p\n0,0\n1,0\n")
    (tmp_path / "in" / "kmsg").write_text("x")
    with (tmp_path / "in" / "huge.csv").open("wb") as file:
        file.truncate(limits.DATA_BYTES + 1)  # a hole: it takes no room, and hashing it would take a minute
    entries = {Path(e.location).name: e for e in entries_of(plan_from({"flights": ["**/*"]}, "p"), tmp_path)}
    assert set(entries) == {"deeper.csv", "flight.csv", "huge.csv"}
    assert entries["flight.csv"].source is not None
    assert "bytes long" in entries["huge.csv"].why
    with pytest.raises(CampaignError, match="no flight there"):
        entries_of(plan_from({"flights": ["**/km*"]}, "p"), tmp_path)


def test_a_flight_whose_name_is_no_text_is_a_flight(tmp_path: Path) -> None:
    name = os.fsdecode(b"fl\xffug.csv")
    (tmp_path / name).write_text("time,p\n0,0\n1,0\n")
    (entry,) = entries_of(plan_from({"flights": [name]}, "p"), tmp_path)
    assert entry.source is not None
    assert entry.name == "fl\\udcffug"


def test_a_file_by_its_address_is_an_ordinary_one(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "flight.csv").write_bytes(b"time,p\n0,0\n")
    assert fetched(f"file://{tmp_path}/flight.csv") == b"time,p\n0,0\n"
    for address in (f"file://{tmp_path}/pipe.csv", "file:///dev/zero"):
        with pytest.raises(CampaignError, match="ordinary file"):
            fetched(address)


def test_an_address_whose_content_changed_after_the_plan_was_read_is_refused(tmp_path: Path) -> None:
    flight = tmp_path / "flight.csv"
    flight.write_bytes(b"time,p\n0,0\n")
    (entry,) = entries_of(plan_from({"flights": [f"file://{flight}"]}, "p"), tmp_path)
    assert entry.source is not None
    assert bytes_of(entry.source) == flight.read_bytes()
    flight.write_bytes(b"time,p\n0,1\n")
    with pytest.raises(CampaignError, match="changed while the campaign ran"):
        bytes_of(entry.source)


class Server(BaseHTTPRequestHandler):
    """Gives a flight in order, with its length and without; one without end; drips; says nothing at all."""

    def do_HEAD(self) -> None:
        self.send_response(200 if "mute" not in self.path else 500)
        if self.path == "/sized.csv":
            self.send_header("Content-Length", "11")
        self.end_headers()

    def do_GET(self) -> None:
        if self.path == "/mute.csv":
            time.sleep(2.0)
            return
        self.do_HEAD()
        with contextlib.suppress(OSError):
            while self.path == "/endless.csv":
                self.wfile.write(bytes(4096))
            for _ in range(100 if self.path == "/dripping.csv" else 0):
                self.wfile.write(b"0")
                time.sleep(0.05)
            self.wfile.write(b"time,p\n0,0\n")

    def log_message(self, format: str, *args: object) -> None:
        """Nothing."""


@pytest.fixture
def server() -> Iterator[str]:
    http = ThreadingHTTPServer(("127.0.0.1", 0), Server)
    thread = threading.Thread(target=http.serve_forever, args=(0.05,))
    thread.start()
    yield f"http://127.0.0.1:{http.server_address[1]}"
    http.shutdown()
    http.server_close()
    thread.join()


@pytest.mark.parametrize("name", ["sized", "unsized"])
def test_a_flight_comes_from_a_server(name: str, server: str) -> None:
    assert fetched(f"{server}/{name}.csv") == b"time,p\n0,0\n"


@pytest.mark.parametrize(
    ("name", "words"), [("endless", "longer than the"), ("dripping", "bytes in"), ("mute", "cannot be")]
)
def test_a_server_is_not_waited_for_without_end(
    name: str, words: str, server: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limits, "DATA_BYTES", 1 << 20)
    monkeypatch.setattr(limits, "SILENCE_S", 0.5)
    begun = time.monotonic()
    with pytest.raises(CampaignError, match=words):
        fetched(f"{server}/{name}.csv")
    assert time.monotonic() - begun < 8.0


@dataclass
class Dripping:
    """A server's answer of a byte a read."""

    seconds: float = 0.0

    def read(self, size: int) -> bytes:
        self.seconds += 1.0
        return b"0"


def test_what_drips_or_does_not_end_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = Dripping()
    monkeypatch.setattr(time, "monotonic", lambda: stream.seconds)
    with pytest.raises(CampaignError, match="21 bytes in 21 s"):
        b"".join(_chunks(cast(IO[bytes], stream), "http://x/y.csv"))
    monkeypatch.setattr(limits, "DATA_BYTES", 100)
    with pytest.raises(CampaignError, match="longer than the 100 bytes"):
        b"".join(_chunks(io.BytesIO(bytes(101)), "http://x/y.csv"))
    assert b"".join(_chunks(io.BytesIO(bytes(100)), "http://x/y.csv")) == bytes(100)
