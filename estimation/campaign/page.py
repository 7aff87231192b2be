"""The page of a campaign, made from its tables alone: what was found, every flight, trends, envelope, residuals, failures."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from estimation.campaign.groups import label_of
from estimation.campaign.plan import Plan
from estimation.campaign.pooling import LEVEL
from estimation.campaign.run import Outcome
from estimation.campaign.tasks import Row
from estimation.report.figures import Picture, picture, styled
from estimation.report.html import write_page
from estimation.report.names import tex
from estimation.report.tables import Table, number, significant, write_all

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]

SHOWN = 60  # sentences, and flights of the table of residuals; the tables hold all
PANELS = 3  # beside each other
FEWEST_FOR_TRENDS = 5  # flights: below, a trend over conditions is anybody's guess
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")  # Okabe and Ito's
CONDITIONS = {"alpha": ("angle of attack", "deg", 180.0 / np.pi), "V": ("airspeed", "m/s", 1.0)}


@dataclass(frozen=True)
class Points:
    """Estimates of one parameter by one method over the flights: arrays (flights,), labels of their groups."""

    parameter: str
    order: Array
    y: Array
    std: Array
    groups: tuple[str, ...]
    conditions: Mapping[str, Array]


def write_campaign_page(outcome: Outcome, plan: Plan, folder: Path) -> Path:
    """Write folder/index.html with everything inside, and its tables as CSV and LaTeX in folder/tables; returns the page."""
    said = [r["text"] for r in outcome.groups if _told(r)]
    pooled = [t for method in plan.methods if (t := _pooled_table(outcome.groups, method)) is not None]
    power, worst = _power_table(outcome.groups), _worst_table(outcome.results)
    failures = Table(
        "failed", "Flights without a usable estimate", ("flight", "why"), tuple(outcome.failed.items()), symbols=False
    )
    write_all([*pooled, worst, failures, *([power] if power else [])], folder / "tables")
    points = {method: points_of(outcome.results, method, plan.groups) for method in plan.methods}
    return write_page(
        folder / "index.html",
        "campaign.html.j2",
        title="Campaign",
        lead=f"Model {plan.model}; methods: {', '.join(plan.methods)}; groups by {', '.join(plan.groups) or 'nothing'}.",
        flights=outcome.flights,
        done=outcome.done,
        failed=outcome.failed,
        failures=failures,
        said=said[:SHOWN],
        more=max(0, len(said) - SHOWN),
        power=power,
        pooled=pooled,
        worst=worst,
        scatter=[_scatter_figure(method, p, outcome.groups) for method, p in points.items() if p],
        trends=[f for method, p in points.items() if p for f in _trend_figures(method, p)],
        envelope=_envelope_figure(outcome.results, plan.groups),
    )


def _told(row: Row) -> bool:
    return row["kind"] in ("outlier", "step") or (row["kind"] == "difference" and row["probability"] <= LEVEL)


# ------------------------------------------------------------------------------------------------ tables


def _pooled_table(groups: Sequence[Row], method: str) -> Table | None:
    rows = [r for r in groups if r["kind"] == "pooled" and r["method"] == method]
    cells = tuple(
        (
            r["parameter"],
            r["group"],
            str(r["flights"]),
            number(r["estimate"]),
            significant(r["std"], 2),
            significant(r["between"], 2),
            significant(r["scatter"], 2),
            significant(r["bound"], 2),
            significant(r["ratio"], 2),
        )
        for r in sorted(rows, key=lambda r: (r["parameter"], r["group"]))
    )
    head = (
        "parameter",
        "group",
        "flights",
        "estimate",
        "std",
        "between flights",
        "scatter",
        "bound",
        "scatter / bound",
    )
    return (
        Table(
            f"pooled_{method.replace(':', '_')}",
            f"Pooled over flights, {method}",
            head,
            cells,
            note="std: of the pooled estimate; between flights: standard deviation beyond the flights' own bounds (REML); "
            "scatter: sample standard deviation; bound: rms of the corrected bounds. Sound bounds have a ratio near 1.",
        )
        if cells
        else None
    )


def _power_table(groups: Sequence[Row]) -> Table | None:
    rows = [r for r in groups if r["kind"] == "difference"]
    cells = tuple(
        (
            r["parameter"],
            r["method"],
            f"{r['other']} less {r['group']}",
            number(r["estimate"]),
            significant(r["std"], 2),
            significant(r["probability"], 2),
            significant(r["detectable"], 2),
            significant(r["power"], 2),
        )
        for r in sorted(rows, key=lambda r: r["probability"])
    )
    head = ("parameter", "method", "groups", "difference", "std", "probability", "detectable", "power for 5 %")
    note = "Probability heeds the number of parameters compared; detectable: the least difference found four times in five."
    return Table("differences", "Differences between groups", head, cells, note=note) if cells else None


def _worst_table(results: "pa.Table") -> Table:
    import pyarrow.compute as pc

    fits = results.filter(pc.and_(pc.equal(results["kind"], "fit"), pc.is_valid(results["r2"])))
    rows = fits.sort_by([("r2", "ascending"), ("flight", "ascending"), ("parameter", "ascending")]).slice(0, 20)
    cells = tuple(
        (str(r["flight"]), r["method"], r["parameter"], number(r["r2"], 3), significant(r["rms"]), r["status"])
        for r in rows.to_pylist()
    )
    head = ("flight", "method", "channel", "r²", "rms [SI]", "status")
    return Table("worst", "The 20 channels that the model explains least", head, cells, symbols=False)


# ------------------------------------------------------------------------------------------------ figures


def points_of(results: "pa.Table", method: str, keys: Sequence[str]) -> list[Points]:
    """Usable estimates by parameter, in order of date and name."""
    import pyarrow.compute as pc

    keep = pc.and_(pc.equal(results["kind"], "estimate"), pc.equal(results["method"], method))
    wanted = ("flight", "date", "key", "parameter", "estimate", "std_coloured", "identifiable", *CONDITIONS, *keys)
    sound = results.filter(pc.and_(keep, pc.equal(results["status"], "ok")))
    rows = sound.select(list(dict.fromkeys(wanted))).to_pylist()
    rows = [r for r in rows if r["identifiable"] and r["estimate"] is not None and r["std_coloured"]]
    flights = sorted({(r["date"] or "", r["flight"], r["key"]) for r in rows})
    place = {key: i for i, (_, _, key) in enumerate(flights)}
    return [
        _points(name, sorted((r for r in rows if r["parameter"] == name), key=lambda r: place[r["key"]]), place, keys)
        for name in dict.fromkeys(r["parameter"] for r in rows)
    ]


def _points(name: str, rows: Sequence[Row], place: Mapping[str, int], keys: Sequence[str]) -> Points:
    def column(key: str) -> Array:
        return np.array([np.nan if r[key] is None else r[key] for r in rows], float)

    groups = tuple(label_of({k: r[k] or "" for k in keys}) for r in rows)
    order = np.array([place[r["key"]] for r in rows], float)
    return Points(name, order, column("estimate"), column("std_coloured"), groups, {c: column(c) for c in CONDITIONS})


def _colours(points: Sequence[Points]) -> dict[str, str]:
    labels = sorted({g for p in points for g in p.groups})
    return {label: COLOURS[i % len(COLOURS)] for i, label in enumerate(labels)}


def _grid(count: int) -> tuple[Any, list[Any]]:
    from matplotlib.figure import Figure

    rows = -(-count // PANELS)
    figure = Figure(figsize=(11.6, 2.1 * rows + 0.6), layout="constrained")
    axes = figure.subplots(rows, PANELS, squeeze=False).ravel().tolist()
    for spare in axes[count:]:
        spare.set_visible(False)
    return figure, axes


def _draw(axis: Any, p: Points, x: Array, colours: Mapping[str, str]) -> None:
    """Estimates with corrected bounds, a colour a group; the axis holds the middle nine tenths and what is near."""
    for label, colour in colours.items():
        mine = np.array([g == label for g in p.groups]) & np.isfinite(x)
        if mine.any():
            axis.errorbar(x[mine], p.y[mine], p.std[mine], fmt=".", ms=4, lw=0.7, color=colour, label=label)
    low, high = np.quantile(p.y, [0.05, 0.95])
    room = max(float(high - low), float(np.median(p.std)) * 2.0)
    axis.set_ylim(low - room, high + room)
    axis.set_ylabel(f"${tex(p.parameter)}$")


def _scatter_figure(method: str, points: Sequence[Points], groups: Sequence[Row]) -> Picture:
    """The paper's Figure 8 over many flights: estimates in order of date, pooled value and its 95 % as a band."""
    colours = _colours(points)
    with styled():
        figure, axes = _grid(len(points))
        for axis, p in zip(axes, points, strict=False):
            _draw(axis, p, p.order, colours)
            for r in groups:
                if r["kind"] == "pooled" and (r["method"], r["parameter"]) == (method, p.parameter):
                    axis.axhspan(r["low"], r["high"], color=colours.get(r["group"], "#888888"), alpha=0.25, lw=0)
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    name = method.replace(":", "_")
    caption = f"Estimates of every flight by {method}, in order of date, with corrected bounds; band: 95 % of the pooled value."
    return picture(figure, f"flights_{name}", caption, sum(6 * p.y.size for p in points))


def _trend_figures(method: str, points: Sequence[Points]) -> list[Picture]:
    colours = _colours(points)
    pictures = []
    for condition, (title, unit, factor) in CONDITIONS.items():
        if all(np.isfinite(p.conditions[condition]).sum() < FEWEST_FOR_TRENDS for p in points):
            continue
        with styled():
            figure, axes = _grid(len(points))
            for axis, p in zip(axes, points, strict=False):
                _draw(axis, p, factor * p.conditions[condition], colours)
                axis.set_xlabel(f"{title} [{unit}]")
        caption = f"Estimates by {method} over mean {title}, with corrected bounds."
        size = sum(6 * p.y.size for p in points)
        pictures.append(picture(figure, f"trend_{condition}_{method.replace(':', '_')}", caption, size))
    return pictures


def _envelope_figure(results: "pa.Table", keys: Sequence[str]) -> Picture | None:
    """Airspeed and angle of attack of each flight: mean as a point, range as a cross."""
    import pyarrow.compute as pc
    from matplotlib.figure import Figure

    wanted = dict.fromkeys(("V", "V_min", "V_max", "alpha", "alpha_min", "alpha_max", *keys))
    rows = results.filter(pc.equal(results["kind"], "run")).select(list(wanted)).to_pylist()
    rows = [r for r in rows if r["V"] is not None and r["alpha"] is not None]
    if not rows:
        return None
    with styled():
        figure = Figure(figsize=(6.4, 4.0), layout="constrained")
        axis = figure.subplots()
        labels = sorted({label_of({k: r[k] or "" for k in keys}) for r in rows})
        for i, label in enumerate(labels):
            mine = [r for r in rows if label_of({k: r[k] or "" for k in keys}) == label]
            v, a = (np.array([r[c] for r in mine]) for c in ("V", "alpha"))
            dv = np.abs(np.array([[r["V_min"], r["V_max"]] for r in mine]).T - v)
            da = np.abs(np.array([[r["alpha_min"], r["alpha_max"]] for r in mine]).T - a)
            colour = COLOURS[i % len(COLOURS)]
            axis.errorbar(
                v, np.degrees(a), np.degrees(da), dv, fmt=".", ms=4, lw=0.4, alpha=0.5, color=colour, label=label
            )
        axis.set_xlabel("airspeed [m/s]")
        axis.set_ylabel("angle of attack [deg]")
        axis.legend(loc="upper right")
    return picture(figure, "envelope", "Envelope flown: mean and range of each flight.", 8 * len(rows))
