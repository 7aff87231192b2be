"""Names that strangers give to flights, columns, aircraft and models: they do no harm on a page, a terminal or a disk."""

import base64
import contextlib
import os
import re
import unicodedata
from collections.abc import Iterator
from pathlib import Path

import pytest
from lxml import etree, html

import sideslip
from daq.utilities.plain_words import file_name, one_line, plain_name, visible
from tests.support.paths import ROOT

FOREIGN = ROOT / "recordings" / "foreign" / "ordinary_0.csv"
SCRIPT = "<script>alert(1)</script>"
HOSTILE = (
    SCRIPT, "<img src=x onerror=alert(1)>", '"><svg onload=alert(1)>', "\u202egnp.evil\u2066", "two\nlines\rthree",
    "\x1b[2J\x1b]0;x\x07", "x" * 10_000, "$\\frac{$", "=HYPERLINK(\"http://evil\")", "../../etc/passwd", "\ud800",
    "\u200b\u2028", "..",
)  # fmt: skip
FORBIDDEN = ("Cc", "Cf", "Cs", "Zl", "Zp")


def harmless(text: str) -> bool:
    """No character that controls a terminal or the direction of reading."""
    return all(c in "\n\t" or unicodedata.category(c) not in FORBIDDEN for c in text)


@pytest.mark.parametrize("name", HOSTILE)
def test_words_made_fit(name: str) -> None:
    assert harmless(visible(name))
    for short in (plain_name(name), file_name(name)):
        assert harmless(short)
        assert "\n" not in short
        assert len(short.encode()) <= 200
        assert plain_name(short) == short
    assert "/" not in file_name(name)
    assert file_name(name) not in (".", "..")
    assert len(one_line(name)) <= 2000


def test_words_of_other_scripts_stay_as_they_are() -> None:
    for name in ("Höhe über Grund", "飛行 7", "طيران", "β̇ [°/s]", "ld1"):
        assert plain_name(name) == name


def _flight(folder: Path, stem: str, column: str) -> Path:
    """A flight of the recordings under another name, with a column more."""
    lines = FOREIGN.read_text(encoding="utf-8").splitlines()
    path = folder / f"{stem}.csv"
    path.write_text(
        "\n".join([f'{lines[0]},"{column}"', *(f"{line},1" for line in lines[1:])]) + "\n", encoding="utf-8"
    )
    return path


def _aircraft(folder: Path, name: str) -> Path:
    from estimation.aircraft.library import BUILT_IN_FOLDER

    text = (BUILT_IN_FOLDER / "cdfp.toml").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith(("name", "title"))]
    quoted = "".join(c if c.isascii() and c.isprintable() and c not in '"\\' else f"\\u{ord(c):04x}" for c in name)
    path = folder / "aircraft.toml"
    path.write_text(f'name = "{quoted}"\ntitle = "{quoted}"\n' + "\n".join(lines), encoding="utf-8")
    return path


def _pages(folder: Path) -> Iterator[etree._Element]:
    pages = list(folder.rglob("*.html"))
    assert pages
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert harmless(text), page
        yield html.fromstring(text)


def _check_page(page: etree._Element) -> None:
    assert not page.xpath("//script")
    assert not page.xpath("//@*[starts-with(name(), 'on')]")
    assert not page.xpath("//iframe | //object | //embed | //svg")
    for source in page.xpath("//img/@src"):
        kind, _, data = source.partition(";base64,")
        assert kind in ("data:image/svg+xml", "data:image/png")
        if kind.endswith("svg+xml"):
            _check_picture(base64.b64decode(data))


def _check_picture(data: bytes) -> None:
    assert harmless(data.decode("utf-8"))
    root = etree.fromstring(data)
    tags = {etree.QName(e).localname for e in root.iter() if isinstance(e.tag, str)}
    assert not tags & {"script", "foreignObject", "a"}
    links = [v for e in root.iter() if isinstance(e.tag, str) for k, v in e.attrib.items() if k.endswith("href")]
    assert all(link.startswith(("#", "data:image/png")) for link in links)
    assert not [k for e in root.iter() if isinstance(e.tag, str) for k in e.attrib if k.lower().startswith("on")]


@pytest.mark.filterwarnings("ignore:Glyph")
def test_reports_of_hostile_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stem = "<script>alert(1)<\u202egnp.evil\x1b[2J\n$\\frac{$"
    column = f"{SCRIPT}\u202e\x1b[31mred"
    name = f"{SCRIPT}\u2066\x1b[2J" + "x" * 10_000
    flight, craft = _flight(tmp_path, stem, column), _aircraft(tmp_path, name)
    out = tmp_path / "out"
    for words in (
        ["info", flight],
        ["import", flight, "-o", out / "imported.mcap", "--accept-implausible"],
        ["check", flight, "--report", out / "check", "--write", out / "corrected", "--json", out / "check.json"],
        [
            "estimate",
            flight,
            "--method",
            "ls",
            "--aircraft",
            craft,
            "--report",
            out / "estimate",
            "--figure",
            out / "f.svg",
        ],
    ):
        with pytest.raises(SystemExit) as ended:
            sideslip.main([str(w) for w in words])
        said = capsys.readouterr()
        assert ended.value.code in (0, 1), said.err
        assert harmless(said.out), words[0]
        assert harmless(said.err), words[0]
    for page in _pages(out):
        _check_page(page)
    with contextlib.suppress(FileNotFoundError):
        _check_picture((out / "f.svg").read_bytes())
    for path in out.rglob("*"):
        assert harmless(path.name)
        assert path.resolve().is_relative_to(out)
        if path.suffix in (".csv", ".tex"):
            text = path.read_text(encoding="utf-8")
            assert harmless(text)
            assert not any(line.startswith(("=", "@")) for line in text.splitlines())


def test_a_model_cannot_be_written_outside_its_folder(tmp_path: Path) -> None:
    from estimation.models.load import load_model, read_model, write_model

    path = tmp_path / "model.toml"
    write_model(load_model("lateral-simple", "cdfp"), path)
    text = path.read_text(encoding="utf-8")
    assert text.startswith('name = "lateral-simple"')
    path.write_text(text.replace('"lateral-simple"', '"../../evil"', 1), encoding="utf-8")
    assert "/" not in read_model(path).name


def test_a_scenario_cannot_name_a_folder_elsewhere(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "s.toml"
    path.write_text('name = "../../evil"\n', encoding="utf-8")
    with pytest.raises(SystemExit) as ended:
        sideslip.main(["fly", str(path)])
    assert ended.value.code == 2
    assert "without slash" in capsys.readouterr().err


@pytest.mark.parametrize(
    "word", [r"\input{/etc/passwd}", r"\write18{rm x}", "a_b^c#1 50% & $x$ ~{}", "\u202egnp", "x\n\\end{table}"]
)
def test_words_of_strangers_are_no_commands_of_latex(word: str) -> None:
    from estimation.report.tables import latex_text

    made = latex_text(word)
    bare = re.sub(r"\\(textbackslash|textasciicircum)\{\}|\$\\sim\$|\\[_#%&${}]", "", made)
    assert not set(bare) & set("\\#%&$^_~{}\n\u202e"), made


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_a_name_that_is_no_text_is_read_and_written(
    tmp_path: Path, ending: str, capsys: pytest.CaptureFixture[str]
) -> None:
    flight, out = tmp_path / os.fsdecode(b"fl\xffug.csv"), tmp_path / os.fsdecode(b"out\xfe" + ending.encode())
    flight.write_text("time,p,q\n" + "".join(f"{0.05 * i},{0.1 * (i % 7)},{0.01 * i}\n" for i in range(100)))
    for words in (
        ["import", flight, "-o", out, "--accept-implausible"],
        ["info", out],
        ["export", out, "-o", tmp_path / "o.parquet"],
    ):
        with pytest.raises(SystemExit) as ended:
            sideslip.main([str(w) for w in words])
        said = capsys.readouterr()
        assert ended.value.code == 0, said.err
        assert harmless(said.out + said.err)
