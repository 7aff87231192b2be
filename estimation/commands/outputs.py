"""What every verb does with its answer: write the files that were asked for, print, and say how it went."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from daq.contract.outputs import write_json

if TYPE_CHECKING:
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
    done = list(written)
    if figure_path is not None:
        done.append(f"figure: {answer.save(figure_path)}")
    if report_folder is not None:
        done.append(f"report: {answer.report(report_folder)}")
    for line in (*(answer.lines() if lines is None else lines), *done):
        click.echo(line)
    return 0 if answer.passed else 1


def beside_lines(paths: Iterable[Path]) -> list[str]:
    """A line on each flight that was written with what a model shows beside it."""
    return [f"histories: {path} (look at them with: sideslip view {path})" for path in paths]
