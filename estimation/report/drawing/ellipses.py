"""Confidence ellipses of pairs of estimates: what two derivatives together may be, where each bound alone says too much."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.estimators.result import Result
from estimation.report.drawing.figures import Picture, look, picture, styled
from estimation.report.names import tex

Array = NDArray[np.float64]
SHOWN = 8
ACROSS = 4
TWO_AT_95 = 5.991
"""95 % point of chi-square with two degrees of freedom, -2 ln 0.05: the square of an ellipse's radius in standard deviations."""


def ellipse(centre: tuple[float, float], covariance: Array, points: int = 90) -> Array:
    """(points, 2) border of the 95 % region of two estimates with this (2, 2) covariance."""
    values, vectors = np.linalg.eigh(covariance)
    turn = np.linspace(0.0, 2.0 * np.pi, points)
    circle = np.sqrt(np.maximum(values, 0.0) * TWO_AT_95)[:, None] * np.array([np.cos(turn), np.sin(turn)])
    return np.asarray(np.asarray(centre) + (vectors @ circle).T)


def most_correlated(result: Result, count: int = SHOWN) -> list[tuple[str, str]]:
    """Pairs of estimates that the data could tell, the most correlated first."""
    told = [n for n in result.names if result.parameters[n].identifiable and np.isfinite(result.std_coloured[n])]
    at = {n: i for i, n in enumerate(result.names)}
    rho = np.abs(result.correlation)
    pairs = [(a, b) for i, a in enumerate(told) for b in told[i + 1 :]]
    return sorted(pairs, key=lambda p: -float(np.nan_to_num(rho[at[p[0]], at[p[1]]])))[:count]


def ellipse_figure(results: Sequence[Result], whose: str, truth: Mapping[str, float]) -> Picture | None:
    """95 % ellipses of the most correlated pairs, one curve a method. results: of the same flights, the leading one first."""
    from matplotlib.figure import Figure

    pairs = most_correlated(results[0]) if results else []
    if not pairs:
        return None
    rows = -(-len(pairs) // ACROSS)
    with styled():
        figure = Figure(figsize=(11.6, 2.5 * rows + 0.5), layout="constrained")
        axes = figure.subplots(rows, ACROSS, squeeze=False)
        for axis, both in zip(axes.flat, pairs, strict=False):
            _panel(axis, results, both, truth)
        for axis in axes.flat[len(pairs) :]:
            axis.set_visible(False)
        handles = {h: line for axis in axes.flat for line, h in zip(*axis.get_legend_handles_labels(), strict=True)}
        figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=6)
    caption = f"95 % confidence ellipses of the {len(pairs)} most correlated pairs, {whose}; "
    caption += "from the covariance corrected for coloured residuals."
    return picture(figure, "ellipses", caption)


def _panel(axis: Any, results: Sequence[Result], both: tuple[str, str], truth: Mapping[str, float]) -> None:
    a, b = both
    for result in results:
        if not all(n in result.names and result.parameters[n].identifiable for n in both):
            continue
        at = [result.names.index(n) for n in both]
        covariance = result.covariance_coloured[np.ix_(at, at)]
        if not np.all(np.isfinite(covariance)):
            continue
        centre = (result.parameters[a].estimate, result.parameters[b].estimate)
        edge, how = ellipse(centre, covariance), look(result.method)
        axis.plot(*edge.T, color=how.colour, lw=1.1, label=result.method)
        axis.plot(*centre, how.marker, color=how.colour, ms=4)
    before = [results[0].parameters[n].reference for n in both]
    if None not in before:
        axis.plot(*before, "x", color="k", ms=5, label="before flying")
    if a in truth and b in truth:
        axis.plot(truth[a], truth[b], "*", color="k", ms=8, label="truth")
    axis.set_xlabel(f"${tex(a)}$")
    axis.set_ylabel(f"${tex(b)}$")
    axis.locator_params(nbins=4)
