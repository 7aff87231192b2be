"""The page of `sideslip check`: Table 2 beside the paper's, Figure 7, and what is wrong with the data."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from estimation.compatibility.reconstruction import Compatibility, ReconstructedFlight
from estimation.report import published
from estimation.report.compatibility_tables import fit_of
from estimation.report.drawing.figures import ABOVE, MEASURED, Picture, broken_at_gaps, picture, styled
from estimation.report.flight_card import flight_card
from estimation.report.markup.html import write_page
from estimation.report.names import face, literal, tex
from estimation.report.notes import collected, notes_table
from estimation.report.provenance import provenance_table
from estimation.report.tables import CANNOT_TELL, ReportTable, number, rounded, significant, write_all

if TYPE_CHECKING:
    from groundstation.flight import Flight
    from groundstation.flight.findings import Finding

UNITS = {"V": "m/s"}
RECONSTRUCTED = "#0072B2"
COLUMNS = 2  # flights beside each other in a figure


def write_check_report(
    flights: Sequence["Flight"],
    quality: Sequence[Sequence["Finding"]],
    results: Sequence[tuple[str, Compatibility]],
    folder: Path,
) -> Path:
    """Write folder/index.html, with its tables as CSV and LaTeX beside it; returns the page.

    results: one a flight, in the order of `flights`, then the joint one where there is one.
    """
    own = [r for _, r in results[: len(flights)]]
    tables = {
        "factors": factor_table(results, flights),
        "fit": _fit_table(own),
        "provenance": provenance_table(flights),
        "card": flight_card(flights),
    }
    findings = [(f.name, list(found)) for f, found in zip(flights, quality, strict=True)]
    told = [r.flights[0] for r in own]
    write_all(list(tables.values()), folder / "tables")
    counts = [f.severity for _, found in findings for f in found]
    return write_page(
        folder / "index.html",
        "check.html.j2",
        title="Data compatibility",
        lead=f"{len(flights)} flight{'s' if len(flights) > 1 else ''}: {', '.join(f.name for f in flights)}. "
        "Do accelerations, rates, attitude and air data tell the same story?",
        tables=tables,
        figures=motion_figures(told),
        findings=findings,
        unclear=_unclear(results),
        status=[(n, r.converged, r.text, r.turbulence) for n, r in results],
        notes=notes_table((t.name, note) for t in told for note in t.notes),
        fails=counts.count("fail"),
        warns=counts.count("warn"),
    )


def _unclear(results: Sequence[tuple[str, Compatibility]]) -> ReportTable | None:
    """What these flights cannot tell of the factors, each reason once."""
    found = collected(
        (f"{f.name}: {f.why}", flight) for flight, r in results for f in r.factors.values() if not f.identifiable
    )
    if not found:
        return None
    rows = tuple((*what.split(": ", 1), ", ".join(flights)) for what, flights in found.items())
    return ReportTable("unclear", "What these flights cannot tell", ("factor", "why", "flights"), rows, texts=(1, 2))


def factor_table(results: Sequence[tuple[str, Compatibility]], flights: Sequence["Flight"]) -> ReportTable:
    """Table 2: factor, estimate and bound a flight; the published columns where all flights are of the CDFP."""
    ours = all(published.is_of(f.provenance.aircraft) for f in flights)
    others = published.published_flights() if ours else ()
    rows = []
    for name, first in results[0][1].factors.items():
        row = [name, first.unit]
        for _, r in results:
            factor = r.factors[name]
            row.append(_with_bound(factor.estimate, factor.std_coloured) if factor.identifiable else CANNOT_TELL)
        for flight in others:
            said = published.compatibility_factor(flight, name)
            row.append("" if said is None else f"{number(said[0])} ({significant(said[1], 2)})")
        rows.append(tuple(row))
    groups = [("", 2), ("estimate (bound)", len(results))] + (
        [("published, estimate (bound)", len(others))] if others else []
    )
    return ReportTable(
        "table2_compatibility",
        "Instrument factors found by flight-path reconstruction, with one-sigma bounds",
        ("factor", "unit", *(n for n, _ in results), *others),
        tuple(rows),
        tuple(groups),
        note="Conventions: measured = true + bias for accelerations and rates, measured = K true + bias for β (and α, V). "
        "Our bounds are of filter innovations, so noise of the inertial sensors is counted, and corrected for colour left in "
        "them; the published ones are Cramér–Rao bounds of output error. " + (published.COMPARISON if ours else ""),
    )


def _with_bound(value: float, bound: float) -> str:
    shown, said = rounded(value, bound)
    return f"{shown} ({said})" if said else shown


def _fit_table(results: Sequence[Compatibility]) -> ReportTable:
    rows = []
    for r in results:
        flight = r.flights[0]
        for name, fit in fit_of(flight).items():
            factor, unit = face(name, UNITS.get(name, "rad"))
            rows.append((flight.name, name, unit, significant(factor * fit["rms"]), significant(factor * fit["noise"]),
                         number(fit["r2"], 3), number(fit["whiteness"], 2)))  # fmt: skip
    return ReportTable(
        "compatibility_fit",
        "Measured against reconstructed",
        ("flight", "channel", "unit", "rms difference", "sensor noise", "r²", "innovation autocorrelation, lag 1"),
        tuple(rows),
        symbols=False,
        note="The reconstruction is integrated from accelerations and rates alone: gusts, which move the vanes and not the "
        "inertial path, are in the difference of V, α and β.",
    )


def motion_figures(flights: Sequence[ReconstructedFlight]) -> list[Picture]:
    """Figure 7: measured and reconstructed motion, two flights beside each other."""
    return [motion_figure(pair, i) for i, pair in enumerate(motion_pairs(flights))]


def motion_pairs(flights: Sequence[ReconstructedFlight]) -> list[Sequence[ReconstructedFlight]]:
    """The flights that share a figure."""
    return [flights[start : start + COLUMNS] for start in range(0, len(flights), COLUMNS)]


def motion_figure(shown: Sequence[ReconstructedFlight], number: int) -> Picture:
    """One part of Figure 7, the number-th from 0; shown: the flights beside each other."""
    from matplotlib.figure import Figure

    names = shown[0].outputs
    with styled():
        figure = Figure(figsize=(11.6, 1.25 * len(names) + 0.7), layout="constrained")
        axes = figure.subplots(len(names), len(shown), squeeze=False, sharex="col")
        for column, flight in enumerate(shown):
            for row, name in enumerate(names):
                axis = axes[row][column]
                factor, unit = face(name, UNITS.get(name, "rad"))
                if np.isfinite(flight.measured[:, row]).any():
                    measured = broken_at_gaps(flight.time, factor * flight.measured[:, row])
                    axis.plot(flight.time, measured, color=MEASURED, lw=1.6, label="measured")
                again = broken_at_gaps(flight.time, factor * flight.reconstructed[:, row])
                axis.plot(flight.time, again, color=RECONSTRUCTED, lw=0.9, label="reconstructed")
                axis.set_ylabel(f"${tex(name)}$ [{unit}]")
            axes[0][column].set_title(literal(flight.name), loc="left")
            axes[-1][column].set_xlabel("time [s]")
        axes[0][0].legend(ncols=2, **ABOVE)
        figure.align_ylabels()
    caption = f"Measured and reconstructed motion, {' and '.join(f.name for f in shown)} (Figure 7 of the paper)."
    points = sum(2 * f.time.size * len(names) for f in shown)
    return picture(figure, f"figure7_{number + 1}", caption, points)
