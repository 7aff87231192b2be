"""Shared by the verbs: progress of long work, and the delivery of an answer: files written, lines printed, exit status."""

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
    """Write and print an answer, and give the exit status: 1 where it is a failed check.

    lines: printed instead of the answer's. written: a line on each file that the verb has written itself.
    """
    # files first: a reader that closes the pipe early (| head) must not lose a result
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
"""Patterns that are coloured on a terminal: verdicts, and rules of tables."""


def print_lines(lines: Iterable[str]) -> None:
    """Print an answer: with colours on a terminal, without in a pipe or with NO_COLOR."""
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
    """A line on each written flight that has a model's outputs beside its own columns."""
    return [f"histories: {path} (look at them with: sideslip view {path})" for path in paths]


STEPS_OF_A_LOG = 4
"""Lines of progress where standard error is no terminal: at the start and after each quarter of the work."""


class Progress:
    """A context manager that shows progress: call `progress(0.3)`, or `progress("fitting", 0.3)`.

    title: the work, for calls without a text. A call without a share announces the next work; a log leaves it out, so that only
    the one line of an error stands there.
    """

    def __init__(self, title: str = "") -> None:
        self._title = title
        context = click.get_current_context(silent=True)
        self._quiet = context is not None and bool(context.meta.get("sideslip.quiet"))
        self._live = sys.stderr.isatty() and not self._quiet
        self._next_step = 0
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

    def __call__(self, *words_and_share: str | float) -> None:
        words = " ".join(t for t in words_and_share if isinstance(t, str)) or self._title
        shares = [min(t, 1.0) for t in words_and_share if not isinstance(t, str)]
        share = shares[0] if shares else None
        if self._bar is not None and self._task is not None:
            self._bar.update(
                self._task, description=one_line(words), completed=share, total=None if share is None else 1.0
            )
        elif share is not None and not self._quiet and int(STEPS_OF_A_LOG * share) >= self._next_step:
            self._next_step = int(STEPS_OF_A_LOG * share) + 1
            click.echo(f"{words}: {share:.0%}", err=True)


def _bar() -> "RichProgress":
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as RichProgress

    terminal = sys.stderr.bare if isinstance(sys.stderr, VisibleStream) else sys.stderr
    words = TextColumn("{task.description:<45}", markup=False)  # names of flights are among them
    columns = (words, BarColumn(), TextColumn("{task.percentage:>3.0f} %"), TimeRemainingColumn())
    # printed lines keep their streams: without these options rich would take them over
    return RichProgress(
        *columns, console=Console(file=terminal), transient=True, redirect_stdout=False, redirect_stderr=False
    )
