"""The answer that every public function returns: printed as one line, a table and figures in a notebook, on request JSON, pages
and files.
"""

import html
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from daq.utilities.durable import whole
from daq.utilities.errors import UserError
from daq.utilities.outputs import PICTURES, write_json

if TYPE_CHECKING:
    import pandas as pd

    from estimation.compatibility.reconstruction import ReconstructedFlight
    from estimation.gap.answer.result import GapResult
    from estimation.report.drawing.figures import Picture
    from estimation.session.proof_of_match import ProofOfMatch
    from estimation.watch.over_file import Watched

LEADING = 12  # hypotheses of a gap in the plot: the page has them all


def html_table(title: str, head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A small HTML table; all text is escaped."""
    heads = "".join(f"<th>{html.escape(h)}</th>" for h in head)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(str(c))}</td>" for c in row) + "</tr>" for row in rows)
    heading = html.escape(title.strip("<>"))
    return f"<div><p>{heading}</p><table><thead><tr>{heads}</tr></thead><tbody>{body}</tbody></table></div>"


class Figures(Mapping[str, "Picture"]):
    """The figures of a report page by name, each drawn at its first use; a notebook shows them all."""

    def __init__(self, pictures: "Mapping[str, Callable[[], Picture | None]]") -> None:
        self._draw = dict(pictures)
        self._pictures: dict[str, Picture] = {}

    def __getitem__(self, name: str) -> "Picture":
        if name not in self._pictures:
            picture = self._draw[name]()
            assert picture is not None  # only figures with something to show are listed
            self._pictures[name] = picture
        return self._pictures[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._draw)

    def __len__(self) -> int:
        return len(self._draw)

    def save(self, folder: str | Path) -> list[Path]:
        """Write each to folder/NAME.svg; returns the paths."""
        Path(folder).mkdir(parents=True, exist_ok=True)
        return [p.save(Path(folder) / f"{name}.svg") for name, p in self.items()]

    def __repr__(self) -> str:
        return f"<Figures: {', '.join(self)}>"

    def _repr_html_(self) -> str:
        return "".join(p._repr_html_() for p in self.values())


def plot_reconstructed(flight: "ReconstructedFlight", ax: Any) -> Any:
    """Draw measured and reconstructed motion, one axes a channel; angles in degrees."""
    units = {n: "m/s" if n == "V" else "rad" for n in flight.outputs}
    return _histories(units, flight.time, flight.measured, {"reconstructed": flight.reconstructed}, ax)


def plot_proof(proof: "ProofOfMatch", ax: Any) -> Any:
    """Draw measured and predicted outputs, one axes a channel; angles in degrees."""
    units = {s.name: s.unit for s in proof.result.model.outputs}
    return _histories(units, proof.time, proof.measured, {"predicted": proof.predicted}, ax)


def plot_scores(result: "GapResult", ax: Any) -> Any:
    """Draw the leading hypotheses with their scores, and the threshold from simulated nulls."""
    (ax,) = panels(ax, 1, (7.0, 3.2))
    leading = sorted(result.scores, key=lambda n: -result.scores[n])[:LEADING]
    named_effects = {s.effect for s in result.steps}
    colours = ["C0" if n in named_effects else "0.6" for n in leading]
    ax.barh(range(len(leading)), [result.scores[n] for n in leading], color=colours)
    ax.set_yticks(range(len(leading)), leading)
    ax.invert_yaxis()
    ax.axvline(result.threshold, color="C3", linewidth=1.0)
    ax.set_xlabel(f"score; line: threshold {result.threshold:.2f}")
    return ax


def plot_watched(watched: "Watched", ax: Any) -> Any:
    """Draw the score of the gap monitor over its threshold, where controls moved; lines mark alarms."""
    from estimation.watch.answer import draw_history

    (ax,) = panels(ax, 1, (7.0, 2.6))
    draw_history(watched, ax)
    return ax


def _histories(units: Mapping[str, str], time: Any, measured: Any, curves: Mapping[str, Any], ax: Any) -> Any:
    """Draw measured points and curves, (N, outputs) each, one axes an output. units: output -> its SI unit, in order of columns;
    curves: label -> values."""
    from estimation.report.drawing.figures import broken_at_gaps
    from estimation.report.names import face

    axes = panels(ax, len(units))
    for i, (panel, (name, si)) in enumerate(zip(axes, units.items(), strict=True)):
        factor, unit = face(name, si)
        panel.plot(time, factor * measured[:, i], ".", color="0.6", markersize=2.0, label="measured")
        for label, values in curves.items():
            panel.plot(time, broken_at_gaps(time, factor * values[:, i]), linewidth=1.0, label=label)
        panel.set_ylabel(f"{name} [{unit}]" if unit else name)
    axes[0].legend(ncols=2, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    axes[-1].set_xlabel("time [s]")
    return axes


def panels(ax: Any, count: int, size: tuple[float, float] | None = None) -> Any:
    """(count,) axes one above the other: the given ones, or new ones of `size` [inches]. UserError for another number."""
    if ax is None:
        from matplotlib import pyplot as plt

        _, ax = plt.subplots(
            count, 1, sharex=True, squeeze=False, figsize=size or (7.0, 1.1 * count + 0.6), layout="constrained"
        )
    axes = np.atleast_1d(np.asarray(ax, dtype=object)).ravel()
    if axes.size != count:
        raise UserError(f"{axes.size} axes for {count} panels; give one for each, or none")
    return axes


Rows = tuple[Sequence[str], Iterable[Sequence[str]]]
"""Head and rows of a small table."""


class Answer(ABC):
    """The protocol of answers. File formats that a subclass does not have raise a UserError in `save`."""

    @abstractmethod
    def to_json(self) -> dict[str, Any]:
        """The content of the verb's --json."""

    @abstractmethod
    def lines(self) -> Iterable[str]:
        """The lines that the verb prints."""

    @abstractmethod
    def headline(self) -> str:
        """The answer in one line."""

    @abstractmethod
    def rows(self) -> Rows:
        """The table that a notebook shows."""

    @abstractmethod
    def plot(self, ax: Any = None) -> Any:
        """Draw on the given axes, or on new ones; returns the axes."""

    @property
    def passed(self) -> bool:
        """False for a failed check: the verb then ends with status 1."""
        return True

    def summary(self) -> str:
        """The text that the verb prints."""
        return "\n".join(self.lines())

    def figures(self) -> Figures:
        """The figures of the page by name, each drawn at its first use."""
        return Figures({})

    def report(self, folder: str | Path) -> Path:
        """Write the HTML page; returns its path."""
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
        """Ending of a file's name -> function that writes such a file."""
        return {".json": lambda path: write_json(self.to_json(), path)}

    def save(self, path: str | Path) -> Path:
        """Write a file in the format of its name's ending; returns the path. Raises UserError for an unknown ending."""
        path, writers = Path(path), self.writers()
        if path.suffix.lower() not in writers:
            endings = ", ".join(n for n in writers if n not in PICTURES or n == ".svg")
            raise UserError(f"{path}: no known format of this answer; end the name in one of {endings}")
        writers[path.suffix.lower()](path)
        return path

    def __repr__(self) -> str:
        return f"<{self.headline()}>"

    def _repr_html_(self) -> str:
        return html_table(self.headline(), *self.rows())


def table_writers(answer: Any) -> dict[str, Callable[[Path], Any]]:
    """The writer of an answer's table as CSV."""

    def write(path: Path) -> None:
        frame: pd.DataFrame = answer.to_pandas()
        with whole(path) as new:
            frame.to_csv(new, index=False)

    return {".csv": write}


def picture_writers(write: Callable[[Path], Any]) -> dict[str, Callable[[Path], Any]]:
    """The function under the ending of every picture format."""
    return dict.fromkeys(PICTURES, write)


def rounded_texts(estimate: Any) -> tuple[str, str]:
    """Estimate and corrected bound as texts, both rounded to the second figure of the bound."""
    from estimation.report.tables import rounded

    value, bound = rounded(estimate.estimate, estimate.std_coloured)
    return value, bound
