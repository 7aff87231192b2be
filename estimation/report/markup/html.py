"""Templates to one file: no script, no style sheet and no picture outside it. Every page extends `base.html.j2`."""

from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

from daq.contract.durable import write_text
from daq.contract.plain_words import printed
from estimation.report.markup.fold import label, needs_width, pieces, words
from estimation.report.names import html as symbol
from estimation.report.tables import significant

HERE = Path(__file__).parents[1]
FRONT = "index.html"
BACK = "<!-- back to the front page -->"
"""Stands in a page that has no front page yet; the front page puts the link there when it is written."""

MARK = '<meta name="generator" content="sideslip front page">'


def render(template: str, *, templates: Path = HERE, **context: Any) -> str:
    """A page from a template (`*.html.j2`) of this folder or of `templates`, which extends `base.html.j2`."""
    environment = Environment(
        loader=FileSystemLoader([templates, HERE]),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=printed,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(symbol=symbol, significant=significant, pieces=pieces, words=words, breakable=breakable)
    environment.globals["label"] = label
    style = (HERE / "style.css").read_text(encoding="utf-8")
    given = {"mark": "", "back": "", "landscape": needs_width(context), **context}
    return environment.get_template(template).render(style=style, software=software(), written=_now(), **given)


def breakable(text: str) -> Markup:
    """A sentence or path that may break after each slash."""
    return escape(text).replace("/", Markup("/<wbr>"))


def write_page(path: Path, template: str, *, templates: Path = HERE, **context: Any) -> Path:
    """Render to a file, in one step; with a link to the front page where there is one in the folder above."""
    back = back_link() if is_front_page(path.parent.parent / FRONT) else BACK
    text = render(template, templates=templates, **{"back": back, **context})
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_text(path, text)
    return path


def replace_text(path: Path, text: str) -> None:
    """Write a page so that a reader finds the old one or the new one, whole."""
    write_text(path, text)


def back_link() -> str:
    """The way from a page to the front page above it."""
    return f'<a href="../{FRONT}">&larr; Flight-test report</a>'


def link_back(page: Path) -> None:
    """Give a page that was written before its front page the way back to it."""
    text = page.read_text(encoding="utf-8")
    if BACK in text:
        replace_text(page, text.replace(BACK, back_link(), 1))


def is_front_page(path: Path) -> bool:
    """Whether a file is a front page that this program wrote."""
    if not path.is_file():
        return False
    with path.open(encoding="utf-8", errors="replace") as file:
        return MARK in file.read(2000)


def software() -> str:
    """Name and version of this program."""
    try:
        return f"sideslip {version('sideslip')}"
    except PackageNotFoundError:
        return "sideslip, version unknown (run from a bare tree)"


def _now() -> str:
    return datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
