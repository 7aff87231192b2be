"""The page of `sideslip estimate`: tables, figures, modes, and what could not be told."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from estimation.models.base import ParameterRole
from estimation.report import published
from estimation.report.advice import untold
from estimation.report.estimate_figures import (
    correlation_figure,
    history_figure,
    proof_figure,
    residual_figure,
    scatter_figure,
)  # fmt: skip
from estimation.report.estimate_tables import estimate_table, fit_table, is_published, joint_table, mean_table
from estimation.report.histories import write_flights
from estimation.report.html import write_page
from estimation.report.modes import SpreadMode, mode_table, modes_with_spread
from estimation.report.names import html
from estimation.report.provenance import provenance_table, simulated
from estimation.report.tables import Table, number, write_all

if TYPE_CHECKING:
    from estimation.session.proof_of_match import Proof
    from estimation.session.session import Session
    from estimation.session.verdict import Verdict

SHOWN = 8  # flights with figures of their own; tables hold all
SEED = 1
UNNAMED = "not stated"  # aircraft of a model of one's own on a flight that does not name one


def write_estimate_report(session: "Session", folder: Path) -> Path:
    """Write folder/index.html with everything inside, and its tables as CSV and LaTeX in folder/tables; returns the page."""
    flights = [f.flight for f in session.flights]
    used = [f for f in session.flights if f.results]
    proofs = _proofs(session)
    tables: dict[str, Table | None] = {
        "joint": joint_table(session), "mean": mean_table(session), "fit": fit_table(session), "modes": _modes(session),
        "proof": _proof_table(session, proofs), "provenance": provenance_table(flights),
    }  # fmt: skip
    each = [estimate_table(session, f) for f in used]
    write_all([*each, *(t for t in tables.values() if t is not None)], folder / "tables")
    best = session.leading
    whose = f"joint, {best.method}" if best is not None else ""
    if best is None and used:
        best = next(iter(used[0].results.values()))
        whose = f"{used[0].flight.name}, {best.method}"
    return write_page(
        folder / "index.html", "estimate.html.j2",
        title=f"Aerodynamic derivatives of {session.aircraft.name}" if session.aircraft.name != UNNAMED else "Derivatives",
        lead=_lead(session),
        status=session.text, converged=session.converged, simulated=simulated(flights),
        comparison=published.COMPARISON if is_published(session) else "",
        tables=tables, each=each, scatter=scatter_figure(session) if used else None,
        verdicts=[(who, v.recommended, v.doubts) for who, v in _verdicts(session)],
        doubts=[(m, html(n), s.text) for m, t in session.mean.items() for n, s in t.items() if s.text],
        histories=[history_figure(f, is_published(session)) for f in used[:SHOWN]],
        residuals=[residual_figure(r.model, r) for f in used[:SHOWN] for r in list(f.results.values())[:1]],
        left_out=max(0, len(used) - SHOWN),
        proof=proof_figure(proofs[:2], refitted(session), is_published(session)) if proofs else None,
        shown=[path.relative_to(folder).as_posix() for path in write_flights(session, folder / "flights", SHOWN)],
        correlation=correlation_figure(best, whose) if best is not None and best.names else None,
        collinear=[(html(a), html(b), f"{rho:+.3f}") for a, b, rho in (best.collinear if best is not None else ())],
        untold=[(html(u.parameter), u) for u in untold(session)],
        runs=[(f.flight.name, m, r.converged, r.text, r.iterations) for f in session.flights for m, r in f.results.items()]
        + [(f.flight.name, m, False, why, 0) for f in session.flights for m, why in f.failures.items()]
        + [("joint", m, r.converged, r.text, r.iterations) for m, r in session.joint.items()]
        + [("joint", m, False, why, 0) for m, why in session.joint_failures.items()],
        notes=list(dict.fromkeys((f.flight.name, n) for f in used for n in f.notes)),
        model=session.model,
    )  # fmt: skip


def _verdicts(session: "Session") -> list[tuple[str, "Verdict"]]:
    """Whose verdict, and the verdict: joint first."""
    found = [("all together", session.verdict), *((f.flight.name, f.verdict) for f in session.flights)]
    return [(who, v) for who, v in found if v is not None]


def _lead(session: "Session") -> str:
    names = [f.flight.name for f in session.flights]
    title = f" ({session.model.title})" if session.model.title else ""
    return (
        f"Model {session.model.name}{title}; {len(names)} flight{'s' if len(names) > 1 else ''}: {', '.join(names)}; "
        f"methods: {', '.join(session.methods)}."
    )


def _proofs(session: "Session") -> list[tuple[str, "Proof"]]:
    """Each flight predicted by each method's estimates of the flight before it, the first by the last.

    Constant coefficients are refitted: trim and sensor offsets of a day say nothing of the derivatives.
    """
    from estimation.session.proof_of_match import predict

    trims = session.model.free_of(ParameterRole.CONSTANT)

    proofs: list[tuple[str, Proof]] = []
    for method in session.methods:
        usable = [(f, r) for f in session.flights for m, r in f.results.items() if m == method and r.converged]
        if len(usable) < 2:
            continue
        by = f", {method}" if len(session.methods) > 1 else ""
        pairs = zip(usable, [usable[-1], *usable[:-1]], strict=True)
        proofs += [(donor[0].flight.name + by, predict(donor[1].fitted_model, f.flight, free=trims))
                   for (f, _), donor in list(pairs)[:SHOWN]]  # fmt: skip
    return proofs


def refitted(session: "Session") -> str:
    """What the proof of match does not freeze."""
    return (
        "initial states and constant coefficients (trim)"
        if session.model.free_of(ParameterRole.CONSTANT)
        else "initial states"
    )


def _proof_table(session: "Session", proofs: list[tuple[str, "Proof"]]) -> Table | None:
    if not proofs:
        return None
    outputs = session.model.output_names
    rows = [
        (
            p.name,
            whose,
            *(
                c
                for o in outputs
                for c in ((number(p.fit[o].r2, 3), number(p.fit[o].theil, 3)) if o in p.fit else ("", ""))
            ),
        )
        for whose, p in proofs
    ]
    return Table(
        "figure10_match", "Proof of match over flights",
        ("flight", "predicted by", *(h for _ in outputs for h in ("r²", "Theil"))),
        tuple(rows), (("", 2), *((o, 2) for o in outputs)), symbols=False,
        note=f"Derivatives frozen, {refitted(session)} refitted. A flight that could not tell a derivative predicts with what "
        "was believed before flying, or with a poor number: its predictions of flights that use that control show it.",
    )  # fmt: skip


def _modes(session: "Session") -> Table | None:
    rng = np.random.default_rng(SEED)
    entries: list[tuple[str, str, list[SpreadMode]]] = []
    for method, result in session.joint.items():
        entries.append(("joint", method, modes_with_spread(result, session.flights[0].flight, rng)))
    for f in session.flights:
        for method, result in list(f.results.items())[:1]:
            if result.converged:
                entries.append((f.flight.name, method, modes_with_spread(result, f.flight, rng)))
    return mode_table(entries) if entries else None
