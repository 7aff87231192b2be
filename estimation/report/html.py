"""Templates to one file: no script, no style sheet and no picture outside it."""

from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from daq.contract.plain_words import printed
from estimation.report.names import html as symbol
from estimation.report.tables import significant

HERE = Path(__file__).parent


def render(template: str, **context: Any) -> str:
    """A page from a template of this folder (`*.html.j2`), which extends `base.html.j2`."""
    environment = Environment(
        loader=FileSystemLoader(HERE),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=printed,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["symbol"] = symbol
    environment.filters["significant"] = significant
    style = (HERE / "style.css").read_text(encoding="utf-8")
    return environment.get_template(template).render(style=style, software=software(), written=_now(), **context)


def write_page(path: Path, template: str, **context: Any) -> Path:
    """Render to a file, in one step."""
    text = render(template, **context)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".part")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)
    return path


def software() -> str:
    """Name and version of this program."""
    try:
        return f"sideslip {version('sideslip')}"
    except PackageNotFoundError:
        return "sideslip, version unknown (run from a bare tree)"


def _now() -> str:
    return datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
