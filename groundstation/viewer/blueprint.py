"""The layout of the viewer: a full page for a ground station, a light one for weak machines, one column for a phone.

Live, plots are sliding windows of WINDOW_S; for a recorded flight they span the whole flight. The layout is embedded in every
recording that is shown or written; `sideslip view FILE --save-blueprint PATH.rbl` saves it alone, for rerun's own use.
"""

import inspect
import tempfile
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import rerun as rr
import rerun.blueprint as rrb

from daq.identification.airframe import EQUATIONS
from daq.utilities.durable import write_bytes
from groundstation.viewer import entities as e

Layout = Literal["full", "light", "phone"]
WINDOW_S = 30.0  # two manoeuvres; a window of a minute is empty for the first half of a short flight


def _window(live: bool) -> dict[str, Any]:
    """Arguments of a time series view that make it a sliding window (live) or the whole flight."""
    if not live:
        return {}
    start = rr.TimeRangeBoundary.cursor_relative(seconds=-WINDOW_S)
    end = rr.TimeRangeBoundary.cursor_relative(seconds=0.0)
    return {
        "axis_x": rrb.TimeAxis(view_range=rr.TimeRange(start=start, end=end)),
        "time_ranges": [rrb.VisibleTimeRange(e.TIMELINE, start=start, end=end)],
    }


# Vertical scales of the live plots, in the units shown: rerun fits an axis only once, to the first data.
SCALES: Mapping[str, tuple[float, float]] = {
    "Alpha, beta": (-20.0, 20.0),
    "True airspeed": (0.0, 35.0),
    "Rates": (-60.0, 60.0),
    "Attitude": (-180.0, 180.0),
    "Specific force": (-25.0, 15.0),
    "Controls: potentiometer and PWM": (-20.0, 20.0),
}


def _plot(name: str, contents: list[str], live: bool) -> rrb.TimeSeriesView:
    legend = rrb.PlotLegend(rrb.Corner2D.LeftTop)
    extra = _window(live)
    if live and name in SCALES:
        extra["axis_y"] = rrb.ScalarAxis(range=SCALES[name])
    return rrb.TimeSeriesView(origin="/", contents=contents, name=name, plot_legend=legend, **extra)


def _plots(live: bool) -> dict[str, rrb.TimeSeriesView]:
    return {
        "airdata": _plot("Alpha, beta", ["/airdata/angles", "/model/airdata/angles"], live),
        "speed": _plot("True airspeed", ["/airdata/speed", "/model/airdata/speed"], live),
        "rates": _plot("Rates", ["/rates", "/model/rates"], live),
        "attitude": _plot("Attitude", ["/attitude", "/model/attitude"], live),
        "acceleration": _plot("Specific force", ["/acceleration", "/model/acceleration"], live),
        "controls": _plot("Controls: potentiometer and PWM", ["/controls/measured", "/controls/commanded"], live),
        "power": _plot("Thrust and supply", ["/propulsion", "/power", "/controls/throttle"], live),
        "altitude": _plot("Altitude", ["/airdata/altitude", "/gnss/altitude"], live),
        "inputs": _plot("Analog and digital inputs", ["/inputs/analog", "/inputs/digital"], live),
        "link": _plot("Link quality", [e.LINK_LOSS, e.LINK_RATE], live),
        "signal": _plot("Signal, latency", [e.LINK_SIGNAL, e.LINK_LATENCY], live),
    }


def blueprint(
    layout: Layout = "full",
    *,
    live: bool = True,
    identified: bool = True,
    coefficients: Sequence[str] = tuple(EQUATIONS),
) -> rrb.Blueprint:
    """The blueprint for a live or a recorded flight. identified: with a page for live identification of `coefficients`."""
    plots = _plots(live)
    columns = rrb.TextLogColumns(text_log_columns=["loglevel", "body"])
    events = rrb.TextLogView(origin=e.EVENTS, name="Events and alarms", columns=columns)
    following = "following" if live else "paused"
    panels = (
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=e.TIMELINE, play_state=following),
    )
    derivatives = rrb.TextDocumentView(origin=e.IDENTIFIED, name=IDENTIFICATION)
    if layout == "phone":
        texts = rrb.Tabs(events, derivatives) if identified and live else events
        return rrb.Blueprint(rrb.Vertical(texts, plots["airdata"], plots["rates"]), *panels)
    if layout == "light":
        plots_left = rrb.Vertical(plots["airdata"], plots["rates"], plots["controls"])
        right = rrb.Vertical(events, derivatives, row_shares=[1, 1.6]) if identified and live else events
        return rrb.Blueprint(
            rrb.Horizontal(plots_left, right, column_shares=[3, 2 if right is not events else 1]), *panels
        )
    chase = rrb.Spatial3DView(
        origin=e.ATTITUDE,
        name="Attitude",
        background=[18, 22, 28],
        line_grid=rrb.LineGrid3D(spacing=1.0, plane=rr.components.Plane3D((0.0, 0.0, 1.0), 1.5), color=[70, 80, 95]),
        eye_controls=rrb.EyeControls3D(
            position=(-1.9, 0.5, -0.8), look_target=(0.0, 0.0, 0.0), eye_up=(0.0, 0.0, -1.0)
        ),
    )
    track = rrb.Spatial3DView(origin="/world", name="Track", contents=["/world/**"], background=[18, 22, 28])
    map_view = rrb.MapView(origin="/map", name="Map")
    status = rrb.TextDocumentView(origin=e.STATUS, name="Status")
    health = rrb.StateTimelineView(origin=e.HEALTH, name="Sensor health")
    plots_left = rrb.Vertical(plots["airdata"], plots["rates"], plots["controls"], plots["acceleration"])
    middle = rrb.Vertical(
        rrb.Tabs(chase, track, map_view, name="Where"),
        plots["attitude"],
        rrb.Tabs(plots["speed"], plots["altitude"], plots["power"], plots["inputs"]),
        row_shares=[2, 1, 1],
    )
    link = rrb.Tabs(plots["link"], plots["signal"])
    right = rrb.Vertical(health, link, row_shares=[2.2, 1])
    # the log is below both, over their whole width: lines longer than its pane are cut off
    right_side = rrb.Vertical(
        rrb.Horizontal(middle, right, column_shares=[1.1, 0.9]), rrb.Tabs(events, status), row_shares=[3.4, 1.0]
    )
    flying = rrb.Horizontal(plots_left, right_side, column_shares=[1.3, 2.0], name="Flight")
    if not identified:
        return rrb.Blueprint(flying, *panels)
    return rrb.Blueprint(rrb.Tabs(flying, _identification(live, coefficients), active_tab=0), *panels)


IDENTIFICATION = "Live identification"
IDENTIFIED_SCALE = (-4.0, 4.0)  # standard deviations of the belief


def _identification(live: bool, coefficients: Sequence[str]) -> rrb.Horizontal:
    """The page of live identification: a plot per coefficient of its derivatives with their bands, and live a text beside."""
    plots = [
        rrb.TimeSeriesView(
            origin=f"{e.IDENTIFICATION}/{coefficient}",
            name=f"{coefficient}: away from belief, in its standard deviations",
            plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop),
            axis_y=rrb.ScalarAxis(range=IDENTIFIED_SCALE),
        )
        for coefficient in coefficients
    ]
    curves = rrb.Vertical(*plots)
    if not live:
        return rrb.Horizontal(curves, name=IDENTIFICATION)
    words = rrb.TextDocumentView(origin=e.IDENTIFIED, name="Derivatives")
    return rrb.Horizontal(curves, words, column_shares=[1.2, 1.0], name=IDENTIFICATION)


def save_blueprint(path: Path, layout: Layout = "full") -> None:
    """Write the layout for live data as .rbl; OSError when the file cannot be written."""
    with tempfile.TemporaryDirectory() as folder:
        scratch = Path(folder) / "layout.rbl"
        fitted(blueprint(layout), live=True, layout=layout).save(e.APPLICATION, str(scratch))
        write_bytes(path, scratch.read_bytes())


TOP, LIVE_TOP = 0.10, 0.13
"""Shares of the height for the read-outs: one line on a screen of 720 lines or more; live and on a light page two, since the time
of day wraps on a screen of 1280 columns or less."""
NARROW_TOP = 0.30  # the same on a phone: four lines of read-outs, and the alarms in words below them
CONTAINERS = (rrb.Vertical, rrb.Horizontal, rrb.Tabs, rrb.Grid)


def fitted(
    page: rrb.Blueprint, *, live: bool, filled: Collection[str] | None = None, layout: Layout = "full"
) -> rrb.Blueprint:
    """The layout with read-outs and, live, the alarms above it.

    filled: entities with something to show; None: all. Panes without any, and containers without panes, are removed.
    """
    body = page.root_container if filled is None else _without_empty(page.root_container, filled)
    narrow = layout == "phone"
    top = _top(live=live, narrow=narrow) if filled is None or e.READOUTS in filled else None
    wide = LIVE_TOP if live or layout == "light" else TOP
    height = NARROW_TOP * (1.0 if live else 0.5) if narrow else wide  # a recorded flight has no alarms there
    rows = [(part, share) for part, share in ((top, height), (body, 1.0 - height)) if part is not None]
    if rows:
        page.root_container = rrb.Vertical(*(p for p, _ in rows), row_shares=[s for _, s in rows])
    return page


def _top(*, live: bool, narrow: bool) -> rrb.Container:
    """Read-outs; live with the alarms in words, and a lamp in the colour of the highest."""
    readouts = _without_title(rrb.TextDocumentView(origin=e.READOUTS, name="Read-outs"))
    if not live:
        return rrb.Horizontal(readouts)
    words = _without_title(rrb.TextDocumentView(origin=e.ALARM_WORDS, name="Alarms"))
    if narrow:
        return rrb.Vertical(readouts, words, row_shares=[1.4, 1.0])
    lamp = _without_title(rrb.StateTimelineView(origin=e.ALARM, name="Alarm"))
    return rrb.Horizontal(readouts, words, lamp, column_shares=[3.4, 1.4, 0.4])


def _without_title(view: rrb.View) -> rrb.View:
    """The view without its title bar, which is as high as a line of read-outs."""
    view.titlebar = False
    return view


def _without_empty(pane: rrb.Container | rrb.View, filled: Collection[str]) -> rrb.Container | rrb.View | None:
    """The pane without its empty parts; None where all are empty."""
    if not isinstance(pane, CONTAINERS):
        return pane if _shows(pane, filled) else None
    parts = [(i, part) for i, inner in enumerate(pane.contents) if (part := _without_empty(inner, filled)) is not None]
    if not parts:
        return None
    rows, columns = (s and [s[i] for i, _ in parts] for s in (pane.row_shares, pane.column_shares))
    arguments = {"row_shares": rows, "column_shares": columns, "grid_columns": pane.grid_columns, "name": pane.name}
    kind = next(k for k in CONTAINERS if isinstance(pane, k))
    accepted = inspect.signature(kind.__init__).parameters
    chosen_arguments = {name: value for name, value in arguments.items() if name in accepted and value is not None}
    return kind(*(part for _, part in parts), **chosen_arguments)


def _shows(view: rrb.View, filled: Collection[str]) -> bool:
    """Whether any of a view's entities is filled."""
    contents = [view.contents] if isinstance(view.contents, str) else list(view.contents)
    for text in contents:
        entity = str(text).replace("$origin", str(view.origin)).lstrip("+ ")
        root = entity.removesuffix("/**")
        if any(f == root or (root != entity and f.startswith(f"{root}/")) for f in filled):
            return True
    return False
