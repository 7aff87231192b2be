"""The page of `sideslip estimate`: tables, figures, modes, and what could not be told."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

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
from estimation.report.html import write_page
from estimation.report.modes import SpreadMode, mode_table, modes_with_spread
from estimation.report.names import html
from estimation.report.provenance import provenance_table, simulated
from estimation.report.tables import Table, number, write_all

if TYPE_CHECKING:
    from estimation.laboratory import Session
    from estimation.proof import Proof

SHOWN = 8  # flights with figures of their own; tables hold all
SEED = 1


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
    best = session.joint.get("ml") or next(iter(session.joint.values()), None)
    whose = f"joint, {best.method}" if best is not None else ""
    if best is None and used:
        best = next(iter(used[0].results.values()))
        whose = f"{used[0].flight.name}, {best.method}"
    return write_page(
        folder / "index.html", "estimate.html.j2",
        title=f"Aerodynamic derivatives of {session.aircraft.name}",
        lead=f"Model {session.model.name} ({session.model.title}); {len(flights)} flight{'s' if len(flights) > 1 else ''}: "
        f"{', '.join(f.name for f in flights)}; methods: {', '.join(session.methods)}.",
        status=session.text, converged=session.converged, simulated=simulated(flights),
        comparison=published.COMPARISON if is_published(session) else "",
        tables=tables, each=each, scatter=scatter_figure(session) if used else None,
        doubts=[(m, html(n), s.text) for m, t in session.mean.items() for n, s in t.items() if s.text and not n.endswith("_0")],
        histories=[history_figure(session.model, f) for f in used[:SHOWN]],
        residuals=[residual_figure(r.model, r) for f in used[:SHOWN] for r in list(f.results.values())[:1]],
        left_out=max(0, len(used) - SHOWN),
        proof=proof_figure(session.model, proofs[:2]) if proofs else None,
        correlation=correlation_figure(best, whose) if best is not None and best.names else None,
        collinear=[(html(a), html(b), f"{rho:+.3f}") for a, b, rho in (best.collinear if best is not None else ())],
        untold=[(html(u.parameter), u) for u in untold(session)],
        runs=[(f.flight.name, m, r.converged, r.text, r.iterations) for f in session.flights for m, r in f.results.items()]
        + [(f.flight.name, m, False, why, 0) for f in session.flights for m, why in f.failures.items()]
        + [("joint", m, r.converged, r.text, r.iterations) for m, r in session.joint.items()],
        notes=list(dict.fromkeys((f.flight.name, n) for f in used for r in f.results.values() for n in r.flights[0].notes)),
        model=session.model,
    )  # fmt: skip


def _proofs(session: "Session") -> list[tuple[str, "Proof"]]:
    """Each flight predicted by the maximum-likelihood (or first) estimates of the flight before it, the first by the last."""
    from estimation.proof import predict

    usable = [(f, r) for f in session.flights for m, r in f.results.items() if m == session.methods[0] and r.converged]
    if len(usable) < 2:
        return []
    pairs = zip(usable, [usable[-1], *usable[:-1]], strict=True)
    return [(donor[0].flight.name, predict(donor[1].fitted_model, f.flight)) for (f, _), donor in list(pairs)[:SHOWN]]


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
        note="A flight that could not tell a derivative predicts with what was believed before flying, or with a poor "
        "number: its predictions of flights that use that control show it.",
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
