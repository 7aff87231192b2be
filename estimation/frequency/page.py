"""The page of `sideslip frequency`: the figure, the fit, handling-quality numbers and where the flights come from."""

import math
from collections.abc import Sequence
from pathlib import Path

from daq.contract.constants import RADIAN
from estimation.frequency.answer import FrequencyResult, judged
from estimation.frequency.figure import response_picture
from estimation.report.markup.html import write_page
from estimation.report.provenance import provenance_table
from estimation.report.tables import ReportTable, number, pair, significant, write_all
from groundstation.flight import Flight

HERE = Path(__file__).parent


def write_frequency_report(found: FrequencyResult, flights: Sequence[Flight], folder: Path) -> Path:
    """Write folder/index.html, with its tables as CSV and LaTeX beside it; returns the page."""
    r = found.response
    tables = {
        "response": response_table(found),
        "fit": _fit_table(found),
        "handling": _handling_table(found),
        "provenance": provenance_table(flights),
    }
    write_all([t for t in tables.values() if t is not None], folder / "tables")
    beside = f", with {', '.join(r.inputs[1:])} taken off" if len(r.inputs) > 1 else ""
    lengths = ", ".join(f"{w:.3g}" for w in r.windows)
    return write_page(
        folder / "index.html",
        "frequency.html.j2",
        templates=HERE,
        title=f"Frequency response of {r.output} to {r.input}",
        lead=f"{', '.join(r.flights)}: {r.duration:.4g} s of data{beside}; windows of {lengths} s.",
        tables=tables,
        figure=response_picture(r, found.fit),
        notes=r.notes,
        fit=found.fit,
        judged="" if found.fit is None else judged(found.fit),
        levels=found.craft.why_no_level,
    )


def response_table(found: FrequencyResult) -> ReportTable:
    """Every frequency kept."""
    r = found.response
    rows = tuple(
        (
            significant(float(r.omega[k]), 4),
            *pair(float(r.magnitude[k]), float(r.std[k])),
            *pair(RADIAN * float(r.phase[k]), RADIAN * float(r.std_phase[k])),
            number(float(r.coherence[k]), 3),
        )
        for k in range(r.omega.size)
    )
    return ReportTable(
        "frequency_response",
        "Frequency response with its random error, one standard deviation",
        ("frequency [rad/s]", "magnitude", "error", "phase [deg]", "error", "coherence"),
        rows,
        symbols=False,
    )


def _fit_table(found: FrequencyResult) -> ReportTable | None:
    fit = found.fit
    if fit is None:
        return None
    rows = tuple((n, *pair(p.estimate, p.std), significant(fit.cifer[n], 4), p.unit) for n, p in fit.parameters.items())
    return ReportTable(
        "transfer_function",
        f"Transfer function, form {fit.form.name}: H = {fit.form.equation}",
        ("parameter", "estimate", "bound", "at the least CIFER cost", "unit"),
        rows,
        symbols=False,
        note="Estimates and bounds by maximum likelihood over the random errors; the bound counts that neighbouring "
        "frequencies share windows.",
    )


def _handling_table(found: FrequencyResult) -> ReportTable | None:
    if not found.numbers:
        return None
    rows = tuple(
        (
            n.name,
            *(pair(n.value, n.std) if math.isfinite(n.std) else (significant(n.value, 4), "")),
            n.unit,
            "" if n.level is None else "beyond 3" if n.level > 3 else str(n.level),
            n.definition,
            n.source,
        )
        for n in found.numbers
    )
    head = ("number", "value", "bound", "unit", "level", "definition", "source")
    note = "Of the response to the measured surface: the servo before it is not in them."
    return ReportTable(
        "handling_qualities", "Handling-quality numbers", head, rows, symbols=False, texts=(5, 6), note=note
    )
