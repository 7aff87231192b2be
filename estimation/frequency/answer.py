"""A frequency response with its fit and handling-quality numbers, as lines, as JSON and as a page."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from daq.utilities.constants import RADIAN
from estimation.frequency.figure import response_picture
from estimation.frequency.handling import Number, RatedAircraft, handling
from estimation.frequency.response import FrequencyResponse
from estimation.frequency.transfer import TransferFunction, fit_transfer
from estimation.report.flight_tables import provenance_table
from estimation.report.page import Page, Part, Section, box, paragraph, sentence
from estimation.report.tables import ReportTable, number, significant, value_and_bound
from groundstation.flight import Flight

ACCEPTABLE = 100.0  # CIFER's J; Tischler and Remple, chapter 11
LINES = 16  # frequencies that the terminal shows


@dataclass(frozen=True)
class FrequencyResult:
    """fit: None where no form was given. numbers: of handling qualities."""

    response: FrequencyResponse
    fit: TransferFunction | None = None
    numbers: tuple[Number, ...] = ()
    aircraft: RatedAircraft = field(default_factory=RatedAircraft)

    def to_json(self) -> dict[str, Any]:
        data = self.response.to_json()
        if self.fit is None:
            return data
        return {
            **data,
            "fit": {
                **self.fit.to_json(),
                "handling": [n.to_json() for n in self.numbers],
                "levels": self.aircraft.why_no_level
                or f"class {self.aircraft.kind}, category {self.aircraft.category}",
                "status": judged(self.fit),
            },
        }


def frequency_answer(response: FrequencyResponse, form: str | None, aircraft: RatedAircraft) -> FrequencyResult:
    """The response, with a fit of `form` where one is given."""
    if form is None:
        return FrequencyResult(response, aircraft=aircraft)
    fit = fit_transfer(response, form)
    return FrequencyResult(response, fit, handling(response, fit, aircraft), aircraft)


def judged(fit: TransferFunction) -> str:
    """Whether a fit is acceptable, in words."""
    if fit.cost > ACCEPTABLE:
        return (
            f"the form does not describe the data (cost {fit.cost:.0f}, acceptable up to {ACCEPTABLE:g}); fit "
            "another form or a narrower band"
        )
    return f"the form describes the data (cost {fit.cost:.1f}, acceptable up to {ACCEPTABLE:g})"


def response_lines(result: FrequencyResult) -> Iterator[str]:
    """Lines for the terminal."""
    r = result.response
    yield (
        f"{r.output} to {r.input}{r.conditioned}: {r.omega.size} frequencies from {r.omega[0]:.3g} to "
        f"{r.omega[-1]:.3g} rad/s, {r.duration:.4g} s of data"
    )
    yield f"  {'rad/s':>8}{'magnitude':>12}{'+-':>10}{'phase [deg]':>13}{'+-':>8}{'coherence':>11}"
    for k in range(0, r.omega.size, max(1, -(-r.omega.size // LINES))):
        phase, error = RADIAN * r.phase[k], RADIAN * r.std_phase[k]
        yield (
            f"  {r.omega[k]:8.3g}{r.magnitude[k]:12.4g}{r.std[k]:10.2g}{phase:13.1f}{error:8.1f}{r.coherence[k]:11.2f}"
        )
    if r.left_out:
        yield f"  left out for low coherence or large error: {len(r.left_out)} frequencies"
    for note in r.notes:
        yield f"  note: {note}"
    if result.fit is not None:
        yield from _fit_lines(result, result.fit)


def _fit_lines(result: FrequencyResult, fit: TransferFunction) -> Iterator[str]:
    yield ""
    yield f"fit {fit.form.name}, {fit.points} frequencies from {fit.omega[0]:.3g} to {fit.omega[1]:.3g} rad/s: {judged(fit)}"
    yield f"  H = {fit.form.equation}"
    yield f"  {'parameter':<12}{'estimate':>11}{'bound':>10}{'CIFER cost':>12}"
    for name, p in fit.parameters.items():
        yield f"  {name:<12}{p.estimate:11.4g}{p.std:10.2g}{fit.cifer[name]:12.4g}  {p.unit}"
    for n in result.numbers:
        bound = "" if math.isnan(n.std) else f" +- {n.std:.2g}"
        level = "" if n.level is None else ", beyond level 3" if n.level > 3 else f", level {n.level}"
        unit = "" if n.unit == "1" else f" {n.unit}"
        yield f"  {n.name} = {n.value:.4g}{bound}{unit}: {n.definition} ({n.source}){level}"
    if result.aircraft.why_no_level:
        yield f"  {result.aircraft.why_no_level}"


def write_frequency_report(result: FrequencyResult, flights: Sequence[Flight], folder: Path) -> Path:
    """Write folder/index.html, with its tables as CSV and LaTeX beside it; returns the page."""
    r = result.response
    warnings = box((paragraph(f"{note[:1].upper()}{note[1:]}") for note in r.notes), warn=True) if r.notes else None
    picture, numbers = [response_picture(r, result.fit)], [response_table(result)]
    sections = [
        Section("", "", [warnings]),
        Section("frequency_response_figure", "Response", picture, "Response"),
        *_fit_sections(result),
        Section("table", "Response in numbers", numbers, "Table"),
        Section("provenance_of_flights", "Provenance", [provenance_table(flights)], "Provenance"),
    ]
    lengths = ", ".join(f"{w:.3g}" for w in r.windows)
    lead = f"{', '.join(r.flights)}: {r.duration:.4g} s of data{r.conditioned}; windows of {lengths} s."
    page = Page(f"Frequency response of {r.output} to {r.input}", lead, sections)
    return page.write(folder / "index.html", folder / "tables")


def _fit_sections(result: FrequencyResult) -> list[Section]:
    """The transfer function and its handling qualities, where one was fitted."""
    if result.fit is None:
        return []
    no_level = result.aircraft.why_no_level
    note = paragraph(sentence(no_level), "note") if no_level else None
    fit: list[Part] = [paragraph(sentence(judged(result.fit))), _fit_table(result.fit)]
    handling = _handling_table(result)
    if handling is None:
        return [Section("fit", "Transfer function", [*fit, note], "Fit")]
    return [
        Section("fit", "Transfer function", fit, "Fit"),
        Section("handling", "Handling qualities", [handling, note]),
    ]


def response_table(result: FrequencyResult) -> ReportTable:
    """All frequencies of the response."""
    r = result.response
    rows = tuple(
        (
            significant(float(r.omega[k]), 4),
            *value_and_bound(float(r.magnitude[k]), float(r.std[k])),
            *value_and_bound(RADIAN * float(r.phase[k]), RADIAN * float(r.std_phase[k])),
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


def _fit_table(fit: TransferFunction) -> ReportTable:
    rows = tuple(
        (n, *value_and_bound(p.estimate, p.std), significant(fit.cifer[n], 4), p.unit)
        for n, p in fit.parameters.items()
    )
    return ReportTable(
        "transfer_function",
        f"Transfer function, form {fit.form.name}: H = {fit.form.equation}",
        ("parameter", "estimate", "bound", "at the least CIFER cost", "unit"),
        rows,
        symbols=False,
        note="Estimates and bounds by maximum likelihood over the random errors; the bound allows for neighbouring "
        "frequencies, which share windows.",
    )


def _handling_table(result: FrequencyResult) -> ReportTable | None:
    if not result.numbers:
        return None
    rows = tuple(
        (
            n.name,
            *(value_and_bound(n.value, n.std) if math.isfinite(n.std) else (significant(n.value, 4), "")),
            n.unit,
            "" if n.level is None else "beyond 3" if n.level > 3 else str(n.level),
            n.definition,
            n.source,
        )
        for n in result.numbers
    )
    head = ("number", "value", "bound", "unit", "level", "definition", "source")
    note = "Of the response to the measured surface: the servo before it is not in them."
    return ReportTable(
        "handling_qualities", "Handling-quality numbers", head, rows, symbols=False, texts=(5, 6), note=note
    )
