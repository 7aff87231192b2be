"""Figures that are made and not written: to write those of one page of estimates takes fifteen times as long as the estimates.

They are written, and looked at, in tests/cli/test_api.py, tests/unit/estimation/test_report.py, tests/cli/test_hostile_names.py,
tests/web/test_report_pages.py and in the demo.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

EMPTY = b"<svg/>"
IN_A_PROCESS = f"from matplotlib.figure import Figure; Figure.savefig = lambda figure, file, **_: file.write({EMPTY!r})"
"""The same as a line of a program."""


def _leave_empty(figure: object, file: Any, **_: object) -> None:
    """In place of `Figure.savefig`."""
    if isinstance(file, str | Path):
        Path(file).write_bytes(EMPTY)
    else:
        file.write(EMPTY)


@contextmanager
def unwritten_figures() -> Iterator[None]:
    """An empty picture stands for each that is written meanwhile."""
    from matplotlib.figure import Figure

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", _leave_empty)
        yield
