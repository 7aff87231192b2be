"""What verbs share: progress of long work, and what becomes of an answer: files written, lines printed, exit status."""

import sys
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, ClassVar, Self

import click

from daq.utilities.outputs import write_json
from daq.utilities.plain_words import VisibleStream, one_line, visible

if TYPE_CHECKING:
    from rich.progress import Progress as RichProgress

    from estimation.answers.answer import Answer


def deliver(
    answer: "Answer",
    json_path: Path | None = None,
    figure_path: Path | None = None,
    report_folder: Path | None = None,
    *,
    lines: Iterable[str] | None = None,
    written: Iterable[str] = (),
) -> int:
    """Write, print, and give the exit status: 1 where the answer is a failed check.

    lines: in place of the answer's own; written: a line on each file that the verb has written itself.
    """
    # files first: a reader that closes the pipe early (| head) must not cost a result
    if json_path is not None:
        write_json(answer.to_json(), json_path)
    file_lines = list(written)
    if figure_path is not None:
        file_lines.append(f"figure: {answer.save(figure_path)}")
    if report_folder is not None:
        file_lines.append(f"report: {answer.report(report_folder)}")
    print_lines((*(answer.lines() if lines is None else lines), *file_lines))
    return 0 if answer.passed else 1


COLOURS = {"fail": "bold red", "warn": "yellow", "ok": "green", "head": "dim", "next": "bold cyan"}
WORDS = (
    r"(?P<fail>\b(?:FAIL|fail|NO-GO|not converged)\b)", r"(?P<warn>\b(?:cannot tell|warn|doubt)\b)", r"(?P<ok>\b(?:pass|ok)\b)",
    r"(?P<head>^[=-]{5,}$)", r"(?P<next>^(?:next|recommended|verdict):)",
)  # fmt: skip
"""What is coloured on a terminal: words that decide, and rules of tables."""


def print_lines(lines: Iterable[str]) -> None:
    """Print an answer: with colours where a terminal shows them, plain in a pipe or with NO_COLOR."""
    out = sys.stdout
    terminal = out.bare if isinstance(out, VisibleStream) else out
    if not terminal.isatty():
        for line in lines:
            click.echo(line)
        return
    from rich.console import Console
    from rich.highlighter import RegexHighlighter
    from rich.text import Text
    from rich.theme import Theme

    class Deciding(RegexHighlighter):
        base_style = "answer."
        highlights: ClassVar[list[str]] = list(WORDS)

    theme = Theme({f"answer.{name}": style for name, style in COLOURS.items()})
    console, highlighter = Console(file=terminal, theme=theme), Deciding()
    for line in lines:
        text = Text(visible(line))
        highlighter.highlight(text)
        console.print(text, soft_wrap=True, highlight=False)


def beside_lines(paths: Iterable[Path]) -> list[str]:
    """A line on each flight that was written with what a model shows beside it."""
    return [f"histories: {path} (look at them with: sideslip view {path})" for path in paths]


STEPS_OF_A_LOG = 4
"""A log gets a line at the start and at each quarter: enough to see that work goes on, not so many that they bury it."""


class Progress:
    """A context manager that is told how far the work is: `progress(0.3)`, or `progress("fitting", 0.3)`.

    title: what is being done, where the calls do not say. Without a share of the whole, a call says what comes next, which a
    log does not need: there it would only stand before an error's one line.
    """

    def __init__(self, title: str = "") -> None:
        self._title = title
        context = click.get_current_context(silent=True)
        self._quiet = context is not None and bool(context.meta.get("sideslip.quiet"))
        self._live = sys.stderr.isatty() and not self._quiet
        self._told = 0
        self._bar = _bar() if self._live else None
        self._task = self._bar.add_task(title, total=None) if self._bar is not None else None

    def __enter__(self) -> Self:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def __call__(self, *told: str | float) -> None:
        words = " ".join(t for t in told if isinstance(t, str)) or self._title
        shares = [min(t, 1.0) for t in told if not isinstance(t, str)]
        share = shares[0] if shares else None
        if self._bar is not None and self._task is not None:
            self._bar.update(
                self._task, description=one_line(words), completed=share, total=None if share is None else 1.0
            )
        elif share is not None and not self._quiet and int(STEPS_OF_A_LOG * share) >= self._told:
            self._told = int(STEPS_OF_A_LOG * share) + 1
            click.echo(f"{words}: {share:.0%}", err=True)


def _bar() -> "RichProgress":
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as RichProgress

    terminal = sys.stderr.bare if isinstance(sys.stderr, VisibleStream) else sys.stderr
    words = TextColumn("{task.description:<45}", markup=False)  # names of flights are among them
    columns = (words, BarColumn(), TextColumn("{task.percentage:>3.0f} %"), TimeRemainingColumn())
    # What is printed meanwhile goes where it would go without a bar.
    return RichProgress(
        *columns, console=Console(file=terminal), transient=True, redirect_stdout=False, redirect_stderr=False
    )
