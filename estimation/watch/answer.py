"""What the monitor found, in lines and on a page."""

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

BEFORE_S, AFTER_S = 30.0, 20.0  # s about an alarm that are cut out for the gap workflow
PAUSE_S = 2.0  # between two words of the monitor, beyond which no control moved and no line is drawn


def lines(found: Watched) -> Iterator[str]:
    """For a terminal."""
    c = found.calibration
    yield (
        f"{found.flight.name}, model {found.model}: {found.manoeuvring_s:.0f} s of manoeuvring watched; thresholds for "
        f"{c.rate:g} false alarms an hour from {c.hours:.1f} h of simulated flight"
    )
    if not found.alarms:
        yield f"no alarm; the largest score was {max((w.score for w in found.history), default=0.0):.0%} of its threshold"
    for a in found.alarms:
        yield f"t = {a.time:.1f} s: {a.text}"


def stretch(found: Watched) -> Flight:
    """The part of the flight about its first alarm, for the gap workflow."""
    first, time = found.alarms[0], found.flight.time
    keep = (time >= first.since - BEFORE_S) & (time <= first.time + AFTER_S)
    return found.flight.part(keep, f"{found.flight.name}_alarm")


def gap_command(path: Path, model: str, aircraft: str | None) -> str:
    """What to type next."""
    return f"sideslip gap {path} --model {model}" + ("" if aircraft is None else f" --aircraft {aircraft}")


def write_watch_report(found: Watched, folder: Path, command: str) -> Path:
    """Write folder/index.html, with its tables as CSV and LaTeX beside it; returns the page."""
    head, *rest = lines(found)
    alarms = _alarm_table(found)
    sentences = [paragraph(sentence(line)) for line in rest]
    follow = paragraph(Markup("Next: <code>{}</code>").format(command)) if command and found.alarms else None
    sections = [
        Section("watch_history", "Score", [history_picture(found)], "Score"),
        Section("alarms", "Alarms", [*sentences, alarms if alarms.rows else None, follow], "Alarms"),
        Section("provenance_of_flights", "Provenance", [provenance_table([found.flight])], "Provenance"),
    ]
    page = Page(f"Gap monitor: {found.flight.name}", f"{head}.", sections, beside=[alarms])
    return page.write(folder / "index.html", folder / "tables")


def history_picture(found: Watched) -> Picture:
    """Score in units of its threshold over the flight."""
    from matplotlib.figure import Figure

    with styled():
        figure = Figure(figsize=(7.2, 2.6), layout="constrained")
        draw_history(found, figure.subplots())
    return picture(
        figure, "watch_history", "The larger of both statistics over its threshold; blank where no control moved."
    )


def draw_history(found: Watched, axes: Any) -> None:
    """The score over its threshold on axes, with a line where an alarm was told."""
    time, score = np.array([w.time for w in found.history]), np.array([w.score for w in found.history])
    pauses = np.flatnonzero(np.diff(time) > PAUSE_S) + 1
    axes.plot(np.insert(time, pauses, np.nan), np.insert(score, pauses, np.nan), color="#0072B2")
    axes.axhline(1.0, color="#D55E00", linestyle="--")
    for a in found.alarms:
        axes.axvline(a.time, color="#D55E00", linewidth=0.8)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("score / threshold")


def _alarm_table(found: Watched) -> ReportTable:
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
        for a in found.alarms
    )
    head = ("noticed [s]", "since [s]", "equation", "shown by", "score", "threshold", "leading")
    return ReportTable("alarms", "Alarms", head, rows, symbols=False, texts=(6,))
