"""The result of the gap monitor, in lines and on a page."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from estimation.report.drawing.figures import Picture, picture, styled
from estimation.report.flight_tables import provenance_table
from estimation.report.page import Page, Section, paragraph, sentence
from estimation.report.tables import ReportTable, significant
from estimation.watch.over_file import Watched
from groundstation.flight import Flight

BEFORE_S, AFTER_S = 30.0, 20.0  # s before and after an alarm that are cut out for the gap workflow
PAUSE_S = 2.0  # between two states of the monitor, above which the drawn line is broken: no control moved


def lines(watched: Watched) -> Iterator[str]:
    """Lines for the terminal."""
    c = watched.calibration
    yield (
        f"{watched.flight.name}, model {watched.model}: {watched.manoeuvring_s:.0f} s of manoeuvring watched; thresholds for "
        f"{c.rate:g} false alarms an hour from {c.hours:.1f} h of simulated flight"
    )
    if not watched.alarms:
        yield f"no alarm; the largest score was {max((w.score for w in watched.history), default=0.0):.0%} of its threshold"
    for a in watched.alarms:
        yield f"t = {a.time:.1f} s: {a.text}"


def stretch(watched: Watched) -> Flight:
    """The part of the flight about its first alarm, for the gap workflow."""
    first, time = watched.alarms[0], watched.flight.time
    keep = (time >= first.since - BEFORE_S) & (time <= first.time + AFTER_S)
    return watched.flight.part(keep, f"{watched.flight.name}_alarm")


def gap_command(path: Path, model: str, aircraft: str | None) -> str:
    """The command that explains an alarm."""
    return f"sideslip gap {path} --model {model}" + ("" if aircraft is None else f" --aircraft {aircraft}")


def write_watch_report(watched: Watched, folder: Path, command: str) -> Path:
    """Write folder/index.html, with its tables as CSV and LaTeX beside it; returns the page."""
    head, *rest = lines(watched)
    alarms = _alarm_table(watched)
    sentences = [paragraph(sentence(line)) for line in rest]
    follow = paragraph(Markup("Next: <code>{}</code>").format(command)) if command and watched.alarms else None
    sections = [
        Section("watch_history", "Score", [history_picture(watched)], "Score"),
        Section("alarms", "Alarms", [*sentences, alarms if alarms.rows else None, follow], "Alarms"),
        Section("provenance_of_flights", "Provenance", [provenance_table([watched.flight])], "Provenance"),
    ]
    page = Page(f"Gap monitor: {watched.flight.name}", f"{head}.", sections, beside=[alarms])
    return page.write(folder / "index.html", folder / "tables")


def history_picture(watched: Watched) -> Picture:
    """Score in units of its threshold over the flight."""
    from matplotlib.figure import Figure

    with styled():
        figure = Figure(figsize=(7.2, 2.6), layout="constrained")
        draw_history(watched, figure.subplots())
    return picture(
        figure, "watch_history", "The larger of both statistics over its threshold; no line where no control moved."
    )


def draw_history(watched: Watched, axes: Any) -> None:
    """The score over its threshold on axes, with a line at each alarm."""
    time, score = np.array([w.time for w in watched.history]), np.array([w.score for w in watched.history])
    pauses = np.flatnonzero(np.diff(time) > PAUSE_S) + 1
    axes.plot(np.insert(time, pauses, np.nan), np.insert(score, pauses, np.nan), color="#0072B2")
    axes.axhline(1.0, color="#D55E00", linestyle="--")
    for a in watched.alarms:
        axes.axvline(a.time, color="#D55E00", linewidth=0.8)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("score / threshold")


def _alarm_table(watched: Watched) -> ReportTable:
    rows = tuple(
        (
            f"{a.time:.1f}",
            f"{a.since:.1f}",
            a.equation,
            ", ".join(a.channels),
            f"{a.score:.1f}",
            f"{a.threshold:.1f}",
            "; ".join(f"{n.effect} {significant(n.size, 2)} {n.unit}".removesuffix(" 1") for n in a.leading)
            or "none of the list",
        )
        for a in watched.alarms
    )
    head = ("noticed [s]", "since [s]", "equation", "shown by", "score", "threshold", "leading")
    return ReportTable("alarms", "Alarms", head, rows, symbols=False, texts=(6,))
