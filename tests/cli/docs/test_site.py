"""The documentation site builds without a network, a warning is an error, and its notebooks run and show what they promise."""

import html
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.paths import ROOT

pytestmark = [pytest.mark.timeout(900)]  # the notebooks take some 40 s of an idle processor


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built site; building it runs every cell of the notebooks, and a cell that fails is an error."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", "docs", str(folder)]
    environment = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "http_proxy": "http://127.0.0.1:9",
        "https_proxy": "http://127.0.0.1:9",
    }
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def shown(site: Path, notebook: str) -> str:
    """The page of a notebook."""
    return (site / "notebooks" / f"{notebook}.html").read_text(encoding="utf-8")


def test_the_site_builds_without_a_warning(site: Path) -> None:
    assert (site / "index.html").is_file()
    assert (site / "notebooks" / "first-flight.html").is_file()


def test_a_first_flight_goes_from_a_log_to_derivatives(site: Path) -> None:
    page = shown(site, "first-flight")
    assert "one of them has the wrong sign" in page or "sign = -1" in html_text(page).split("forgotten.toml")[-1]
    assert page.count("<figcaption>") >= 4
    assert page.count("image/png") + page.count(".png") >= 2
    assert "Estimates of lateral by ml" in page
    assert "Cl_p" in page


def test_published_flights_agree_with_what_was_flown(site: Path) -> None:
    rows = re.findall(r"<tr>\s*<th[^>]*>(C[Yln]_\w+)</th>(.*?)</tr>", shown(site, "published-flights"), flags=re.S)
    off = {name: float(re.findall(r">([^<>]*)</td>", cells)[-1]) for name, cells in rows}
    assert len(off) == 13
    assert max(map(abs, off.values())) < 4.0, off  # bounds: the recordings are fixed, 13 numbers of unit scatter


def test_the_hidden_effect_is_found(site: Path) -> None:
    text = html_text(shown(site, "hidden-effect"))
    assert "Gap: gap_closed: Cn_da" in text
    assert "found: ('Cn_da',)" in text


def test_the_site_asks_nobody(site: Path) -> None:
    """Pages load nothing from another host: links may lead out, scripts, styles, fonts and pictures may not."""
    loaded = re.compile(r"<(?:script|img|iframe)\b[^>]*\bsrc=\"(https?:[^\"]*)|<link\b[^>]*\bhref=\"(https?:[^\"]*)")
    asked = {(p.name, *found) for p in site.rglob("*.html") for found in loaded.findall(p.read_text(encoding="utf-8"))}
    assert not asked


def html_text(page: str) -> str:
    """What a person reads."""
    return html.unescape(re.sub(r"<[^>]+>", "", page))


def test_every_page_is_in_the_contents() -> None:
    contents = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"^([a-z][a-z0-9/-]*)$", contents, flags=re.M))
    docs = ROOT / "docs"
    pages = {path.relative_to(docs).with_suffix("").as_posix() for path in docs.rglob("*.md")} - {"index"}
    assert pages == listed & pages
    generated = {"effects", "gap-criteria"}  # when the site is built
    assert not {name for name in listed - generated if not (ROOT / "docs" / f"{name}.md").is_file()}
