"""Tables 3 to 5 of the paper for any flights, beside the published columns."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

from estimation.report import published
from estimation.report.tables import CANNOT_TELL, ReportTable, number, rounded, significant
from estimation.signals.goodness_of_fit import THEIL_LIMIT

if TYPE_CHECKING:
    from estimation.estimators.result import Result
    from estimation.session.session import EstimationSession, FlightEstimates
    from estimation.session.verdict import Verdict

BOUNDS = (
    "bound: Cramér–Rao; corrected: for coloured residuals, the one to use. Values that the flight does not determine "
    "are marked; the reason is given below. Before flying: from the wind tunnel, or an engineering estimate (guess)."
)


def is_published(session: "EstimationSession") -> bool:
    """Whether the published columns are of this aircraft and model."""
    return published.is_of(session.aircraft.name) and "CY_beta" in session.model.free_names


ColumnGroup = tuple[str, tuple[str, ...], Callable[[str], list[str]]]
"""Label of adjacent columns, their heads, and a function: name of a parameter -> their cells."""


def grouped_table(
    name: str, caption: str, parameters: Iterable[str], groups: Sequence[ColumnGroup], note: str
) -> ReportTable:
    """A row for each parameter, with the columns of each group."""
    rows = tuple((n, *(cell for _, _, cells in groups for cell in cells(n))) for n in parameters)
    head = ("", *(word for _, heads, _ in groups for word in heads))
    spans = (("", 1), *((label, len(heads)) for label, heads, _ in groups))
    return ReportTable(name, caption, head, rows, spans, note=note)


def _beliefs(session: "EstimationSession") -> list[ColumnGroup]:
    """The beliefs before flying, where there are any."""
    if all(p.reference is None for p in session.model.parameters):
        return []
    return [("before flying", ("value", "source"), partial(_belief_cells, session))]


def _estimates(results: "Mapping[str, Result]") -> list[ColumnGroup]:
    """Estimates of each method with both bounds."""
    heads = ("estimate", "bound", "corrected")
    return [(method, heads, partial(_estimate_cells, result)) for method, result in results.items()]


def published_cells(numbers: Callable[[str], tuple[float, float] | None]) -> Callable[[str], list[str]]:
    """A function: name -> cells of a published number and its bound or scatter. numbers: name -> these two."""

    def cells(name: str) -> list[str]:
        pair = numbers(name)
        return ["", ""] if pair is None else [number(pair[0]), significant(pair[1], 2)]

    return cells


def _truth(session: "EstimationSession") -> list[ColumnGroup]:
    """The true values of simulated flights, where they are known."""
    return [("simulated", ("truth",), lambda name: [number(session.truth.get(name))])] if session.truth else []


def estimate_table(session: "EstimationSession", flight: "FlightEstimates") -> ReportTable:
    """Tables 3 and 4: one flight, all methods, wind tunnel and the published flight of the same number."""
    twin = published.counterpart(flight.flight.name) if is_published(session) else None
    groups = [*_beliefs(session), *_estimates(flight.results)]
    for method in ("ml", "ngn") if twin else ():
        cells = published_cells(partial(published.estimate, str(twin), method))
        groups.append((f"{twin}, {method} (published)", ("estimate", "bound"), cells))
    name = "".join(c if c.isalnum() or c in "-_" else "_" for c in flight.flight.name)
    caption = f"Estimates of {flight.flight.name}{_recommended_method(flight.verdict)}"
    note = _recommended(flight.verdict) + BOUNDS + (" " + published.COMPARISON if twin else "")
    parameters = next(iter(flight.results.values())).parameters
    return grouped_table(f"estimates_{name}", caption, parameters, groups, note)


def joint_table(session: "EstimationSession") -> ReportTable | None:
    """The joint estimates of all methods; None without any."""
    if not session.joint:
        return None
    caption = f"Joint estimate over {len(session.flights)} flights{_recommended_method(session.verdict)}"
    constants = " Constant coefficients are each flight's own: their line is the mean over flights."
    note = _recommended(session.verdict) + BOUNDS + constants
    groups = [*_beliefs(session), *_estimates(session.joint), *_truth(session)]
    return grouped_table("estimates_joint", caption, next(iter(session.joint.values())).parameters, groups, note)


def _recommended_method(verdict: "Verdict | None") -> str:
    """The recommended method, for a caption: heads are the column names of CSV files and must not change."""
    return "" if verdict is None else f" (recommended: {verdict.recommended.method})"


def _recommended(verdict: "Verdict | None") -> str:
    """The recommendation, as the first sentence of a note."""
    return "" if verdict is None else f"Recommended: {verdict.recommended.text}. "


def mean_table(session: "EstimationSession") -> ReportTable | None:
    """Table 5: mean and scatter over the flights in which a parameter is identifiable, and their bounds."""
    if len(session.flights) < 2:
        return None

    def cells(method: str, name: str) -> list[str]:
        s = session.mean[method].get(name)
        return [CANNOT_TELL, "", "", ""] if s is None else [*_bound_cells(s.mean, s.std, s.bound), str(s.count)]

    groups = _beliefs(session)
    for method in session.mean:
        groups.append((method, ("mean", "scatter", "corrected", "flights"), partial(cells, method)))
    for method in ("ml", "ngn") if is_published(session) else ():
        groups.append((f"{method} (published)", ("mean", "scatter"), published_cells(partial(published.mean, method))))
    parameters = [n for n in session.model.free_names if any(n in means for means in session.mean.values())]
    note = "scatter: sample standard deviation over flights; corrected: root mean square of their corrected bounds. "
    return grouped_table(
        "table5_means",
        "Mean and scatter over the flights that can tell",
        parameters,
        [*groups, *_truth(session)],
        note + (published.COMPARISON if is_published(session) else ""),
    )


def match_table(
    name: str,
    caption: str,
    head: tuple[str, ...],
    outputs: Sequence[str],
    proofs: Iterable[tuple[tuple[str, ...], Sequence[tuple[float | None, float | None, float]]]],
    limit: float,
    more: str = "",
) -> ReportTable:
    """Proofs of match. head: of the first columns; proofs: (first cells, (r2, Theil, its limit) of each output, None where there
    is none); limit: of Theil's coefficient beyond noise; more: end of the note."""
    rows: list[tuple[str, ...]] = []
    failed: set[tuple[int, int]] = set()
    for first, fits in proofs:
        failed_outputs = [k for k, (_, theil, highest) in enumerate(fits) if theil is not None and not theil <= highest]
        columns = [
            *(len(head) + 1 + 2 * k for k in failed_outputs),
            *([len(head) + 2 * len(outputs)] if failed_outputs else []),
        ]
        failed |= {(len(rows), column) for column in columns}
        cells = [number(value, 3) for fit in fits for value in fit[:2]]
        rows.append((*first, *cells, "FAIL" if failed_outputs else "pass"))
    return ReportTable(
        name,
        caption,
        (*head, *(h for _ in outputs for h in ("r²", "Theil")), "match"),
        tuple(rows),
        (("", len(head)), *((o, 2) for o in outputs), ("", 1)),
        symbols=False,
        failed=frozenset(failed),
        note=f"Limit: Theil's coefficient at most {limit:g} in every channel beyond what its noise alone leaves; in red "
        f"what is above it.{more}",
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
                (len(rows), 3 + 3 * k)
                for k, fit in enumerate(fits)
                if fit is not None and fit.theil > fit.limit(THEIL_LIMIT)
            }
            rows.append((f.flight.name, method, *(c for fit in fits for c in _fit_cells(fit))))
    return ReportTable(
        "fit",
        "Goodness of fit and residual whiteness",
        ("flight", "method", *(h for _ in outputs for h in ("r²", "Theil", "white"))),
        tuple(rows),
        (("", 2), *((o, 3) for o in outputs)),
        symbols=False,
        note=f"Theil's inequality coefficient: 0 perfect; in red above {THEIL_LIMIT:g} beyond noise. white: share of "
        "residual autocorrelations inside the 95 % band of white noise.",
        failed=frozenset(failed),
    )


def _fit_cells(fit: object) -> list[str]:
    return (
        ["", "", ""]
        if fit is None
        else [number(getattr(fit, k), d) for k, d in (("r2", 3), ("theil", 3), ("whiteness", 2))]
    )


def _belief_cells(session: "EstimationSession", name: str) -> list[str]:
    parameter = session.model.parameter(name)
    if parameter.reference is None:
        return ["", ""]
    return [number(parameter.reference), parameter.reference_source.replace("engineering estimate", "guess")]


def _estimate_cells(result: "Result", name: str) -> list[str]:
    e = result.parameters.get(name)
    if e is None:
        return ["", "", ""]
    cells = _bound_cells(e.estimate, e.std, e.std_coloured)
    return cells if e.identifiable else [*cells[:2], CANNOT_TELL]


def _bound_cells(value: float, other: float, bound: float) -> list[str]:
    """Value, another spread and the corrected bound; the value rounded to the second figure of that bound."""
    text, bound_text = rounded(value, bound)
    return [text, rounded(other, other)[1], bound_text]
