"""The page of `sideslip estimate`: tables, figures, modes, and what could not be told."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from estimation.models.base import ParameterRole
from estimation.report import published
from estimation.report.advice import grouped, untold
from estimation.report.conventions import conventions_table
from estimation.report.drawing.ellipses import ellipse_figure, most_correlated
from estimation.report.drawing.estimate_figures import (
    correlation_figure,
    history_figure,
    proof_figure,
    scatter_figure,
)
from estimation.report.drawing.figures import Picture
from estimation.report.drawing.histories import write_flights
from estimation.report.drawing.residual_figures import against_figure, moved, residual_figure
from estimation.report.estimate_tables import estimate_table, fit_table, is_published, joint_table, mean_table
from estimation.report.flight_card import flight_card
from estimation.report.markup.html import write_page
from estimation.report.modes import SpreadMode, mode_table, modes_with_spread
from estimation.report.names import html
from estimation.report.notes import notes_table
from estimation.report.provenance import provenance_table, simulated
from estimation.report.tables import ReportTable, number, write_all
from estimation.signals.goodness_of_fit import THEIL_LIMIT

if TYPE_CHECKING:
    from estimation.estimators.result import Result
    from estimation.session.proof_of_match import ProofOfMatch
    from estimation.session.session import EstimationSession, FlightEstimates
    from estimation.session.verdict import Verdict

SHOWN = 8  # flights with figures of their own; tables hold all
SEED = 1
UNNAMED = "not stated"  # aircraft of a model of one's own on a flight that does not name one


def write_estimate_report(session: "EstimationSession", folder: Path) -> Path:
    """Write folder/index.html with everything inside, and its tables as CSV and LaTeX in folder/tables; returns the page."""
    flights = [f.flight for f in session.flights]
    used = [f for f in session.flights if f.results]
    proofs = _proofs(session)
    tables: dict[str, ReportTable | None] = {
        "joint": joint_table(session),
        "mean": mean_table(session),
        "fit": fit_table(session),
        "modes": _modes(session),
        "proof": _proof_table(session, proofs),
        "provenance": provenance_table(flights),
        "conventions": conventions_table(session),
        "runs": _runs(session),
        "verdict": _verdict_table(session),
        "untold": _untold(session),
        "card": flight_card(flights, session.aircraft if session.aircraft.name != UNNAMED else None),
    }
    each = [estimate_table(session, f) for f in used]
    each = [*(replace(t, note="") for t in each[:-1]), *each[-1:]]  # one note on what the columns mean is enough
    write_all([*each, *(t for t in tables.values() if t is not None)], folder / "tables")
    best, whose = _shown_as_map(session)
    return write_page(
        folder / "index.html",
        "estimate.html.j2",
        title=f"Aerodynamic derivatives of {session.aircraft.name}"
        if session.aircraft.name != UNNAMED
        else "Derivatives",
        lead=_lead(session),
        status=session.text,
        converged=session.converged,
        simulated=simulated(flights),
        comparison=published.COMPARISON if is_published(session) else "",
        tables=tables,
        each=each,
        scatter=scatter_figure(session) if used else None,
        doubts=[(m, html(n), s.text) for m, t in session.mean.items() for n, s in t.items() if s.text],
        histories=[history_figure(f, is_published(session)) for f in used[:SHOWN]],
        residuals=[p for f in used[:SHOWN] for p in _residual_figures(f)],
        left_out=max(0, len(used) - SHOWN),
        proof=proof_figure(proofs[:2], refitted(session), is_published(session)) if proofs else None,
        shown=[path.relative_to(folder).as_posix() for path in write_flights(session, folder / "flights", SHOWN)],
        correlation=correlation_figure(best, whose) if best is not None and best.names else None,
        ellipses=_ellipses(session, used[:1], whose),
        collinear=[(html(a), html(b), f"{rho:+.3f}") for a, b, rho in (best.collinear if best is not None else ())],
        untold=[([html(n) for n in g.parameters], g) for g in grouped(untold(session))],
        notes=notes_table((f.flight.name, n) for f in used for n in f.notes),
        model=session.model,
    )


def estimate_figures(session: "EstimationSession") -> dict[str, Callable[[], Picture | None]]:
    """What draws each figure of the page, by the figure's name, in the order of the page."""
    used = [f for f in session.flights if f.results][:SHOWN]
    best, whose = _shown_as_map(session)
    if best is None:
        return {}
    ours = is_published(session)
    drawn: dict[str, Callable[[], Picture | None]] = {"figure8": partial(scatter_figure, session)}
    for f in used:
        first, name = next(iter(f.results.values())), f.flight.name
        drawn[f"figure9_{name}"] = partial(history_figure, f, ours)
        drawn[f"residuals_{name}"] = partial(residual_figure, first.model, first)
        if moved(first, f.flight):
            drawn[f"against_{name}"] = partial(against_figure, first.model, first, f.flight)
    if sum(r.converged for f in used for r in list(f.results.values())[:1]) > 1:
        drawn["figure10"] = lambda: proof_figure(_proofs(session)[:2], refitted(session), ours)
    if best.names:
        drawn["correlations"] = partial(correlation_figure, best, whose)
    if most_correlated(best):
        drawn["ellipses"] = partial(_ellipses, session, used[:1], whose)
    return drawn


def _shown_as_map(session: "EstimationSession") -> "tuple[Result | None, str]":
    """Whose correlations are drawn: the joint estimate's, else the first flight's; and whose that is in words."""
    best = session.leading
    if best is not None:
        return best, f"joint, {best.method}"
    for f in session.flights:
        for result in f.results.values():
            return result, f"{f.flight.name}, {result.method}"
    return None, ""


def _verdicts(session: "EstimationSession") -> list[tuple[str, "Verdict"]]:
    """Whose verdict, and the verdict: joint first."""
    found = [("all together", session.verdict), *((f.flight.name, f.verdict) for f in session.flights)]
    return [(who, v) for who, v in found if v is not None]


def _lead(session: "EstimationSession") -> str:
    names = [f.flight.name for f in session.flights]
    title = f" ({session.model.title})" if session.model.title else ""
    return (
        f"Model {session.model.name}{title}; {len(names)} flight{'s' if len(names) > 1 else ''}: {', '.join(names)}; "
        f"methods: {', '.join(session.methods)}."
    )


def _proofs(session: "EstimationSession") -> list[tuple[str, "ProofOfMatch"]]:
    """Each flight predicted by each method's estimates of the flight before it, the first by the last.

    Constant coefficients are refitted: trim and sensor offsets of a day say nothing of the derivatives.
    """
    from estimation.session.proof_of_match import predict_flight

    trims = session.model.free_of(ParameterRole.CONSTANT)

    proofs: list[tuple[str, ProofOfMatch]] = []
    for method in session.methods:
        usable = [(f, r) for f in session.flights for m, r in f.results.items() if m == method and r.converged]
        if len(usable) < 2:
            continue
        by = f", {method}" if len(session.methods) > 1 else ""
        pairs = zip(usable, [usable[-1], *usable[:-1]], strict=True)
        proofs += [
            (donor[0].flight.name + by, predict_flight(donor[1].fitted_model, f.flight, free=trims))
            for (f, _), donor in list(pairs)[:SHOWN]
        ]
    return proofs


def refitted(session: "EstimationSession") -> str:
    """What the proof of match does not freeze."""
    return (
        "initial states and constant coefficients (trim)"
        if session.model.free_of(ParameterRole.CONSTANT)
        else "initial states"
    )


def _verdict_table(session: "EstimationSession") -> ReportTable:
    """Which estimate is recommended, for each flight and all together, why, and what is doubtful about it."""
    verdicts = _verdicts(session)
    rows = tuple(
        (who, v.recommended.method, v.recommended.why, "; ".join(f"{d.kind.value}: {d.text}" for d in v.doubts))
        for who, v in verdicts
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
    ended = [
        (f.flight.name, m, r.text, r.iterations, r.converged) for f in session.flights for m, r in f.results.items()
    ]
    ended += [(f.flight.name, m, why, 0, False) for f in session.flights for m, why in f.failures.items()]
    ended += [("joint", m, r.text, r.iterations, r.converged) for m, r in session.joint.items()]
    ended += [("joint", m, why, 0, False) for m, why in session.joint_failures.items()]
    rows = tuple((who, m, text, str(n)) for who, m, text, n, _ in ended)
    failed = frozenset((i, 2) for i, (*_, good) in enumerate(ended) if not good)
    head = ("flight", "method", "end", "iterations")
    what = "Each flight and method, and all flights together"
    return ReportTable("runs", what, head, rows, symbols=False, texts=(1, 2), failed=failed)


def _untold(session: "EstimationSession") -> ReportTable:
    """Every parameter, method and reason, for the file beside the page."""
    head = ("parameter", "method", "flights", "why", "fly next", "joint")
    rows = tuple(
        (u.parameter, u.method, ", ".join(u.where), u.why, u.manoeuvre, "told" if u.told else "")
        for u in untold(session)
    )
    return ReportTable("untold", "What could not be told", head, rows, texts=(2, 3, 4))


def _residual_figures(f: "FlightEstimates") -> list[Picture]:
    """Residuals of the first method over time, and against incidence, sideslip and surfaces."""
    first = next(iter(f.results.values()))
    figures = (residual_figure(first.model, first), against_figure(first.model, first, f.flight))
    return [p for p in figures if p is not None]


def _ellipses(session: "EstimationSession", first: "Sequence[FlightEstimates]", whose: str) -> Picture | None:
    """Ellipses of the joint estimates of all methods, the leading one first; without these, of the first flight's."""
    leading = session.leading
    if leading is not None:
        rest = [r for r in session.joint.values() if r is not leading]
        return ellipse_figure([leading, *rest], "all flights together", session.truth)
    return ellipse_figure([r for f in first for r in f.results.values()], whose.partition(",")[0], session.truth)


def _proof_table(session: "EstimationSession", proofs: list[tuple[str, "ProofOfMatch"]]) -> ReportTable | None:
    if not proofs:
        return None
    outputs = session.model.output_names
    rows: list[tuple[str, ...]] = []
    failed: set[tuple[int, int]] = set()
    for whose, p in proofs:
        fits = [p.fit.get(o) for o in outputs]
        beyond = [k for k, fit in enumerate(fits) if fit is not None and not fit.theil <= THEIL_LIMIT]
        failed |= {(len(rows), 3 + 2 * k) for k in beyond} | ({(len(rows), 2 + 2 * len(outputs))} if beyond else set())
        cells = [c for fit in fits for c in (("", "") if fit is None else (number(fit.r2, 3), number(fit.theil, 3)))]
        rows.append((p.name, whose, *cells, "FAIL" if beyond else "pass"))
    return ReportTable(
        "figure10_match",
        "Proof of match over flights",
        ("flight", "predicted by", *(h for _ in outputs for h in ("r²", "Theil")), "match"),
        tuple(rows),
        (("", 2), *((o, 2) for o in outputs), ("", 1)),
        symbols=False,
        failed=frozenset(failed),
        note=f"Limit: Theil's coefficient at most {THEIL_LIMIT:g} in every channel; in red what is above it. Derivatives frozen, "
        f"{refitted(session)} refitted. A flight that could not tell a derivative predicts with what was believed before flying, "
        "or with a poor number: its predictions of flights that use that control show it.",
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
