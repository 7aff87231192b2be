"""Tables 3 to 5 of the paper for one's own flights, beside the published columns."""

from typing import TYPE_CHECKING

from estimation.report import published
from estimation.report.tables import CANNOT_TELL, ReportTable, number, rounded, significant
from estimation.signals.goodness_of_fit import THEIL_LIMIT

if TYPE_CHECKING:
    from estimation.estimators.result import Estimate
    from estimation.session.session import EstimationSession, FlightEstimates
    from estimation.session.verdict import Verdict

BOUNDS = (
    "bound: Cramér–Rao; corrected: for coloured residuals, the one to be believed. What the flight cannot tell "
    "is printed and said so; the reason is given below. Before flying: from the wind tunnel, or an engineering estimate (guess)."
)


def is_published(session: "EstimationSession") -> bool:
    """Whether the published columns are of this aircraft and model."""
    return published.is_of(session.aircraft.name) and "CY_beta" in session.model.free_names


def _believed(session: "EstimationSession") -> bool:
    """Whether anything is believed of the parameters before flying."""
    return any(p.reference is not None for p in session.model.parameters)


def _head(
    session: "EstimationSession", methods: list[str], columns: tuple[str, ...]
) -> tuple[list[tuple[str, int]], list[str]]:
    """Groups and head of a table of parameters by methods."""
    before, value = ([("before flying", 2)], ["value", "source"]) if _believed(session) else ([], [])
    groups = [("", 1), *before, *((m, len(columns)) for m in methods)]
    return groups, ["", *value, *(c for _ in methods for c in columns)]


def estimate_table(session: "EstimationSession", flight: "FlightEstimates") -> ReportTable:
    """Tables 3 and 4: one flight, all methods, wind tunnel and the published flight of the same number."""
    beside = published.counterpart(flight.flight.name) if is_published(session) else None
    methods = list(flight.results)
    rows = []
    for name in next(iter(flight.results.values())).parameters:
        row = [name, *_before(session, name)]
        for method in methods:
            row += _three(flight.results[method].parameters.get(name))
        for other in ("ml", "ngn") if beside else ():
            said = published.estimate(str(beside), other, name)
            row += ["", ""] if said is None else [number(said[0]), significant(said[1], 2)]
        rows.append(tuple(row))
    groups, head = _head(session, methods, ("estimate", "bound", "corrected"))
    if beside:
        groups += [(f"{beside}, {m} (published)", 2) for m in ("ml", "ngn")]
        head += ["estimate", "bound"] * 2
    note = _recommended(flight.verdict) + BOUNDS + (" " + published.COMPARISON if beside else "")
    caption = f"Estimates of {flight.flight.name}{_best(flight.verdict)}"
    return ReportTable(
        f"estimates_{_safe(flight.flight.name)}", caption, tuple(head), tuple(rows), tuple(groups), note=note
    )


def joint_table(session: "EstimationSession") -> ReportTable | None:
    """The joint estimate over all flights."""
    if not session.joint:
        return None
    methods = list(session.joint)
    rows = []
    for name in session.joint[methods[0]].parameters:
        row = [name, *_before(session, name)]
        for method in methods:
            row += _three(session.joint[method].parameters.get(name))
        if session.truth:
            row.append(number(session.truth[name]) if name in session.truth else "")
        rows.append(tuple(row))
    groups, head = _head(session, methods, ("estimate", "bound", "corrected"))
    if session.truth:
        groups.append(("simulated", 1))
        head.append("truth")
    return ReportTable(
        "estimates_joint",
        f"Joint estimate over {len(session.flights)} flights{_best(session.verdict)}",
        tuple(head),
        tuple(rows),
        tuple(groups),
        note=_recommended(session.verdict)
        + BOUNDS
        + " Constant coefficients are each flight's own: their line is the mean over flights.",
    )


def _best(verdict: "Verdict | None") -> str:
    """The recommended method, for a caption: heads are names of columns in CSV, which stay as they are."""
    return "" if verdict is None else f" (recommended: {verdict.recommended.method})"


def _recommended(verdict: "Verdict | None") -> str:
    """Whom to believe, as the first sentence of a note."""
    return "" if verdict is None else f"Recommended: {verdict.recommended.text}. "


def mean_table(session: "EstimationSession") -> ReportTable | None:
    """Table 5: mean and scatter over the flights that can tell, against their bounds."""
    if len(session.flights) < 2:
        return None
    methods, ours = list(session.mean), is_published(session)
    rows = []
    for name in session.model.free_names:
        if not any(name in session.mean[m] for m in methods):
            continue
        row = [name, *_before(session, name)]
        for method in methods:
            s = session.mean[method].get(name)
            row += [CANNOT_TELL, "", "", ""] if s is None else [*_to_bound(s.mean, s.std, s.bound), str(s.count)]
        for other in ("ml", "ngn") if ours else ():
            said = published.mean(other, name)
            row += ["", ""] if said is None else [number(said[0]), significant(said[1], 2)]
        if session.truth:
            row.append(number(session.truth[name]) if name in session.truth else "")
        rows.append(tuple(row))
    groups, head = _head(session, methods, ("mean", "scatter", "bound", "flights"))
    if ours:
        groups += [(f"{m} (published)", 2) for m in ("ml", "ngn")]
        head += ["mean", "scatter"] * 2
    if session.truth:
        groups.append(("simulated", 1))
        head.append("truth")
    return ReportTable(
        "table5_means",
        "Mean and scatter over the flights that can tell",
        tuple(head),
        tuple(rows),
        tuple(groups),
        note="scatter: sample standard deviation over flights; bound: root mean square of their corrected bounds. "
        + (published.COMPARISON if ours else ""),
    )


def fit_table(session: "EstimationSession") -> ReportTable:
    """r2 and Theil's coefficient per flight, method and output."""
    outputs = session.model.output_names
    rows: list[tuple[str, ...]] = []
    failed: set[tuple[int, int]] = set()
    for f in session.flights:
        for method, result in f.results.items():
            fits = [result.flights[0].fit.get(o) for o in outputs]
            failed |= {
                (len(rows), 3 + 3 * k) for k, fit in enumerate(fits) if fit is not None and fit.theil > THEIL_LIMIT
            }
            rows.append((f.flight.name, method, *(c for fit in fits for c in _fit_cells(fit))))
    return ReportTable(
        "fit",
        "Goodness of fit and residual whiteness",
        ("flight", "method", *(h for _ in outputs for h in ("r²", "Theil", "white"))),
        tuple(rows),
        (("", 2), *((o, 3) for o in outputs)),
        symbols=False,
        note=f"Theil's inequality coefficient: 0 perfect; in red above the limit of {THEIL_LIMIT:g}. white: share of "
        "residual autocorrelations inside the 95 % band of white noise.",
        failed=frozenset(failed),
    )


def _fit_cells(fit: object) -> list[str]:
    return (
        ["", "", ""]
        if fit is None
        else [number(getattr(fit, k), d) for k, d in (("r2", 3), ("theil", 3), ("whiteness", 2))]
    )


def _before(session: "EstimationSession", name: str) -> list[str]:
    if not _believed(session):
        return []
    parameter = session.model.parameter(name)
    if parameter.reference is None:
        return ["", ""]
    return [number(parameter.reference), parameter.reference_source.replace("engineering estimate", "guess")]


def _three(e: "Estimate | None") -> list[str]:
    if e is None:
        return ["", "", ""]
    said = _to_bound(e.estimate, e.std, e.std_coloured)
    return said if e.identifiable else [*said[:2], CANNOT_TELL]


def _to_bound(value: float, other: float, bound: float) -> list[str]:
    """Value, another spread and the bound to be believed: the value to the second figure of that bound."""
    text, said = rounded(value, bound)
    return [text, rounded(other, other)[1], said]


def _safe(name: str) -> str:
    return "".join(c if c.isalnum() or c in "-_" else "_" for c in name)
