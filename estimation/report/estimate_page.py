"""The page of `sideslip estimate`: tables, figures, modes, and parameters that are not identifiable."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup

from estimation.models.base import ParameterRole
from estimation.report import published
from estimation.report.advice import grouped, unidentified_parameters
from estimation.report.answer import answer_table, leading_answer, next_steps
from estimation.report.conventions import conventions_table
from estimation.report.drawing.estimate_figures import (
    correlation_figure,
    ellipse_figure,
    history_figure,
    most_correlated,
    proof_figure,
    scatter_figure,
)
from estimation.report.drawing.figures import Picture
from estimation.report.drawing.forest import forest_figure, strips_figure
from estimation.report.drawing.histories import write_flights
from estimation.report.drawing.residual_figures import against_figure, moved_quantities, residual_figure
from estimation.report.estimate_tables import (
    estimate_table,
    fit_table,
    is_published,
    joint_table,
    match_table,
    mean_table,
)
from estimation.report.flight_tables import flight_card, notes_table, provenance_table, simulated
from estimation.report.modes import SpreadMode, mode_table, modes_with_spread
from estimation.report.names import html
from estimation.report.page import Page, Section, box, bullets, free_table, paragraph, sentence
from estimation.report.tables import ReportTable
from estimation.signals.goodness_of_fit import THEIL_LIMIT

if TYPE_CHECKING:
    from estimation.estimators.result import Result
    from estimation.models.base import Model
    from estimation.session.proof_of_match import ProofOfMatch
    from estimation.session.session import EstimationSession, FlightEstimates
    from estimation.session.verdict import Verdict

SHOWN = 8  # flights with their own figures; tables contain all
SHORT = 8  # rows up to which print does not break the table of manoeuvres
SEED = 1  # of the draws that give modes their spread
UNNAMED = "not stated"  # name of the aircraft where neither model nor flight names one


def write_estimate_report(session: "EstimationSession", folder: Path) -> Path:
    """Write folder/index.html with everything inside, and its tables as CSV and LaTeX in folder/tables; returns the page."""
    flights = [f.flight for f in session.flights]
    estimated_flights = [f for f in session.flights if f.results]
    proofs = cache(partial(_proofs, session))
    figures = {
        section: [p for draw in section_figures.values() if (p := draw()) is not None]
        for section, section_figures in _figures(session, proofs).items()
    }
    flight_tables = [estimate_table(session, f) for f in estimated_flights]
    # one note on the meaning of the columns is enough
    flight_tables = [*(replace(t, note="") for t in flight_tables[:-1]), *flight_tables[-1:]]
    rerun = [path.relative_to(folder).as_posix() for path in write_flights(session, folder / "flights", SHOWN)]
    named_aircraft = session.aircraft if session.aircraft.name != UNNAMED else None
    joint, mean, proof = joint_table(session), mean_table(session), _proof_table(session, proofs())
    modes = _modes(session) or paragraph("No usable estimate to linearise about.")
    leading, _ = _leading_result(session)
    comparison = paragraph(published.COMPARISON, "note") if is_published(session) else None
    notes = notes_table((f.flight.name, note) for f in estimated_flights for note in f.notes)
    detail, unprinted = partial(Section, folded=True), partial(Section, folded=True, printed=False)
    sections = [
        *_first_screen(session),
        detail("verdict", "Which estimate to use", [_verdict_table(session)], "Recommendation"),
        detail("card", "Flight card", [flight_card(flights, named_aircraft)], "Flight card"),
        detail("scatter", "Each derivative over flights and methods", [*figures["scatter"], comparison])
        if estimated_flights
        else None,
        detail("joint", "All flights together", [joint], "Joint") if joint else None,
        # on paper the joint estimate stands for the flights
        (unprinted if joint else detail)("mean", "Mean and scatter", [mean], "Means") if mean else None,
        unprinted("flights", "Flight by flight", flight_tables, "Flights"),
        detail("untold", "Not identifiable, and what would identify it", _advice_parts(session), "Not identifiable"),
        unprinted(
            "histories",
            "Measured and estimated motion",
            [
                _rerun_note(rerun),
                *figures["histories"],
                _tables_only(len(estimated_flights) - SHOWN),
                fit_table(session),
            ],
            "Histories",
        ),
        unprinted("residuals", "Residuals", figures["residuals"], "Residuals"),
        detail("proof", "Proof of match", [*figures["proof"], proof], "Proof of match") if proof else None,
        unprinted("modes", "Modes", [modes], "Modes"),
        unprinted("correlation", "Correlations", [*figures["correlation"], _collinear(leading)], "Correlations"),
        unprinted("runs", "How each fit ended", [_runs(session), notes]),
        detail("conventions", "Conventions", [conventions_table(session)], "Conventions"),
        detail("provenance", "Provenance", [provenance_table(flights), _equations(session.model)], "Provenance"),
    ]
    title = "Derivatives" if named_aircraft is None else f"Aerodynamic derivatives of {named_aircraft.name}"
    page = Page(title, _lead(session), sections, beside=[_unidentified_table(session)])
    return page.write(folder / "index.html", folder / "tables")


def estimate_figures(session: "EstimationSession") -> dict[str, Callable[[], Picture | None]]:
    """Name of a figure -> function that draws it, in the order of the page."""
    figures_by_section = _figures(session, cache(partial(_proofs, session)))
    return {name: draw for section in figures_by_section.values() for name, draw in section.items()}


def _figures(
    session: "EstimationSession", proofs: "Callable[[], list[tuple[str, ProofOfMatch]]]"
) -> dict[str, dict[str, Callable[[], Picture | None]]]:
    """Section of the page -> name of a figure -> function that draws it. A new figure needs a line here and its function."""
    sections: dict[str, dict[str, Callable[[], Picture | None]]]
    sections = {n: {} for n in ("answer", "scatter", "histories", "residuals", "proof", "correlation")}
    estimated_flights = [f for f in session.flights if f.results][:SHOWN]
    leading, source = _leading_result(session)
    if leading is None:
        return sections
    of_paper = is_published(session)
    sections["answer"] = {
        "forest": lambda: forest_figure(leading_answer(session).rows),
        "strips": partial(strips_figure, leading),
    }
    sections["scatter"]["figure8"] = partial(scatter_figure, session)
    for f in estimated_flights:
        first, name = next(iter(f.results.values())), f.flight.name
        sections["histories"][f"figure9_{name}"] = partial(history_figure, f, of_paper)
        sections["residuals"][f"residuals_{name}"] = partial(residual_figure, first.model, first)
        if moved_quantities(first, f.flight):
            sections["residuals"][f"against_{name}"] = partial(against_figure, first.model, first, f.flight)
    if _can_be_proved(session):
        sections["proof"]["figure10"] = lambda: proof_figure(proofs()[:2], refitted(session), of_paper)
    if leading.names:
        sections["correlation"]["correlations"] = partial(correlation_figure, leading, source)
    if most_correlated(leading):
        sections["correlation"]["ellipses"] = partial(_ellipses, session, estimated_flights[:1], source)
    return sections


def _can_be_proved(session: "EstimationSession") -> bool:
    """Whether a method has usable estimates of two flights."""
    fits = [[f.results[m].converged for f in session.flights if m in f.results] for m in session.methods]
    return any(sum(converged) > 1 for converged in fits)


def _first_screen(session: "EstimationSession") -> list[Section]:
    """The answer on one page: sentence, derivatives as a table and as a picture, the fit in strips, what to do next."""
    answer = leading_answer(session)
    verdict = paragraph(sentence(answer.verdict), "verdict-line")
    pictures = estimate_figures(session)
    drawings = {name: pictures[name]() for name in ("forest", "strips") if name in pictures}
    steps = [Markup("<p><b>Next</b></p>"), bullets(next_steps(session, answer))]
    table = answer_table(session, answer) if answer.rows else None
    return [
        Section("", "", [verdict, _status_box(session)]),
        Section("answer", "", [table, drawings.get("forest")], kind="answer"),
        Section("", "", [drawings.get("strips"), *steps]),
    ]


def _status_box(session: "EstimationSession") -> Markup | None:
    """What did not converge, and which means are doubtful; None where there is no such thing."""
    lines = [] if session.converged else [paragraph(sentence(session.text))]
    doubts = [(m, html(n), s.text) for m, t in session.mean.items() for n, s in t.items() if s.text]
    lines += [Markup("<p>{}, {}: {}.</p>").format(*doubt) for doubt in doubts]
    return box(lines, warn=not session.converged) if lines else None


def _rerun_note(paths: Sequence[str]) -> Markup:
    commands = Markup(", ").join(Markup("<code>sideslip view {}</code>").format(path) for path in paths)
    return paragraph(Markup("The same in rerun: {}{}").format(commands, "." if paths else ""), "note")


def _tables_only(count: int) -> Markup | None:
    return paragraph(f"{count} more flights are in the tables only.", "note") if count > 0 else None


def _collinear(result: "Result | None") -> Markup | None:
    """Pairs of estimates that the data hardly separate."""
    if result is None or not result.collinear:
        return None
    pairs = [Markup("{} and {} ({})").format(html(a), html(b), f"{rho:+.3f}") for a, b, rho in result.collinear]
    return paragraph(Markup("Beyond 0.9: {}.").format(Markup("; ").join(pairs)))


def _equations(model: "Model") -> Markup:
    summary = Markup("<summary>Model {} (digest {})</summary>").format(model.name, model.digest)
    return Markup("<details>{}<pre>{}</pre></details>").format(summary, "\n".join(model.equations))


def _advice_parts(session: "EstimationSession") -> list[Markup]:
    """A table with a row for each manoeuvre that would determine more parameters."""
    groups = grouped(unidentified_parameters(session))
    if not groups:
        return [paragraph("Every flight determines every parameter.")]
    words = (
        "fly next",
        "it would determine",
        "flights that could not",
        "why",
        "methods",
        "determined by all flights together",
    )
    comma = Markup(", ")
    rows = [
        (
            group.manoeuvre,
            comma.join(html(n) for n in group.parameters),
            ", ".join(group.where),
            "; ".join(group.whys),
            ", ".join(group.methods),
            comma.join(html(n) for n in group.determined_jointly) or "none",
        )
        for group in groups
    ]
    table = free_table(
        [("text", word) for word in words],
        [[("text", cell) for cell in row] for row in rows],
        "short" if len(groups) <= SHORT else "",
        "One row for each manoeuvre that would tell more",
    )
    note = "Each flight, method and parameter with its numbers: <code>tables/untold.csv</code> beside this page."
    return [table, paragraph(Markup(note), "note")]


def _leading_result(session: "EstimationSession") -> "tuple[Result | None, str]":
    """The result whose fit and correlations are drawn, the joint one, else the first flight's; and its source in words."""
    leading = session.leading
    if leading is not None:
        return leading, f"joint, {leading.method}"
    for f in session.flights:
        for result in f.results.values():
            return result, f"{f.flight.name}, {result.method}"
    return None, ""


def _verdicts(session: "EstimationSession") -> list[tuple[str, "Verdict"]]:
    """(subject, verdict), the joint one first."""
    verdicts = [("all together", session.verdict), *((f.flight.name, f.verdict) for f in session.flights)]
    return [(subject, v) for subject, v in verdicts if v is not None]


def _lead(session: "EstimationSession") -> str:
    names = [f.flight.name for f in session.flights]
    title = f" ({session.model.title})" if session.model.title else ""
    return (
        f"Model {session.model.name}{title}; {len(names)} flight{'s' if len(names) > 1 else ''}: {', '.join(names)}; "
        f"methods: {', '.join(session.methods)}."
        + (" These flights come from a simulator." if simulated([f.flight for f in session.flights]) else "")
    )


def _proofs(session: "EstimationSession") -> list[tuple[str, "ProofOfMatch"]]:
    """(source of the parameters, proof) for each method: each flight predicted by the estimates of the flight before it, the
    first by the last.

    Constant coefficients are refitted, because trim and sensor offsets of a day tell nothing about the derivatives.
    """
    from estimation.session.proof_of_match import predict_flight

    trims = session.model.free_of(ParameterRole.CONSTANT)

    proofs: list[tuple[str, ProofOfMatch]] = []
    for method in session.methods:
        usable = [(f, r) for f in session.flights for m, r in f.results.items() if m == method and r.converged]
        if len(usable) < 2:
            continue
        method_note = f", {method}" if len(session.methods) > 1 else ""
        pairs = zip(usable, [usable[-1], *usable[:-1]], strict=True)
        proofs += [
            (donor[0].flight.name + method_note, predict_flight(donor[1].fitted_model, f.flight, free=trims))
            for (f, _), donor in list(pairs)[:SHOWN]
        ]
    return proofs


def refitted(session: "EstimationSession") -> str:
    """The parameters that the proof of match refits, in words."""
    return (
        "initial states and constant coefficients (trim)"
        if session.model.free_of(ParameterRole.CONSTANT)
        else "initial states"
    )


def _verdict_table(session: "EstimationSession") -> ReportTable:
    """Which estimate is recommended, for each flight and all together, why, and what is doubtful about it."""
    verdicts = _verdicts(session)
    rows = tuple(
        (subject, v.recommended.method, v.recommended.why, "; ".join(f"{d.kind.value}: {d.text}" for d in v.doubts))
        for subject, v in verdicts
    )
    failed = frozenset((i, 1) for i, (_, v) in enumerate(verdicts) if v.recommended.method == "none")
    head = ("estimate", "recommended", "why", "doubts")
    return ReportTable(
        "verdict",
        "The method recommended, why, and what is doubted",
        head,
        rows,
        symbols=False,
        texts=(2, 3),
        failed=failed,
    )


def _runs(session: "EstimationSession") -> ReportTable:
    """How each fit ended, failures among them."""
    run_entries = [
        (f.flight.name, m, r.text, r.iterations, r.converged) for f in session.flights for m, r in f.results.items()
    ]
    run_entries += [(f.flight.name, m, reason, 0, False) for f in session.flights for m, reason in f.failures.items()]
    run_entries += [("joint", m, r.text, r.iterations, r.converged) for m, r in session.joint.items()]
    run_entries += [("joint", m, reason, 0, False) for m, reason in session.joint_failures.items()]
    rows = tuple((subject, m, text, str(n)) for subject, m, text, n, _ in run_entries)
    failed = frozenset((i, 2) for i, (*_, succeeded) in enumerate(run_entries) if not succeeded)
    head = ("flight", "method", "end", "iterations")
    caption = "Each flight and method, and all flights together"
    return ReportTable("runs", caption, head, rows, symbols=False, texts=(1, 2), failed=failed)


def _unidentified_table(session: "EstimationSession") -> ReportTable:
    """Every parameter, method and reason, for the file beside the page."""
    head = ("parameter", "method", "flights", "why", "fly next", "joint")
    rows = tuple(
        (u.parameter, u.method, ", ".join(u.where), u.why, u.manoeuvre, "determined" if u.determined_jointly else "")
        for u in unidentified_parameters(session)
    )
    return ReportTable("untold", "What these flights cannot determine", head, rows, texts=(2, 3, 4))


def _ellipses(session: "EstimationSession", first: "Sequence[FlightEstimates]", source: str) -> Picture | None:
    """Ellipses of the joint estimates of all methods, the leading one first; without these, of the first flight's."""
    leading = session.leading
    if leading is not None:
        rest = [r for r in session.joint.values() if r is not leading]
        return ellipse_figure([leading, *rest], "all flights together", session.truth)
    return ellipse_figure([r for f in first for r in f.results.values()], source.partition(",")[0], session.truth)


def _proof_table(session: "EstimationSession", proofs: list[tuple[str, "ProofOfMatch"]]) -> ReportTable | None:
    if not proofs:
        return None
    outputs = session.model.output_names
    fits = [[p.fit.get(output) for output in outputs] for _, p in proofs]
    pairs = [
        [(None, None, 0.0) if fit is None else (fit.r2, fit.theil, fit.limit(THEIL_LIMIT)) for fit in flight]
        for flight in fits
    ]
    return match_table(
        "figure10_match",
        "Proof of match over flights",
        ("flight", "predicted by"),
        outputs,
        zip([(p.name, donor) for donor, p in proofs], pairs, strict=True),
        THEIL_LIMIT,
        f" Derivatives frozen, {refitted(session)} refitted. A flight that could not tell a derivative predicts with what was"
        " believed before flying, or with a poor number: its predictions of flights that use that control show it.",
    )


def _modes(session: "EstimationSession") -> ReportTable | None:
    rng = np.random.default_rng(SEED)
    entries: list[tuple[str, str, list[SpreadMode]]] = []
    for method, result in session.joint.items():
        entries.append(("joint", method, modes_with_spread(result, session.flights[0].flight, rng)))
    for f in session.flights:
        for method, result in list(f.results.items())[:1]:
            if result.converged:
                entries.append((f.flight.name, method, modes_with_spread(result, f.flight, rng)))
    return mode_table(entries) if entries else None
