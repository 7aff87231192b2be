"""The output of `sideslip check`: page, printed lines and figure; instrument factors (Table 2), motion (Figure 7), findings."""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup

from estimation.compatibility.reconstruction import Compatibility, FactorEstimate, ReconstructedFlight
from estimation.models.kinematic import STANDARD_FACTORS
from estimation.report import published
from estimation.report.drawing.figures import (
    ABOVE,
    MEASURED,
    Picture,
    broken_at_gaps,
    grid,
    picture,
    save_figure,
    styled,
)
from estimation.report.drawing.marks_drawn import aligned_figures, draw_marks
from estimation.report.flight_tables import collected, flight_card, notes_table, provenance_table
from estimation.report.names import face, literal, tex
from estimation.report.page import Page, Section, box, bullets, coloured, free_table, paragraph
from estimation.report.tables import CANNOT_TELL, ReportTable, number, rounded, significant

if TYPE_CHECKING:
    from groundstation.flight import Flight
    from groundstation.flight.findings import Finding

_TITLES = {
    "V": "V [m/s]",
    "alpha": "α [deg]",
    "beta": "β [deg]",
    "phi": "φ [deg]",
    "theta": "θ [deg]",
    "psi": "ψ [deg]",
}


UNITS = {"V": "m/s"}  # of outputs that are no angles
RECONSTRUCTED = "#0072B2"
GAP = 1.0  # s between samples, across which no line is drawn


def factor_lines(results: Sequence[tuple[str, Compatibility]]) -> Iterator[str]:
    """One column a flight, as in Table 2 of the paper: estimate (bound corrected for coloured innovations)."""
    names = list(results[0][1].factors)
    width = max(21, *(len(n) + 2 for n, _ in results))
    yield f"{'factor':<10}{'unit':<7}" + "".join(f"{name:>{width}}" for name, _ in results)
    for name in names:
        cells = [_cell(r.factors[name]) for _, r in results]
        yield f"{name:<10}{results[0][1].factors[name].unit:<7}" + "".join(f"{c:>{width}}" for c in cells)
    for name, result in results:
        yield f"{name}: {result.text}; turbulence {result.turbulence:.3f} m/s per root second"
        for factor in result.factors.values():
            if not factor.identifiable:
                yield f"{name}: {factor.name}: {factor.why}"
        for note in result.flights[0].notes if len(result.flights) == 1 else ():
            yield f"{name}: {note}"


def published_lines() -> Iterator[str]:
    """The published factors, one column a flight."""
    flights = published.published_flights()
    yield "published (bounds of output error, without the noise of the inertial sensors)"
    yield f"{'factor':<17}" + "".join(f"{name:>21}" for name in flights)
    for factor in STANDARD_FACTORS:
        published_factors = [published.compatibility_factor(flight, factor) for flight in flights]
        yield f"{factor:<17}" + "".join(f"{_published(s):>21}" for s in published_factors)


def _published(number_and_bound: tuple[float, float] | None) -> str:
    return "" if number_and_bound is None else f"{number_and_bound[0]:+.4f} ({number_and_bound[1]:.4f})"


def _cell(factor: FactorEstimate) -> str:
    if not np.isfinite(factor.estimate):
        return "not measured"
    if not factor.identifiable:
        return "cannot tell"
    return f"{factor.estimate:+.4f} ({factor.std_coloured:.4f})"


def fit_of(flight: ReconstructedFlight) -> Mapping[str, Mapping[str, float]]:
    """Output -> rms of measured minus reconstructed, coefficient of determination, noise, whiteness."""
    table = {}
    for j, name in enumerate(flight.outputs):
        both_known = np.isfinite(flight.measured[:, j]) & np.isfinite(flight.reconstructed[:, j])
        if not both_known.any():
            continue
        z, residual = flight.measured[both_known, j], (flight.measured - flight.reconstructed)[both_known, j]
        spread = float(np.sum((z - z.mean()) ** 2))
        r2 = 1.0 - float(np.sum(residual**2)) / spread if spread > 0 else 0.0
        rms = float(np.sqrt(np.mean(residual**2)))
        table[name] = {"rms": rms, "r2": r2, "noise": flight.noise[name], "whiteness": flight.whiteness[name]}
    return table


def write_figure(flights: Sequence[ReconstructedFlight], path: Path) -> None:
    """Draw measured and reconstructed motion into a file, one column a flight (Figure 7 of the paper)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    names = flights[0].outputs
    figure = Figure(figsize=(5.2 * len(flights) + 0.8, 1.55 * len(names) + 0.8), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(names), len(flights), squeeze=False, sharex="col")
    for column, flight in enumerate(flights):
        gaps = np.concatenate([[False], np.diff(flight.time) > GAP])
        for row, name in enumerate(names):
            axis = axes[row][column]
            factor, _ = face(name, UNITS.get(name, "rad"))
            for values, colour, width, label in (
                (flight.measured[:, row], "0.45", 0.7, "measured"),
                (flight.reconstructed[:, row], RECONSTRUCTED, 1.2, "reconstructed"),
            ):
                axis.plot(
                    flight.time, np.where(gaps, np.nan, factor * values), color=colour, linewidth=width, label=label
                )
            axis.set_ylabel(_TITLES[name])
            axis.grid(alpha=0.25)
        axes[0][column].set_title(literal(flight.name))
        axes[-1][column].set_xlabel("time [s]")
    axes[0][0].legend(loc="upper right", fontsize="small", ncols=2)
    save_figure(figure, path, dpi=110)


NEXT = (
    "Take the errors out: check FLIGHT --write FOLDER, then estimate FOLDER/FLIGHT.",
    "Where a check fails: view FLIGHT.",
)
COLUMNS = 2  # adjacent flights in a figure


def write_check_report(
    flights: Sequence["Flight"],
    quality: Sequence[Sequence["Finding"]],
    results: Sequence[tuple[str, Compatibility]],
    folder: Path,
    align: str | None = None,
    agreement: Sequence[str] = (),
) -> Path:
    """Write folder/index.html, with its tables as CSV and LaTeX beside it; returns the page.

    quality: findings of each flight. results: one for each flight, in the order of `flights`, then the joint one if any. align:
    how further flights are aligned with the first in time; None: they are not. agreement: a sentence for each flight.
    """
    reconstructed = [r.flights[0] for _, r in results[: len(flights)]]
    counts = [finding.severity for findings in quality for finding in findings]
    notes = notes_table((flight.name, note) for flight in reconstructed for note in flight.notes)
    detail = partial(Section, folded=True)
    sections = [
        Section("", "", [paragraph(f"{text}.", "verdict-line") for text in agreement]),
        Section("", "", [_status_box(results, counts.count("fail"), counts.count("warn"))]),
        Section("factors", "Instrument factors", [factor_table(results, flights), _unclear(results)], "Factors"),
        Section("", "", [Markup("<p><b>Next</b></p>"), bullets(NEXT)]),
        detail(
            "motion",
            "Measured and reconstructed motion",
            [*motion_figures(reconstructed, flights), _fit_table(reconstructed)],
            "Motion",
        ),
        detail("aligned", "Laid on one another in time", aligned_figures(flights, align), "Aligned") if align else None,
        detail("quality", "Data quality", [*_findings(flights, quality), notes], "Quality"),
        detail("card", "Flight card", [flight_card(flights)], "Flight card"),
        detail("provenance", "Provenance", [provenance_table(flights)], "Provenance"),
    ]
    lead = (
        f"{len(flights)} flight{'s' if len(flights) > 1 else ''}: {', '.join(f.name for f in flights)}. "
        "Do accelerations, rates, attitude and air data tell the same story?"
    )
    return Page("Data compatibility", lead, sections).write(folder / "index.html", folder / "tables")


def _status_box(results: Sequence[tuple[str, Compatibility]], fails: int, warns: int) -> Markup:
    """How many checks failed, and how each reconstruction ended."""
    if fails:
        verdict = coloured(f"{fails} checks failed", "fail") + (f", {warns} warned" if warns else "")
    elif warns:
        verdict = coloured(f"{warns} checks warn", "warn") + ", none failed"
    else:
        verdict = coloured("every check passed", "ok")
    lines = [Markup("<p>Data quality: {}.</p>").format(verdict)]
    line = Markup('<p>{}: <span class="{}">{}</span>; turbulence {:.3f} m/s per √s.</p>')
    lines += [line.format(n, "ok" if r.converged else "fail", r.text, r.turbulence) for n, r in results]
    return box(lines, warn=bool(fails or warns))


def _findings(flights: Sequence["Flight"], quality: Sequence[Sequence["Finding"]]) -> Iterator[Markup]:
    """The name of each flight and a table with a row for each of its findings."""
    for flight, findings in zip(flights, quality, strict=True):
        yield Markup("<h3>{}</h3>").format(flight.name)
        head = [("", "verdict"), ("text", "check"), ("text", "finding")]
        rows = [[(f"verdict {f.severity}", f.severity), ("text", f.kind), ("text", f.text)] for f in findings]
        yield free_table(head, rows, "findings", labels=(None, "", ""))


def _unclear(results: Sequence[tuple[str, Compatibility]]) -> ReportTable | None:
    """Factors that are not identifiable, each reason once; None without any."""
    flights_by_reason = collected(
        (f"{f.name}: {f.why}", flight) for flight, r in results for f in r.factors.values() if not f.identifiable
    )
    if not flights_by_reason:
        return None
    rows = tuple((*reason.split(": ", 1), ", ".join(flights)) for reason, flights in flights_by_reason.items())
    return ReportTable(
        "unclear", "What these flights cannot tell", ("factor", "why", "flights"), rows, texts=(1, 2), filed=False
    )


def factor_table(results: Sequence[tuple[str, Compatibility]], flights: Sequence["Flight"]) -> ReportTable:
    """Table 2: factors with the estimate and bound of each flight; published columns where all flights are of the CDFP."""
    ours = all(published.is_of(f.provenance.aircraft) for f in flights)
    published_flights = published.published_flights() if ours else ()
    rows = []
    for name, first in results[0][1].factors.items():
        row = [name, first.unit]
        for _, r in results:
            factor = r.factors[name]
            row.append(_with_bound(factor.estimate, factor.std_coloured) if factor.identifiable else CANNOT_TELL)
        for flight in published_flights:
            published_factor = published.compatibility_factor(flight, name)
            row.append(
                ""
                if published_factor is None
                else f"{number(published_factor[0])} ({significant(published_factor[1], 2)})"
            )
        rows.append(tuple(row))
    groups = [("", 2), ("estimate (bound)", len(results))] + (
        [("published, estimate (bound)", len(published_flights))] if published_flights else []
    )
    return ReportTable(
        "table2_compatibility",
        "Instrument factors found by flight-path reconstruction, with one-sigma bounds",
        ("factor", "unit", *(n for n, _ in results), *published_flights),
        tuple(rows),
        tuple(groups),
        note="Conventions: measured = true + bias for accelerations and rates, measured = K true + bias for β (and α, V). "
        "Our bounds are of filter innovations, so noise of the inertial sensors is counted, and corrected for colour left in "
        "them; the published ones are Cramér–Rao bounds of output error. " + (published.COMPARISON if ours else ""),
    )


def _with_bound(value: float, bound: float) -> str:
    value_text, bound_text = rounded(value, bound)
    return f"{value_text} ({bound_text})" if bound_text else value_text


def _fit_table(flights: Sequence[ReconstructedFlight]) -> ReportTable:
    rows = []
    for flight in flights:
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


def motion_figures(flights: Sequence[ReconstructedFlight], marked: Sequence["Flight"] = ()) -> list[Picture]:
    """Figure 7: measured and reconstructed motion, two flights a figure. marked: the flights whose marks are drawn."""
    return [motion_figure(pair, i, marked) for i, pair in enumerate(motion_pairs(flights))]


def motion_pairs(flights: Sequence[ReconstructedFlight]) -> list[Sequence[ReconstructedFlight]]:
    """The flights that share a figure."""
    return [flights[start : start + COLUMNS] for start in range(0, len(flights), COLUMNS)]


def motion_figure(flights: Sequence[ReconstructedFlight], number: int, marked: Sequence["Flight"] = ()) -> Picture:
    """One part of Figure 7. number: of the part, from 0; flights: of this part; marked: flights whose marks are drawn."""
    by_name = {flight.name: flight for flight in marked}
    names = flights[0].outputs
    with styled():
        figure, axes = grid(len(names), len(flights), 1.25, own_scales=True, sharex="col")
        for column, flight in enumerate(flights):
            for row, name in enumerate(names):
                axis = axes[row][column]
                factor, unit = face(name, UNITS.get(name, "rad"))
                if np.isfinite(flight.measured[:, row]).any():
                    measured = broken_at_gaps(flight.time, factor * flight.measured[:, row])
                    axis.plot(flight.time, measured, color=MEASURED, lw=1.6, label="measured")
                reconstructed = broken_at_gaps(flight.time, factor * flight.reconstructed[:, row])
                axis.plot(flight.time, reconstructed, color=RECONSTRUCTED, lw=0.9, label="reconstructed")
                axis.set_ylabel(f"${tex(name)}$ [{unit}]")
            if flight.name in by_name:
                draw_marks(axes[:, column], by_name[flight.name])
            axes[0][column].set_title(literal(flight.name), loc="left")
            axes[-1][column].set_xlabel("time [s]")
        axes[0][0].legend(ncols=2, **ABOVE)
    caption = f"Measured and reconstructed motion, {' and '.join(f.name for f in flights)} (Figure 7 of the paper)."
    points = sum(2 * f.time.size * len(names) for f in flights)
    return picture(figure, f"figure7_{number + 1}", caption, points)
