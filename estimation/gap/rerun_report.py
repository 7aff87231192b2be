"""The gap report as a rerun recording: measured, before and after of every channel on the flights' own time.

`sideslip view DIR/gap.rrd` opens it. One tab per flight with its channels and residuals, one with the verdict and the
scores of all hypotheses.
"""

import importlib.util
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from estimation.gap.errors import GapError
from estimation.gap.result import GapResult, Histories

if TYPE_CHECKING:
    import rerun as rr

APPLICATION = "sideslip gap"
CLOCK = "flight_time"
COURSES = {"measured": [136, 153, 166], "before": [200, 85, 61], "after": [42, 111, 151]}


def available() -> bool:
    """Whether rerun is installed."""
    return importlib.util.find_spec("rerun") is not None


def write_gap_recording(result: GapResult, path: Path) -> Path:
    """Write `path` (.rrd). Raises GapError where rerun is not installed or the file cannot be written."""
    if not available():
        raise GapError("a rerun recording needs rerun: pip install 'sideslip[ground]'")
    import rerun as rr

    stream = rr.RecordingStream(APPLICATION)
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        stream.save(str(path), default_blueprint=_blueprint(result))
    except (OSError, RuntimeError) as error:
        raise GapError(f"{path}: cannot be written ({error})") from error
    stream.log("verdict", rr.TextDocument(_words(result), media_type=rr.MediaType.MARKDOWN), static=True)
    stream.log("scores", rr.BarChart(np.array(list(result.scores.values()))), static=True)
    for h in result.histories:
        _flight(stream, h, result.outputs)
    for number, view in enumerate(result.views):
        for name, value in view.channels.items():
            stream.set_time("stage", sequence=number)
            stream.log(f"gap/{name}", rr.Scalars([value]))
    stream.flush()
    stream.disconnect()
    return path


def _flight(stream: "rr.RecordingStream", h: Histories, outputs: tuple[str, ...]) -> None:
    import rerun as rr

    place = _place(h)
    clock = rr.TimeColumn(CLOCK, duration=h.time)
    for c, name in enumerate(outputs):
        courses = {"measured": h.measured[:, c], "before": h.before[:, c], "after": h.after[:, c]}
        for course, values in courses.items():
            path = f"{place}/{name}/{course}"
            stream.log(path, rr.SeriesLines(colors=[COURSES[course]], names=[course]), static=True)
            stream.send_columns(path, indexes=[clock], columns=rr.Scalars.columns(scalars=values))
        for course in ("before", "after"):
            path = f"{place}/residual/{name}/{course}"
            stream.log(path, rr.SeriesLines(colors=[COURSES[course]], names=[course]), static=True)
            left = h.measured[:, c] - courses[course]
            stream.send_columns(path, indexes=[clock], columns=rr.Scalars.columns(scalars=left))


def _place(h: Histories) -> str:
    return f"{'held_out' if h.holdout else 'training'}/{h.flight}"


def _blueprint(result: GapResult) -> Any:
    import rerun.blueprint as rrb

    tabs: list[Any] = [
        rrb.Horizontal(
            rrb.TextDocumentView(origin="verdict", name="Verdict"),
            rrb.BarChartView(origin="scores", name="Scores of all hypotheses"),
            name="Verdict",
        )
    ]
    for h in result.histories:
        rows = [
            rrb.Horizontal(
                rrb.TimeSeriesView(origin=f"{_place(h)}/{name}", name=name),
                rrb.TimeSeriesView(origin=f"{_place(h)}/residual/{name}", name=f"{name} residual"),
            )
            for name in result.outputs
        ]
        tabs.append(rrb.Vertical(*rows, name=f"{h.flight}{' (held out)' if h.holdout else ''}"))
    return rrb.Blueprint(rrb.Tabs(*tabs), collapse_panels=True)


def _words(result: GapResult) -> str:
    """The verdict as Markdown with the table of steps and the leading scores."""
    parts = [f"# {result.verdict.value.replace('_', ' ')}", result.text]
    if result.steps:
        parts.append(
            "| effect | score | threshold | gap before | after | floor | closed |\n|---|---|---|---|---|---|---|"
        )
        parts[-1] += "".join(
            f"\n| {s.effect} | {s.score:.1f} | {s.threshold:.1f} | {s.gap.before:.2f} | {s.gap.after:.2f} "
            f"| {s.gap.floor:.2f} | {s.gap.closed:.0%} |"
            for s in result.steps
        )
    bars = [f"| {i} | {n} | {v:.1f} |" for i, (n, v) in enumerate(result.scores.items()) if i < 15]
    parts.append(
        f"Bars, null threshold {result.threshold:.2f}:\n\n| bar | effect | score |\n|---|---|---|\n" + "\n".join(bars)
    )
    return "\n\n".join(parts)
