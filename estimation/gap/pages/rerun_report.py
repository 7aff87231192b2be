"""The gap report as a rerun recording: measured, before and after of every channel on the flights' own time.

`sideslip view DIR/gap.rrd` opens it. The first tab has the verdict, where the disagreement lives and the scores of all
hypotheses; then one tab per flight with its channels, their residuals and the noise floor. Angles are in degrees.
"""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from daq.utilities.durable import make_directories
from daq.utilities.packages import installed
from estimation.engine.kernel import Array
from estimation.errors import GapError
from estimation.gap.answer.result import GapResult, Histories
from estimation.report.names import face
from groundstation.flight.writing import rerun_file

if TYPE_CHECKING:
    import rerun as rr

APPLICATION = "sideslip gap"
CLOCK = "flight_time"
COURSES = {"measured": [136, 153, 166], "before": [200, 85, 61], "after": [74, 158, 210]}
FLOOR = [112, 122, 132]
BAR = 28  # characters of the longest score
# letters that rerun's only font lacks; its native viewer stops at the first of them
UNDRAWN = re.compile("[^\n -~¡-¬®-ňŊ-ſΑ-ΡΣ-Ωα-ωА-я\u0302\u0307ḣṗṙẊ→−√≠■…]")


def available() -> bool:
    """Whether rerun is installed."""
    return installed(["rerun"])


def drawable(text: str) -> str:
    """`text` with a question mark for every letter that rerun's viewer cannot draw."""
    return UNDRAWN.sub("?", text)


def write_gap_recording(result: GapResult, path: Path) -> Path:
    """Write `path` (.rrd). Raises GapError where rerun is not installed or the file cannot be written."""
    if not available():
        raise GapError("a rerun recording needs rerun: pip install 'sideslip[ground]'")
    import rerun as rr

    stream = rr.RecordingStream(APPLICATION)
    units = {s.name: face(s.name, s.unit) for s in result.model_before.outputs}
    try:
        make_directories(path.parent)
        with rerun_file(stream, path, _blueprint(result, units)):
            for name, text in (("verdict", _verdict(result)), ("where", _where(result)), ("scores", _scores(result))):
                stream.log(name, rr.TextDocument(drawable(text), media_type=rr.MediaType.MARKDOWN), static=True)
            for h, place in _placed(result):
                for c, name in enumerate(result.outputs):
                    _channel(stream, place, h, c, name, *units[name])
    except OSError as error:
        raise GapError(f"{path}: cannot be written ({error.strerror or error})") from error
    return path


def _channel(stream: "rr.RecordingStream", flight: str, h: Histories, c: int, name: str, k: float, unit: str) -> None:
    """One channel of one flight: measured and modelled values, and residuals with the noise floor. k: factor to `unit`."""
    import rerun as rr

    place, residual = f"{flight}/{name}", f"{flight}/residual/{name}"
    courses = {"measured": h.measured[:, c], "before": h.before[:, c], "after": h.after[:, c]}
    edge, ends = k * float(h.floor[c]), np.array([h.time[0], h.time[-1]])
    for side, level in (("upper", edge), ("lower", -edge)):
        sign = "+" if level > 0 else "−"
        _series(stream, f"{residual}/floor_{side}", ends, np.full(2, level), f"floor, {sign}1 σ [{unit}]", FLOOR)
    for course, values in courses.items():
        label, colour = f"{course} [{unit}]", COURSES[course]
        _series(stream, f"{place}/{course}", h.time, k * values, label, colour)
        if course != "measured":
            _series(stream, f"{residual}/{course}", h.time, k * (courses["measured"] - values), label, colour)
    stream.log(place, rr.AnyValues(unit=unit), static=True)


def _series(stream: "rr.RecordingStream", path: str, time: Array, values: Array, name: str, colour: list[int]) -> None:
    import rerun as rr

    dots = path.endswith("/measured")  # a line would hide those of the models
    points = rr.SeriesPoints(colors=[colour], names=[name], markers="circle", marker_sizes=[1.2])
    stream.log(path, points if dots else rr.SeriesLines(colors=[colour], names=[name]), static=True)
    clock = rr.TimeColumn(CLOCK, duration=time)
    stream.send_columns(path, indexes=[clock], columns=rr.Scalars.columns(scalars=values))


def _placed(result: GapResult) -> list[tuple[Histories, str]]:
    """Every flight with its entity path; flights of one name, from different folders, are numbered."""
    import rerun as rr

    places: list[str] = []
    for h in result.histories:
        path = f"{'held_out' if h.holdout else 'training'}/{rr.escape_entity_path_part(drawable(h.flight))}"
        number = 1 + sum(p == path or p.startswith(f"{path}_again") for p in places)
        places.append(path if number == 1 else f"{path}_again{number}")
    return list(zip(result.histories, places, strict=True))


def _blueprint(result: GapResult, units: dict[str, tuple[float, str]]) -> Any:
    import rerun.blueprint as rrb

    words = rrb.Vertical(
        rrb.TextDocumentView(origin="verdict", name="Verdict"), rrb.TextDocumentView(origin="where", name="Where")
    )
    scores = rrb.TextDocumentView(origin="scores", name="Scores of all hypotheses")
    tabs: list[Any] = [rrb.Horizontal(words, scores, name="Verdict")]
    for h, place in _placed(result):
        rows = []
        for row, name in enumerate(result.outputs):
            legend = rrb.PlotLegend(rrb.Corner2D.RightTop, visible=row == 0)  # colours are the same in all rows
            _, unit = units[name]
            courses = rrb.TimeSeriesView(origin=f"{place}/{name}", name=f"{name} [{unit}]", plot_legend=legend)
            residuals = rrb.TimeSeriesView(
                origin=f"{place}/residual/{name}", name=f"{name} residual [{unit}]", plot_legend=legend
            )
            rows.append(rrb.Horizontal(courses, residuals))
        tabs.append(rrb.Vertical(*rows, name=f"{drawable(h.flight)}{' (held out)' if h.holdout else ''}"))
    panels = (rrb.BlueprintPanel(state="collapsed"), rrb.SelectionPanel(state="collapsed"))
    return rrb.Blueprint(rrb.Tabs(*tabs), *panels, rrb.TimePanel(state="collapsed", timeline=CLOCK))


def _table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def _verdict(result: GapResult) -> str:
    """The verdict as Markdown with the table of steps."""
    parts = [f"# {result.verdict.value.replace('_', ' ')}", result.text]
    if result.steps:
        rows = [
            [s.effect, f"{s.score:.1f}", f"{s.threshold:.1f}", f"{s.gap.before:.2f}", f"{s.gap.after:.2f}",
             f"{s.gap.floor:.2f}", s.gap.share, "-" if s.holdout is None else s.holdout.share]
            for s in result.steps
        ]  # fmt: skip
        head = ["effect", "score", "threshold", "gap before", "after", "floor", "closed", "closed, held out"]
        parts.append(_table(head, rows))
    return "\n\n".join(parts)


def _where(result: GapResult) -> str:
    """rms residual over noise by stage and channel, as Markdown."""
    if not result.views:
        return "Not located."
    rows = [
        [v.stage, f"**{v.gap:.2f}**", *(f"{v.channels[n]:.2f}" if n in v.channels else "" for n in result.outputs)]
        for v in result.views
    ]
    return "Residual in units of the noise of each channel, rms\n\n" + _table(["stage", "all", *result.outputs], rows)


def _scores(result: GapResult) -> str:
    """Every hypothesis with its score as a bar, and where the null threshold cuts them, as Markdown."""
    longest = max([*result.scores.values(), result.threshold])
    rows = [["■" * round(BAR * v / longest), f"{v:.1f}", n] for n, v in result.scores.items()]
    cut = sum(v > result.threshold for v in result.scores.values())  # they come highest first
    limit = "-" * round(BAR * result.threshold / longest)
    rows.insert(cut, [limit, f"**{result.threshold:.2f}**", "**null threshold**"])
    return "In units of the scatter on simulated nulls\n\n" + _table(["", "score", "effect"], rows)
