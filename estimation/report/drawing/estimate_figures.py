"""Figures of an estimate's report: derivatives over flights, histories, proof of match (Figures 8 to 10 of the paper, for any
flights), correlations and confidence ellipses of the estimates."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from estimation.estimators.result import FlightFit, Result
from estimation.models.base import ParameterRole
from estimation.report import published
from estimation.report.drawing.figures import (
    ABOVE,
    MEASURED,
    Picture,
    broken_at_gaps,
    grid,
    legend_above,
    look,
    panels,
    picture,
    styled,
)
from estimation.report.drawing.marks_drawn import draw_marks
from estimation.report.estimate_tables import is_published
from estimation.report.names import axis_label, face, literal, tex
from groundstation.flight import Array

if TYPE_CHECKING:
    from estimation.models.base import Model
    from estimation.session.proof_of_match import ProofOfMatch
    from estimation.session.session import EstimationSession, FlightEstimates

PANELS_ACROSS = 4
PUBLISHED = "#8b95a1"  # colour of published estimates
WRITTEN, DARK = 0.5, 0.75  # correlations that are written as numbers, and that need white letters


def scatter_figure(session: "EstimationSession") -> Picture:
    """Figure 8: each derivative over flights and methods, joint band, wind tunnel, published flights."""
    trims = session.model.free_of(ParameterRole.CONSTANT)
    names = [n for n in session.model.free_names if n not in trims] or list(trims)
    with styled():
        figure, axes = panels(len(names), PANELS_ACROSS, 2.05, 0.9)
        for axis, name in zip(axes, names, strict=True):
            _scatter_panel(axis, session, name)
        legend_above(figure, axes, 6)
    caption = (
        "Each derivative over flights and methods, bars of one corrected bound; a flight that cannot tell has no mark. "
        "Dashed: believed before flying. Band: joint estimate, ± one corrected bound."
    )
    if is_published(session):
        caption += " Grey, right of the line: the four published flights (Figure 8 of the paper)."
    return picture(figure, "figure8", caption)


def _scatter_panel(axis: Any, session: "EstimationSession", name: str) -> None:
    width = 0.6 / max(1, len(session.methods))
    for k, method in enumerate(session.methods):
        placed_estimates = [
            (i + (k + 0.5) * width - 0.3, f.results[method].parameters.get(name))
            for i, f in enumerate(session.flights)
            if method in f.results
        ]
        identifiable = [
            (x, e) for x, e in placed_estimates if e is not None and e.identifiable and np.isfinite(e.std_coloured)
        ]
        if identifiable:
            across, estimates = [x for x, _ in identifiable], [e.estimate for _, e in identifiable]
            bounds, style = [e.std_coloured for _, e in identifiable], look(method)
            errorbar = {"fmt": style.marker, "color": style.colour, "ms": 3.6, "lw": 0.9, "capsize": 1.8}
            axis.errorbar(across, estimates, bounds, label=method, **errorbar)
    labels = [f.flight.name.removeprefix("cdfp_") for f in session.flights]
    count = len(labels)
    joint = session.leading
    e = None if joint is None else joint.parameters.get(name)
    if e is not None and e.identifiable:
        axis.axhspan(
            e.estimate - e.std_coloured, e.estimate + e.std_coloured, color="#0072B2", alpha=0.18, lw=0, label="joint"
        )
    reference = session.model.parameter(name)
    if reference.reference is not None:
        axis.axhline(reference.reference, color="k", lw=0.8, ls="--", label="before flying")
    if is_published(session):
        axis.axvline(count - 0.5, color="0.8", lw=0.8)
        for m, shift in (("ml", -0.12), ("ngn", 0.12)):
            published_estimates = [published.estimate(f, m, name) for f in published.published_flights()]
            places = [(count + i + shift, v) for i, v in enumerate(published_estimates) if v is not None]
            axis.errorbar([x for x, _ in places], [v[0] for _, v in places], [v[1] for _, v in places],
                          fmt=look(m).marker, color=PUBLISHED, mfc="none", ms=3.4, lw=0.8, label=f"published {m}")  # fmt: skip
        labels += [f.removeprefix("UFP_") for f in published.published_flights()]
    axis.set_title(f"${tex(name)}$")
    axis.set_xticks(
        range(len(labels)), [literal(label) for label in labels], rotation=0 if len(labels) <= 4 else 60, fontsize=7
    )
    axis.set_xlim(-0.6, len(labels) - 0.4)
    axis.grid(axis="x", visible=False)


def history_figure(f: "FlightEstimates", of_paper: bool) -> Picture:
    """Figure 9: measured and estimated histories with the controls below. of_paper: name the paper's figure in the caption."""
    model = next(iter(f.results.values())).model  # of a result, so without outputs that this flight does not measure
    fits = {m: r.flights[0] for m, r in f.results.items() if r.flights and r.model.output_names == model.output_names}
    first = next(iter(fits.values()))
    controls = [s for s in model.inputs if s.control and f.flight.measured(s.source)]
    rows = len(model.outputs) + (1 if controls else 0)
    with styled():
        figure, axes = grid(rows, 1, 1.45, sharex=True)
        axes = axes[:, 0]
        _channels(axes, model, first, {m: fit.outputs for m, fit in fits.items()})
        for signal, style in zip(controls, ("-", "--", ":"), strict=False):
            factor, unit = face(signal.name, signal.unit)
            values = broken_at_gaps(f.flight.time, factor * f.flight[signal.source])
            axes[-1].plot(
                f.flight.time, values, style, color="0.25", lw=0.9, label=literal(signal.description or signal.name)
            )
            axes[-1].set_ylabel(f"controls [{unit}]" if unit else "controls")
        if controls:
            axes[-1].legend(loc="upper right", ncols=3)
        draw_marks(axes, f.flight)
        axes[-1].set_xlabel("time [s]")
    points = first.time.size * rows * (1 + len(fits))
    caption = f"{f.flight.name}: measured and estimated motion with the controls{' (Figure 9 of the paper)' if of_paper else ''}"
    simulation_note = ". All methods' curves are simulated from their estimates." if len(fits) > 1 else "."
    return picture(figure, f"figure9_{f.flight.name}", caption + simulation_note, points)


def _channels(axes: Any, model: "Model", first: "FlightFit | ProofOfMatch", curves: Mapping[str, Any]) -> None:
    for i, signal in enumerate(model.outputs):
        factor, unit = face(signal.name, signal.unit)
        axes[i].plot(first.time, factor * first.measured[:, i], ".", color=MEASURED, ms=2.4, label="measured")
        for method, outputs in curves.items():
            axes[i].plot(
                first.time,
                broken_at_gaps(first.time, factor * outputs[:, i]),
                color=look(method).colour,
                lw=1.0,
                label=method,
            )
        axes[i].set_ylabel(axis_label(signal.name, unit))
    axes[0].legend(ncols=1 + len(curves), **ABOVE)


def correlation_figure(result: Result, source: str) -> Picture:
    """Correlation matrix of the estimates as a map. source: of the estimates, for the caption."""
    from matplotlib.figure import Figure

    names, rho = result.names, result.correlation
    size = 1.6 + 0.36 * len(names)
    with styled():
        figure = Figure(figsize=(size + 1.2, size), layout="constrained")
        axis = figure.subplots()
        image = axis.imshow(rho, vmin=-1, vmax=1, cmap="RdBu_r")
        axis.set_xticks(range(len(names)), [f"${tex(n)}$" for n in names], rotation=90)
        axis.set_yticks(range(len(names)), [f"${tex(n)}$" for n in names])
        axis.grid(visible=False)
        for i, j in zip(*np.nonzero(np.abs(rho) >= WRITTEN), strict=True):
            if i != j:
                text, colour = f"{rho[i, j]:.2f}".replace("0.", "."), "w" if abs(rho[i, j]) > DARK else "k"
                axis.text(j, i, text, ha="center", va="center", fontsize=6, color=colour)
        figure.colorbar(image, ax=axis, shrink=0.8)
    return picture(figure, "correlations", f"Correlation of the estimates, {source}; numbers from {WRITTEN}.")


def proof_figure(proofs: Sequence[tuple[str, "ProofOfMatch"]], refitted: str, of_paper: bool) -> Picture:
    """Figure 10: flights predicted with the frozen parameters of another flight. proofs: (source of the parameters, proof);
    refitted: the parameters that were refitted, in words; of_paper: name the paper's figure in the caption."""
    rows = max(len(proof.outputs) for _, proof in proofs)
    with styled():
        figure, axes = grid(rows, len(proofs), 1.25, own_scales=True, sharex="col")
        for j, (donor, proof) in enumerate(proofs):
            _channels(axes[:, j], proof.result.model, proof, {"predicted": proof.predicted})
            axes[0][j].set_title(literal(f"{proof.name} predicted by {donor}"), loc="left")
            axes[-1][j].set_xlabel("time [s]")
    points = sum(2 * p.time.size * rows for _, p in proofs)
    caption = "Proof of match: measured and predicted, derivatives frozen at another flight's estimates, "
    caption += f"{refitted} refitted{' (Figure 10 of the paper)' if of_paper else ''}."
    return picture(figure, "figure10", caption, points)


MOST_PAIRS = 8  # of parameters with an ellipse
CHI_SQUARE_95 = 5.991
"""95 % point of chi-square with two degrees of freedom, -2 ln 0.05: the square of an ellipse's radius in standard deviations."""


def ellipse(centre: tuple[float, float], covariance: Array, points: int = 90) -> Array:
    """(points, 2) border of the 95 % region of two estimates with this covariance (2, 2)."""
    values, vectors = np.linalg.eigh(covariance)
    angle = np.linspace(0.0, 2.0 * np.pi, points)
    circle = np.sqrt(np.maximum(values, 0.0) * CHI_SQUARE_95)[:, None] * np.array([np.cos(angle), np.sin(angle)])
    return np.asarray(np.asarray(centre) + (vectors @ circle).T)


def most_correlated(result: Result, count: int = MOST_PAIRS) -> list[tuple[str, str]]:
    """Pairs of identifiable estimates, the most correlated first."""
    identifiable = [
        n for n in result.names if result.parameters[n].identifiable and np.isfinite(result.std_coloured[n])
    ]
    index_by_name = {n: i for i, n in enumerate(result.names)}
    rho = np.abs(result.correlation)
    pairs = [(a, b) for i, a in enumerate(identifiable) for b in identifiable[i + 1 :]]
    return sorted(pairs, key=lambda p: -float(np.nan_to_num(rho[index_by_name[p[0]], index_by_name[p[1]]])))[:count]


def ellipse_figure(results: Sequence[Result], source: str, truth: Mapping[str, float]) -> Picture | None:
    """95 % ellipses of the most correlated pairs, one curve a method; None without pairs. results: of the same flights, the
    leading one first; source: of the estimates, for the caption."""
    pairs = most_correlated(results[0]) if results else []
    if not pairs:
        return None
    with styled():
        figure, axes = panels(len(pairs), PANELS_ACROSS, 2.5, 0.5)
        for axis, parameter_pair in zip(axes, pairs, strict=True):
            _ellipse_panel(axis, results, parameter_pair, truth)
        legend_above(figure, axes, 6)
    caption = f"95 % confidence ellipses of the {len(pairs)} most correlated pairs, {source}; "
    caption += "from the covariance corrected for coloured residuals."
    return picture(figure, "ellipses", caption)


def _ellipse_panel(axis: Any, results: Sequence[Result], pair: tuple[str, str], truth: Mapping[str, float]) -> None:
    a, b = pair
    for result in results:
        if not all(n in result.names and result.parameters[n].identifiable for n in pair):
            continue
        indices = [result.names.index(n) for n in pair]
        covariance = result.covariance_coloured[np.ix_(indices, indices)]
        if not np.all(np.isfinite(covariance)):
            continue
        centre = (result.parameters[a].estimate, result.parameters[b].estimate)
        edge, method_look = ellipse(centre, covariance), look(result.method)
        axis.plot(*edge.T, color=method_look.colour, lw=1.1, label=result.method)
        axis.plot(*centre, method_look.marker, color=method_look.colour, ms=4)
    references = [results[0].parameters[n].reference for n in pair]
    if None not in references:
        axis.plot(*references, "x", color="k", ms=5, label="before flying")
    if a in truth and b in truth:
        axis.plot(truth[a], truth[b], "*", color="k", ms=8, label="truth")
    axis.set_xlabel(f"${tex(a)}$")
    axis.set_ylabel(f"${tex(b)}$")
    axis.locator_params(nbins=4)
