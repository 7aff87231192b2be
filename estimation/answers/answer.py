"""What every public function gives: an answer that prints shortly, shows a table in a notebook, and gives JSON, figures,
pages and files when asked."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daq.contract.durable import whole
from daq.contract.errors import UserError
from daq.contract.outputs import PICTURES, write_json
from estimation.answers.notebook import Figures, table

if TYPE_CHECKING:
    import pandas as pd


Rows = tuple[Sequence[str], Iterable[Sequence[str]]]
"""Head and rows of a small table."""


class Answer(ABC):
    """The protocol of answers. What a subclass does not have, such as a picture, raises a UserError where it is asked for."""

    @abstractmethod
    def to_json(self) -> dict[str, Any]:
        """What the verb writes with --json, key by key."""

    @abstractmethod
    def lines(self) -> Iterable[str]:
        """What the verb prints."""

    @abstractmethod
    def headline(self) -> str:
        """The answer in a line."""

    @abstractmethod
    def rows(self) -> Rows:
        """The table that a notebook shows."""

    @abstractmethod
    def plot(self, ax: Any = None) -> Any:
        """Draw on the axes that are given, or on new ones; gives the axes."""

    @property
    def passed(self) -> bool:
        """False where the answer is a failed check, which the verb ends with status 1 for."""
        return True

    def summary(self) -> str:
        """What the verb prints."""
        return "\n".join(self.lines())

    def figures(self) -> Figures:
        """The figures of the page by name, each drawn when it is looked at."""
        return Figures({})

    def report(self, folder: str | Path) -> Path:
        """Write the HTML page; gives its path."""
        from markupsafe import Markup

        from estimation.report.page import Page, Section
        from estimation.report.tables import ReportTable

        head, rows = self.rows()
        cells = tuple(tuple(str(cell) for cell in row) for row in rows)
        table = ReportTable("answer", "Numbers", tuple(head), cells, symbols=False)
        lines = Markup('<pre class="scroll">{}</pre>').format("".join(f"{line}\n" for line in self.lines()))
        parts = [lines, *self.figures().values(), table if table.rows else None]
        page = Page(self.headline(), "", [Section("summary", "Summary", parts, "Summary")])
        return page.write(Path(folder) / "index.html")

    def writers(self) -> Mapping[str, Callable[[Path], Any]]:
        """Ending of a file's name -> what writes it."""
        return {".json": lambda path: write_json(self.to_json(), path)}

    def save(self, path: str | Path) -> Path:
        """Write the file whose kind the ending of its name chooses; gives the path. UserError for an unknown ending."""
        path, known = Path(path), self.writers()
        if path.suffix.lower() not in known:
            endings = ", ".join(n for n in known if n not in PICTURES or n == ".svg")
            raise UserError(f"{path}: no known format of this answer; end the name in one of {endings}")
        known[path.suffix.lower()](path)
        return path

    def __repr__(self) -> str:
        return f"<{self.headline()}>"

    def _repr_html_(self) -> str:
        return table(self.headline(), *self.rows())


def table_writers(answer: Any) -> dict[str, Callable[[Path], Any]]:
    """The writer of an answer's table as CSV."""

    def write(path: Path) -> None:
        frame: pd.DataFrame = answer.to_pandas()
        with whole(path) as new:
            frame.to_csv(new, index=False)

    return {".csv": write}


def picture_writers(write: Callable[[Path], Any]) -> dict[str, Callable[[Path], Any]]:
    """The same function for every kind of picture."""
    return dict.fromkeys(PICTURES, write)


def rounded(estimate: Any) -> tuple[str, str]:
    """Estimate and corrected bound to the second figure of the bound."""
    from estimation.report.tables import rounded as to_figures

    value, bound = to_figures(estimate.estimate, estimate.std_coloured)
    return value, bound
