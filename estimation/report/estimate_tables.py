"""Tables 3 to 5 of the paper for one's own flights, beside the published columns."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

from estimation.report import published
from estimation.report.tables import CANNOT_TELL, ReportTable, number, rounded, significant
from estimation.signals.goodness_of_fit import THEIL_LIMIT

if TYPE_CHECKING:
    from estimation.estimators.result import Estimate, Result
    from estimation.session.session import EstimationSession, FlightEstimates
    from estimation.session.verdict import Verdict

BOUNDS = (
    "bound: Cramér–Rao; corrected: for coloured residuals, the one to be believed. What the flight cannot tell "
    "is printed and said so; the reason is given below. Before flying: from the wind tunnel, or an engineering estimate (guess)."
)


def is_published(session: "EstimationSession") -> bool:
    """Whether the published columns are of this aircraft and model."""
    return published.is_of(session.aircraft.name) and "CY_beta" in session.model.free_names


def _has_beliefs(session: "EstimationSession") -> bool:
    """Whether anything is believed of the parameters before flying."""
    return any(p.reference is not None for p in session.model.parameters)


Cells = Callable[[str], list[str]]
"""Name of a parameter -> cells."""


def _parameter_table(
    session: "EstimationSession",
    name: str,
    caption: str,
    parameters: Iterable[str],
    methods: Mapping[str, Cells],
    columns: tuple[str, ...],
    beside: Sequence[tuple[str, tuple[str, ...], Cells]],
    note: str,
) -> ReportTable:
    """Parameters by methods, with what was believed before. methods: what fills the `columns` of each; beside: groups of columns
    after those, as (label, heads, what fills them)."""
    has_beliefs = _has_beliefs(session)
    groups = [*methods.items(), *((label, cells) for label, _, cells in beside)]
    rows = tuple(
        (n, *(_belief_cells(session, n) if has_beliefs else ()), *(cell for _, cells in groups for cell in cells(n)))
        for n in parameters
    )
    heads = [*(columns for _ in methods), *(head for _, head, _ in beside)]
    spans = [(label, len(head)) for (label, _), head in zip(groups, heads, strict=True)]
    return ReportTable(
        name,
        caption,
        ("", *(("value", "source") if has_beliefs else ()), *(h for head in heads for h in head)),
        rows,
        (("", 1), *([("before flying", 2)] if has_beliefs else []), *spans),
        note=note,
    )


def _fitted(result: "Result") -> Cells:
    return lambda name: _estimate_cells(result.parameters.get(name))


def _published(numbers: Callable[[str], tuple[float, float] | None]) -> Cells:
    """A published number and its bound or scatter."""

    def cells(name: str) -> list[str]:
        pair = numbers(name)
        return ["", ""] if pair is None else [number(pair[0]), significant(pair[1], 2)]

    return cells


def _truth(session: "EstimationSession") -> list[tuple[str, tuple[str, ...], Cells]]:
    """What simulated flights were flown with, where that is known."""
    return [("simulated", ("truth",), lambda name: [number(session.truth.get(name))])] if session.truth else []


def estimate_table(session: "EstimationSession", flight: "FlightEstimates") -> ReportTable:
    """Tables 3 and 4: one flight, all methods, wind tunnel and the published flight of the same number."""
    twin = published.counterpart(flight.flight.name) if is_published(session) else None
    published_groups = [] if twin is None else [
        (f"{twin}, {m} (published)", ("estimate", "bound"), _published(partial(published.estimate, twin, m)))
        for m in ("ml", "ngn")
    ]  # fmt: skip
    return _parameter_table(
        session,
        f"estimates_{_file_part(flight.flight.name)}",
        f"Estimates of {flight.flight.name}{_recommended_method(flight.verdict)}",
        next(iter(flight.results.values())).parameters,
        {method: _fitted(result) for method, result in flight.results.items()},
        ("estimate", "bound", "corrected"),
        published_groups,
        _recommended(flight.verdict) + BOUNDS + (" " + published.COMPARISON if twin else ""),
    )


def joint_table(session: "EstimationSession") -> ReportTable | None:
    if not session.joint:
        return None
    return _parameter_table(
        session,
        "estimates_joint",
        f"Joint estimate over {len(session.flights)} flights{_recommended_method(session.verdict)}",
        next(iter(session.joint.values())).parameters,
        {method: _fitted(result) for method, result in session.joint.items()},
        ("estimate", "bound", "corrected"),
        _truth(session),
        f"{_recommended(session.verdict)}{BOUNDS} Constant coefficients are each flight's own: their line is the mean over"
        " flights.",
    )


def _recommended_method(verdict: "Verdict | None") -> str:
    """The recommended method, for a caption: heads are names of columns in CSV, which stay as they are."""
    return "" if verdict is None else f" (recommended: {verdict.recommended.method})"


def _recommended(verdict: "Verdict | None") -> str:
    """Whom to believe, as the first sentence of a note."""
    return "" if verdict is None else f"Recommended: {verdict.recommended.text}. "


def mean_table(session: "EstimationSession") -> ReportTable | None:
    """Table 5: mean and scatter over the flights that can tell, against their bounds."""
    if len(session.flights) < 2:
        return None

    def cells(method: str, name: str) -> list[str]:
        s = session.mean[method].get(name)
        return [CANNOT_TELL, "", "", ""] if s is None else [*_bound_cells(s.mean, s.std, s.bound), str(s.count)]

    paper = [
        (f"{m} (published)", ("mean", "scatter"), _published(partial(published.mean, m)))
        for m in (("ml", "ngn") if is_published(session) else ())
    ]
    return _parameter_table(
        session,
        "table5_means",
        "Mean and scatter over the flights that can tell",
        [n for n in session.model.free_names if any(n in means for means in session.mean.values())],
        {method: partial(cells, method) for method in session.mean},
        ("mean", "scatter", "bound", "flights"),
        [*paper, *_truth(session)],
        "scatter: sample standard deviation over flights; bound: root mean square of their corrected bounds. "
        + (published.COMPARISON if paper else ""),
    )


def match_table(
    name: str,
    caption: str,
    head: tuple[str, ...],
    outputs: Sequence[str],
    proofs: Iterable[tuple[tuple[str, ...], Sequence[tuple[float | None, float | None]]]],
    limit: float,
    more: str = "",
) -> ReportTable:
    """Proofs of match. head: of the first columns; proofs: (first cells, (r2, Theil) of each output, None where there is none);
    limit: of Theil's coefficient; more: of the note."""
    rows: list[tuple[str, ...]] = []
    failed: set[tuple[int, int]] = set()
    for first, fits in proofs:
        failed_outputs = [k for k, (_, theil) in enumerate(fits) if theil is not None and not theil <= limit]
        columns = [
            *(len(head) + 1 + 2 * k for k in failed_outputs),
            *([len(head) + 2 * len(outputs)] if failed_outputs else []),
        ]
        failed |= {(len(rows), column) for column in columns}
        cells = [number(value, 3) for fit in fits for value in fit]
        rows.append((*first, *cells, "FAIL" if failed_outputs else "pass"))
    return ReportTable(
        name,
        caption,
        (*head, *(h for _ in outputs for h in ("r²", "Theil")), "match"),
        tuple(rows),
        (("", len(head)), *((o, 2) for o in outputs), ("", 1)),
        symbols=False,
        failed=frozenset(failed),
        note=f"Limit: Theil's coefficient at most {limit:g} in every channel; in red what is above it.{more}",
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


def _belief_cells(session: "EstimationSession", name: str) -> list[str]:
    parameter = session.model.parameter(name)
    if parameter.reference is None:
        return ["", ""]
    return [number(parameter.reference), parameter.reference_source.replace("engineering estimate", "guess")]


def _estimate_cells(e: "Estimate | None") -> list[str]:
    if e is None:
        return ["", "", ""]
    cells = _bound_cells(e.estimate, e.std, e.std_coloured)
    return cells if e.identifiable else [*cells[:2], CANNOT_TELL]


def _bound_cells(value: float, other: float, bound: float) -> list[str]:
    """Value, another spread and the bound to be believed: the value to the second figure of that bound."""
    text, bound_text = rounded(value, bound)
    return [text, rounded(other, other)[1], bound_text]


def _file_part(name: str) -> str:
    return "".join(c if c.isalnum() or c in "-_" else "_" for c in name)
