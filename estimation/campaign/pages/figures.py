"""Figures of the campaign's page: every flight, trends with faired curves, bounds against scatter, the envelope flown."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from daq.utilities.constants import RADIAN
from estimation.campaign.groups import label_in
from estimation.campaign.pages.points import EstimatePoints, faired, method_stem
from estimation.campaign.tasks import Row
from estimation.report.drawing.figures import Picture, legend_above, panels, picture, styled
from estimation.report.names import tex
from groundstation.flight import Array

if TYPE_CHECKING:
    import pyarrow as pa

PANELS = 3  # in a row
FEWEST_FOR_TRENDS = 5  # flights: fewer show no trend over a condition
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")  # Okabe and Ito's
MARKERS = "osD^vP*"  # one for each group, for a print in black and white
JOINT = "#444444"
WEIGHT = 30  # points that an estimate with its error bar counts as: from 1300 estimates on, pixels take less space than vectors
CONDITIONS: Mapping[str, tuple[str, str, float]] = {
    "alpha": ("mean angle of attack", "deg", RADIAN),
    "V": ("mean airspeed", "m/s", 1.0),
    "beta_max": ("largest sideslip", "deg", RADIAN),
    "delta_e": ("mean elevator", "deg", RADIAN),
}
"""Condition -> title of its axis, unit, and factor to that unit."""
COVERAGE = (("V", "alpha"), ("V", "beta_max"), ("alpha", "delta_e"), ("delta_a_max", "delta_r_max"))
"""Pairs of conditions over which the flights are shown."""
SURFACES: Mapping[str, tuple[str, str, float]] = {
    "delta_a_max": ("largest aileron", "deg", RADIAN),
    "delta_r_max": ("largest rudder", "deg", RADIAN),
}


def group_styles(labels: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Group -> colour and marker, the same in every figure."""
    group_names = sorted(set(labels))
    return {g: (COLOURS[i % len(COLOURS)], MARKERS[i % len(MARKERS)]) for i, g in enumerate(group_names)}


def scatter_figure(method: str, points: Sequence[EstimatePoints], groups: Sequence[Row]) -> Picture:
    """Estimates in order of date (Figure 8 of the paper), the pooled value with its 95 % band, and the prior value."""
    styles = group_styles([g for p in points for g in p.groups])
    with styled():
        figure, axes = panels(len(points), PANELS, 2.1, 0.6)
        for axis, p in zip(axes, points, strict=True):
            _draw(axis, p, p.order, styles)
            for r in groups:
                if r["kind"] == "pooled" and (r["method"], r["parameter"]) == (method, p.parameter):
                    _band(axis, p, r, styles.get(r["group"], (JOINT, ""))[0])
        legend_above(figure, axes, 3)
    caption = (
        f"Estimates of every flight by {method}, in order of date, with corrected bounds; band: 95 % of the pooled value, "
        "on each side of a step in time that moved it; dashes: the prior value."
    )
    return picture(figure, f"flights_{method_stem(method)}", caption, sum(WEIGHT * p.y.size for p in points))


def trend_figures(method: str, points: Sequence[EstimatePoints], database: Sequence[Row]) -> list[Picture]:
    """Estimates over each condition that changed, with the faired curves of the database over the range flown."""
    styles = group_styles([g for p in points for g in p.groups])
    pictures = []
    for condition, (title, unit, factor) in CONDITIONS.items():
        if not any(_changes(p, condition) for p in points):
            continue
        with styled():
            figure, axes = panels(len(points), PANELS, 2.1, 0.6)
            for axis, p in zip(axes, points, strict=True):
                _draw(axis, p, factor * p.conditions[condition], styles)
                group_curves = faired(database, "pooled", method, p.parameter, condition)
                newest = dict(group_curves)
                for group, c in group_curves:
                    colour = styles.get(group, (JOINT, ""))[0]
                    axis.plot(factor * c.x, c.value, color=colour, lw=1.2, ls="-" if newest[group] is c else ":")
                    axis.fill_between(factor * c.x, c.low, c.high, color=colour, alpha=0.25, lw=0)
                for _, c in faired(database, "joint", method, p.parameter, condition):
                    axis.plot(factor * c.x, c.value, color=JOINT, lw=1.2, ls="-.", label="joint model")
                    axis.fill_between(factor * c.x, c.low, c.high, color=JOINT, alpha=0.2, lw=0)
                axis.set_xlabel(f"{title} [{unit}]")
            legend_above(figure, axes, 3)
        caption = (
            f"Estimates by {method} over {title}, with corrected bounds; lines: the faired curves of the database with 95 %, "
            "over the range flown, dotted those of flights before a step in time that moved the parameter; dashes: the "
            "prior value."
        )
        size = sum(WEIGHT * p.y.size for p in points)
        pictures.append(picture(figure, f"trend_{condition}_{method_stem(method)}", caption, size))
    return pictures


def bounds_figure(method: str, groups: Sequence[Row]) -> Picture | None:
    """Scatter of each parameter over its rms corrected bound, near 1 for sound bounds."""
    from matplotlib.figure import Figure

    rows = [r for r in groups if r["kind"] == "pooled" and r["method"] == method]
    names = sorted({r["parameter"] for r in rows})
    if not names:
        return None
    styles = group_styles([r["group"] for r in rows])
    with styled():
        figure = Figure(figsize=(max(6.4, 0.45 * len(names) + 2.0), 3.2), layout="constrained")
        axis = figure.subplots()
        for group, (colour, marker) in styles.items():
            group_rows = [r for r in rows if r["group"] == group]
            places, ratios = [names.index(r["parameter"]) for r in group_rows], [r["ratio"] for r in group_rows]
            axis.plot(places, ratios, marker, ms=5, color=colour, label=group)
        axis.axhline(1.0, color="#888888", lw=0.8)
        axis.set_yscale("log")
        axis.set_xticks(range(len(names)), [f"${tex(n)}$" for n in names])
        axis.set_ylabel("scatter / bound")
        legend_above(figure, [axis], 3)
    caption = f"Scatter of the flights' estimates by {method} over their corrected bounds; 1: the bounds are right."
    return picture(figure, f"bounds_{method_stem(method)}", caption)


def envelope_figure(results: "pa.Table", keys: Sequence[str]) -> Picture | None:
    """Airspeed, angle of attack, sideslip and surfaces flown: means as points, ranges as crosses where they are known."""
    import pyarrow.compute as pc

    titles = {**CONDITIONS, **SURFACES}
    pairs = dict.fromkeys(n for pair in COVERAGE for n in pair)
    ranges = [f"{n}_{end}" for n in ("V", "alpha") for end in ("min", "max")]
    columns = list(dict.fromkeys(("sha256", *pairs, *ranges, *keys)))
    rows = results.filter(pc.equal(results["kind"], "run")).select(columns).to_pylist()
    # each flight once, whatever the number of methods
    rows = list({r["sha256"]: r for r in rows if r["sha256"]}.values())
    shown_pairs = [pair for pair in COVERAGE if any(r[pair[0]] is not None and r[pair[1]] is not None for r in rows)]
    if not shown_pairs:
        return None
    labels = [label_in(r, keys) for r in rows]
    styles = group_styles(labels)
    with styled():
        figure, axes = panels(len(shown_pairs), 2, 3.0, 0.6)
        for axis, (across, vertical) in zip(axes, shown_pairs, strict=True):
            for label, style in styles.items():
                group_rows = [r for r, of_group in zip(rows, labels, strict=True) if of_group == label]
                measured_rows = [r for r in group_rows if r[across] is not None and r[vertical] is not None]
                _cross(axis, measured_rows, (across, vertical), label, style)
            axis.set_xlabel("{} [{}]".format(*titles[across]))
            axis.set_ylabel("{} [{}]".format(*titles[vertical]))
        legend_above(figure, axes, 3)
    return picture(
        figure, "envelope", "Envelope flown: a point a flight, with its range.", WEIGHT * len(rows) * len(shown_pairs)
    )


# ------------------------------------------------------------------------------------------------------ inside


def _cross(axis: Any, rows: Sequence[Row], pair: tuple[str, str], label: str, style: tuple[str, str]) -> None:
    factors = [{**CONDITIONS, **SURFACES}[n][2] for n in pair]
    values = [f * np.array([r[n] for r in rows], float) for n, f in zip(pair, factors, strict=True)]
    spans = []
    for n, f, v in zip(pair, factors, values, strict=True):
        ends = [[r.get(f"{n}_{end}") for r in rows] for end in ("min", "max")]
        ranges_known = rows and all(e is not None for side in ends for e in side)
        spans.append(np.abs(f * np.array(ends, float) - v) if ranges_known else None)
    colour, marker = style
    axis.errorbar(*values, spans[1], spans[0], fmt=marker, ms=3.5, lw=0.4, alpha=0.6, color=colour, label=label)


def _band(axis: Any, p: EstimatePoints, pooled: Row, colour: str) -> None:
    """The 95 % band of a pooled value over its flights: all, or those on one side of a step."""
    style: dict[str, Any] = {"color": colour, "alpha": 0.25, "lw": 0}
    if not pooled.get("since"):
        axis.axhspan(pooled["low"], pooled["high"], **style)
        return
    in_period = [pooled["since"] <= date <= pooled["until"] for date in p.dates]
    places = p.order[np.array(in_period) & (np.array(p.groups) == pooled["group"])]
    if places.size:
        axis.fill_between([places.min() - 0.5, places.max() + 0.5], pooled["low"], pooled["high"], **style)


def _changes(p: EstimatePoints, condition: str) -> bool:
    measured_values = p.conditions[condition][np.isfinite(p.conditions[condition])]
    return measured_values.size >= FEWEST_FOR_TRENDS and float(np.ptp(measured_values)) > 0.0


def _draw(axis: Any, p: EstimatePoints, x: Array, styles: Mapping[str, tuple[str, str]]) -> None:
    """Estimates with corrected bounds, a symbol a group. The axis spans the middle nine tenths of the estimates and a margin."""
    for label, (colour, marker) in styles.items():
        in_group = np.array([g == label for g in p.groups]) & np.isfinite(x)
        if in_group.any():
            axis.errorbar(
                x[in_group], p.y[in_group], p.std[in_group], fmt=marker, ms=2.8, lw=0.7, color=colour, label=label
            )
    if p.prior is not None:
        axis.axhline(p.prior, color="#888888", lw=0.9, ls="--")
    low, high = np.quantile(p.y, [0.05, 0.95])
    margin = max(float(high - low), float(np.median(p.std)) * 2.0)
    axis.set_ylim(low - margin, high + margin)
    axis.set_ylabel(f"${tex(p.parameter)}$")
