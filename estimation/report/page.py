"""The one page that every report is: a head and sections of tables, figures and HTML, in one file.

Style and pictures are inside the file; there are no scripts.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

from daq.utilities.durable import write_text
from daq.utilities.plain_words import printed
from estimation.report.drawing.figures import Picture
from estimation.report.names import html as symbol
from estimation.report.tables import ReportTable, cell_label, needs_width, table_slices, word_columns

TEMPLATES = Path(__file__).parent
FRONT = "index.html"
BACK = "<!-- back to the front page -->"
"""Place holder in a page without a front page; writing the front page replaces it by a link."""

MARK = '<meta name="generator" content="sideslip front page">'
HEAD_LENGTH = 2000  # characters of a file that are searched for MARK

Part = ReportTable | Picture | Markup | None


@dataclass(frozen=True)
class Section:
    """A heading and its parts. anchor: of the heading; link: its word in the navigation, empty for none. Without a title it has
    no heading; a part that is None is left out. folded: closed until the reader opens it; printed: whether print shows it anyway;
    kind: class of the HTML around it."""

    anchor: str
    title: str
    parts: Sequence[Part] = ()
    link: str = ""
    folded: bool = False
    printed: bool = True
    kind: str = ""

    def shown(self) -> list[Part]:
        """Parts that are not None."""
        return [part for part in self.parts if part is not None]


@dataclass(frozen=True)
class Page:
    """A page of a report. sections: one that is None is left out; links: (address, word) in the navigation, after those of the
    sections; back: HTML of a link to another page, None for one to the front page in the folder above; mark: HTML for the head;
    beside: tables that are written as files and not shown."""

    title: str
    lead: str
    sections: Sequence[Section | None]
    links: Sequence[tuple[str, str]] = ()
    back: str | None = None
    mark: str = ""
    beside: Sequence[ReportTable] = ()

    def shown(self) -> list[Section]:
        """Sections that are not None."""
        return [section for section in self.sections if section is not None]

    def tables(self) -> list[ReportTable]:
        """Every table of the page, in order, and those beside it."""
        return [*_tables(self.shown()), *self.beside]

    def html(self, back: str = "") -> str:
        """The file's text. back: HTML of a link to another page."""
        environment = Environment(
            loader=FileSystemLoader(TEMPLATES),
            autoescape=True,
            undefined=StrictUndefined,
            finalize=printed,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        environment.filters.update(symbol=symbol, pieces=table_slices, words=word_columns, breakable=breakable)
        environment.tests["report_table"] = lambda part: isinstance(part, ReportTable)
        environment.tests["picture"] = lambda part: isinstance(part, Picture)
        environment.globals["label"] = cell_label
        return environment.get_template("page.html.j2").render(
            page=self,
            links=[*((f"#{s.anchor}", s.link) for s in self.shown() if s.link), *self.links],
            landscape=needs_width(_tables(s for s in self.shown() if s.printed)),
            style=(TEMPLATES / "style.css").read_text(encoding="utf-8"),
            back=back,
            software=software(),
            written=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        )

    def write(self, path: Path, tables: Path | None = None) -> Path:
        """Write the file in one step; returns its path. tables: folder for the page's tables as CSV and LaTeX."""
        if tables is not None:
            for table in self.tables():
                if table.filed:
                    table.write(tables)
        back_html = self.back
        if back_html is None:
            back_html = back_link() if is_front_page(path.parent.parent / FRONT) else BACK
        text = self.html(back_html)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, text)
        return path


def _tables(sections: Iterable[Section]) -> list[ReportTable]:
    return [part for section in sections for part in section.parts if isinstance(part, ReportTable)]


def breakable(text: str) -> Markup:
    """A sentence or path that may break after each slash."""
    return escape(text).replace("/", Markup("/<wbr>"))


def paragraph(text: str, kind: str = "") -> Markup:
    """A paragraph of text or of HTML; kind: its class."""
    return Markup('<p class="{}">{}</p>').format(kind, text) if kind else Markup("<p>{}</p>").format(text)


def sentence(text: str) -> str:
    """Text with a capital first letter and a full stop."""
    return f"{text[:1].upper()}{text[1:]}."


def box(paragraphs: Iterable[Markup], *, warn: bool = False) -> Markup:
    """Paragraphs in a frame; warn: in the colour of a warning."""
    return Markup('<div class="box{}">{}</div>').format(" warn" if warn else "", Markup().join(paragraphs))


def bullets(items: Iterable[str]) -> Markup:
    """A list of texts or of HTML."""
    return Markup("<ul>{}</ul>").format(Markup().join(Markup("<li>{}</li>").format(item) for item in items))


def coloured(text: str, kind: str) -> Markup:
    """Bold text in the colour of a verdict: ok, warn or fail."""
    return Markup('<b class="{}">{}</b>').format(kind, text)


def free_table(
    head: Sequence[tuple[str, str]],
    rows: Iterable[Sequence[tuple[str, str]]],
    kind: str = "",
    caption: str = "",
    labels: Sequence[str | None] | None = None,
) -> Markup:
    """A table of HTML cells, for the page only. head, rows: (class, text or HTML) of each cell; kind: class of the table; labels:
    name of a cell where its head is not in sight, by default the text of the head, None for no label."""
    names: Sequence[str | None] = [text for _, text in head] if labels is None else labels
    lines = [_row(row, "td", names) for row in rows]
    caption_html = Markup("<caption>{}</caption>").format(caption) if caption else ""
    return Markup(
        '<div class="scroll"><table class="fold{}">{}<thead>{}</thead><tbody>{}</tbody></table></div>'
    ).format(f" {kind}" if kind else "", caption_html, _row(head, "th", [None] * len(head)), Markup("\n").join(lines))


def _row(cells: Sequence[tuple[str, str]], tag: str, labels: Sequence[str | None]) -> Markup:
    """One row; empty classes and missing labels give no attribute."""
    cell_htmls = []
    for (kind, text), name in zip(cells, labels, strict=True):
        attributes = Markup(' class="{}"').format(kind) if kind else Markup()
        if name is not None:
            attributes += Markup(' data-label="{}"').format(name)
        cell_htmls.append(Markup(f"<{tag}{{}}>{{}}</{tag}>").format(attributes, text))
    return Markup("<tr>{}</tr>").format(Markup().join(cell_htmls))


def back_link() -> str:
    """HTML of the link from a page to the front page above it."""
    return f'<a href="../{FRONT}">&larr; Flight-test report</a>'


def link_back(page: Path) -> None:
    """Put the link to the front page into a page that was written before it."""
    text = page.read_text(encoding="utf-8")
    if BACK in text:
        write_text(page, text.replace(BACK, back_link(), 1))


def is_front_page(path: Path) -> bool:
    """Whether a file is a front page that this program wrote."""
    if not path.is_file():
        return False
    with path.open(encoding="utf-8", errors="replace") as file:
        return MARK in file.read(HEAD_LENGTH)


def software() -> str:
    """Name and version of this program."""
    try:
        return f"sideslip {version('sideslip')}"
    except PackageNotFoundError:
        return "sideslip, version unknown (run from a bare tree)"
