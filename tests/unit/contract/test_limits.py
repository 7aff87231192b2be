"""What is read of others is bounded: a sentence, soon and in little memory, whatever the file, pattern or address."""

import os
import threading
import time
import tracemalloc
from pathlib import Path

import pytest

from daq.utilities import limits
from daq.utilities.errors import UserError
from daq.utilities.input_files import matching, read_json, read_xml


def test_xml_that_nests_swells_or_is_none_is_a_sentence(tmp_path: Path) -> None:
    deep = "<a>" * 5000 + "</a>" * 5000
    bomb = '<!DOCTYPE a [<!ENTITY b "x"><!ENTITY c "&b;&b;&b;">]><a>&c;</a>'
    for n, text in enumerate([deep, bomb, "", "<a>", "no", "<?xml version='1.0' encoding='nobody-knows'?><a/>"]):
        path = tmp_path / f"{n}.xml"
        path.write_text(text)
        with pytest.raises(UserError, match=str(path)):
            read_xml(path, "aircraft")
    (tmp_path / "sound.xml").write_text('<a><b c="1">text</b></a>')
    assert read_xml(tmp_path / "sound.xml")[0].text == "text"
    (tmp_path / "utf16.xml").write_bytes(bomb.encode("utf-16"))
    with pytest.raises(UserError):
        read_xml(tmp_path / "utf16.xml")


def test_very_many_elements_are_refused_before_they_fill_the_memory(tmp_path: Path) -> None:
    path = tmp_path / "wide.xml"
    path.write_bytes(b"<a>" + b"<b/>" * 1_500_000 + b"</a>")
    with pytest.raises(UserError, match="in all"):
        read_xml(path)


@pytest.mark.parametrize(
    "text", ["[" * 100_000, '{"a":' * 60_000, "nan?", "", "\udcff".encode("utf-8", "surrogatepass").decode("latin-1")]
)
def test_json_that_nests_or_is_none_is_a_sentence(tmp_path: Path, text: str) -> None:
    path = tmp_path / "x.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UserError, match=r"x\.json"):
        read_json(path)


@pytest.mark.parametrize("name", ["/dev/zero", "fifo"])
def test_a_pipe_or_an_endless_device_is_no_file(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / "fifo")
    begun = time.monotonic()
    for read in (read_json, read_xml):
        with pytest.raises(UserError, match="that is a"):
            read(tmp_path / name)
    assert time.monotonic() - begun < 2.0


def test_a_pattern_names_what_the_shell_would(tmp_path: Path) -> None:
    for name in ("a/one.mcap", "a/b/two.mcap", "a/b/three.csv", ".hidden/four.mcap", "a/.five.mcap"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()

    def found(pattern: str) -> list[str]:
        return [str(p.relative_to(tmp_path)) for p in matching(tmp_path / pattern)]

    assert found("a/*.mcap") == ["a/one.mcap"]
    assert found("**/*.mcap") == ["a/b/two.mcap", "a/one.mcap"]
    assert found("*/b/t*.[cm]*") == ["a/b/three.csv", "a/b/two.mcap"]
    assert found("none/*") == []


def test_a_pattern_over_everything_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "LOOKED_AT", 500)
    for n in range(40):
        (tmp_path / f"d{n}").mkdir()
        for k in range(20):
            (tmp_path / f"d{n}" / f"{k}.x").touch()
    with pytest.raises(UserError, match="begin the pattern further in"):
        matching(tmp_path / "**/*.mcap")


def test_a_pattern_is_not_led_round_in_circles(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "back").symlink_to(tmp_path)
    (tmp_path / "a" / "x.mcap").touch()
    assert [p.name for p in matching(tmp_path / "**/*.mcap")] == ["x.mcap"]


def test_reading_a_growing_file_ends(tmp_path: Path) -> None:
    path = tmp_path / "grows.json"
    path.write_text("[1")
    stop = threading.Event()

    def grow() -> None:
        with path.open("a") as file:
            while not stop.is_set():
                file.write(",1" * 1000)

    grower = threading.Thread(target=grow)
    grower.start()
    tracemalloc.start()
    try:
        with pytest.raises(UserError):
            read_json(path)
    finally:
        stop.set()
        grower.join()
        tracemalloc.stop()
