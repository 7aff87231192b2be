"""The answer of `estimate` on one screen: a sentence, the derivatives with their bounds, and what to do next.

Page, console and `plot()` show these same rows, in this order, before any detail.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from daq.utilities.constants import NORMAL_95
from estimation.models.base import ParameterRole
from estimation.report import published
from estimation.report.advice import grouped, unidentified_parameters
from estimation.report.estimate_tables import is_published
from estimation.report.tables import CANNOT_TELL, ReportTable, number, rounded

if TYPE_CHECKING:
    from estimation.estimators.result import Result
    from estimation.session.session import EstimationSession
    from estimation.session.verdict import Verdict

WIDTH = 78  # columns of the printed answer: a terminal of 80
FLY_NEXT = 3  # manoeuvres named on the first screen: the table below has them all
SMALLEST_SHARE = 0.01  # printed as a whole percentage; a smaller one with one figure
SIMPLIFIED = "lateral-simple"
FULL_KINEMATICS = (
    "Take the whole kinematics first: estimate --model lateral; lateral-simple leaves out p sin(alpha) and pitch."
)


@dataclass(frozen=True, slots=True)
class AnswerRow:
    """One derivative. bound: corrected standard deviation; why: it is not identifiable; prior, published, truth: or None."""

    name: str
    value: float
    bound: float
    identifiable: bool
    why: str = ""
    prior: float | None = None
    published: float | None = None
    truth: float | None = None


@dataclass(frozen=True, slots=True)
class LeadingAnswer:
    """The answer of a session. source: flights and method of the numbers; verdict: a sentence; rows: derivatives in order."""

    source: str
    verdict: str
    rows: tuple[AnswerRow, ...]

    @property
    def undetermined(self) -> list[str]:
        """Derivatives that are not identifiable."""
        return [row.name for row in self.rows if not row.identifiable]


def shown_verdict(session: "EstimationSession") -> "Verdict | None":
    """The verdict on all flights together where there is one, else on the first flight."""
    return session.verdict or next((f.verdict for f in session.flights if f.verdict is not None), None)


def leading_answer(session: "EstimationSession") -> LeadingAnswer:
    """The joint estimate, else the mean over flights, else the only flight's; by the recommended method, or the first."""
    verdict = shown_verdict(session)
    if session.leading is not None:
        source = f"{len(session.flights)} flights together, {session.leading.method}"
        rows = _result_rows(session, session.leading)
    else:
        rows, source = _flight_rows(session, "" if verdict is None else verdict.recommended.method)
    return LeadingAnswer(source, _sentence(session, verdict, rows), tuple(rows))


def _flight_rows(session: "EstimationSession", method: str) -> tuple[list[AnswerRow], str]:
    """Means over flights, or the estimates of the only flight that has any; and their source in words."""
    results = [f for f in session.flights if f.results]
    if not results:
        return [], "no estimate"
    if len(results) == 1:
        result = results[0].results.get(method) or next(iter(results[0].results.values()))
        return _result_rows(session, result), f"{results[0].flight.name}, {result.method}"
    method = method if method in session.mean else next(iter(session.mean))
    means = session.mean[method]
    rows = [
        _row(session, n, means[n].mean, means[n].bound, True, means[n].text)
        if n in means
        else _row(session, n, float("nan"), float("nan"), False, "no flight can tell it")
        for n in _derivatives(session)
    ]
    return rows, f"mean of {len(results)} flights, {method}"


def _derivatives(session: "EstimationSession") -> list[str]:
    """Free parameters without constants, which absorb trims and offsets of a day; constants where there is nothing else."""
    names = list(session.model.free_names)
    constants = session.model.free_of(ParameterRole.CONSTANT)
    return [n for n in names if n not in constants] or names


def _result_rows(session: "EstimationSession", result: "Result") -> list[AnswerRow]:
    estimates = ((n, result.parameters.get(n)) for n in _derivatives(session))
    return [_row(session, n, e.estimate, e.std_coloured, e.identifiable, e.why) for n, e in estimates if e is not None]


def _row(
    session: "EstimationSession", name: str, value: float, bound: float, identifiable: bool, why: str
) -> AnswerRow:
    mean = published.mean("ml", name) if is_published(session) else None
    prior, truth = session.model.parameter(name).reference, session.truth.get(name)
    return AnswerRow(name, value, bound, identifiable, why, prior, None if mean is None else mean[0], truth)


def _sentence(session: "EstimationSession", verdict: "Verdict | None", rows: list[AnswerRow]) -> str:
    """Which method to use, and how many derivatives the data determine, in a sentence or two."""
    if not rows:
        return session.text
    blind = [row.name for row in rows if not row.identifiable]
    counts = f"the data determine {len(rows) - len(blind) if blind else 'all'} of {len(rows)} derivatives"
    counts += f", not {', '.join(blind)}" if blind else ""
    if verdict is None:
        return f"{counts}; {session.text}"
    choice = verdict.recommended
    lead = "Do not use these numbers yet" if choice.method == "none" else f"Use {choice.method}"
    return f"{lead}: {choice.why}. {counts[:1].upper()}{counts[1:]}"


def answer_table(session: "EstimationSession", answer: LeadingAnswer) -> ReportTable:
    """The derivatives with bounds; beliefs, published and true values beside them, where there are any."""
    columns = [
        (head, [getattr(row, key) for row in answer.rows])
        for head, key in (("before", "prior"), ("published", "published"), ("truth", "truth"))
    ]
    columns = [(head, values) for head, values in columns if any(v is not None for v in values)]
    rows = tuple(
        (row.name, *_cells(row), *(number(values[i]) for _, values in columns)) for i, row in enumerate(answer.rows)
    )
    return ReportTable(
        "answer",
        f"{answer.source}; corrected: one standard deviation, corrected for coloured residuals",
        ("", "estimate", "± corrected", "relative", *(head for head, _ in columns)),
        rows,
        note=next((f"Published: {published.SOURCE}." for head, _ in columns if head == "published"), ""),
    )


def _cells(row: AnswerRow) -> tuple[str, str, str]:
    """Estimate, bound, and the bound as a share of the estimate."""
    if not row.identifiable:
        return ("", CANNOT_TELL, "")
    value, bound = rounded(row.value, row.bound)
    share = abs(row.bound / row.value) if row.value else 0.0
    if not share:
        return value, bound, ""
    return value, bound, f"{share:.0%}" if share >= SMALLEST_SHARE else f"{100.0 * share:.1g}%"


def next_steps(session: "EstimationSession", answer: LeadingAnswer) -> list[str]:
    """What to do next: manoeuvres that would determine the missing derivatives, a better model, a test on other flights."""
    steps = [
        f"Fly {group.manoeuvre}: it would tell {', '.join(n for n in group.parameters if n in answer.undetermined)}."
        for group in grouped(unidentified_parameters(session))
        if any(n in answer.undetermined for n in group.parameters)
    ][:FLY_NEXT]
    verdict = shown_verdict(session)
    refused = verdict is not None and verdict.recommended.method == "none"
    if refused and session.model.name == SIMPLIFIED:
        steps.append(FULL_KINEMATICS)
    elif verdict is not None and verdict.recommended.lacks:
        steps.append(
            f"Let the model have what it lacks ({', '.join(verdict.recommended.lacks[:FLY_NEXT])}): estimate --structure auto."
        )
    if len(session.flights) > 1 and not session.joint:
        steps.append("Fit one set of derivatives to all flights: estimate --joint.")
    steps.append("Predict a flight that was not used: estimate --save-model model.toml, then match model.toml FLIGHT.")
    return [*steps, "Look for what the model leaves out: gap FLIGHT... --holdout FLIGHT."]


def answer_lines(session: "EstimationSession") -> Iterator[str]:
    """The first screen of the console: verdict, table, what to do next."""
    answer = leading_answer(session)
    yield f"{session.model.name} of {session.aircraft.name}: {answer.source}".center(WIDTH).rstrip()
    yield "=" * WIDTH
    yield answer.verdict
    yield "-" * WIDTH
    beside = [key for key in ("prior", "published", "truth") if any(getattr(r, key) is not None for r in answer.rows)]
    heads = "".join(f"{'before' if key == 'prior' else key:>11}" for key in beside)
    yield f"{'':<12}{'estimate':>11}{'corrected':>11}{'[95 %':>11}{'interval]':>11}{heads}".rstrip()
    for row in answer.rows:
        others = "".join(f"{number(getattr(row, key)):>11}" for key in beside)
        if not row.identifiable:
            yield f"{row.name:<12}{CANNOT_TELL:>22}{'':22}{others}".rstrip()
            continue
        value, bound = rounded(row.value, row.bound)
        low, high = (rounded(row.value + side * NORMAL_95 * row.bound, row.bound)[0] for side in (-1, 1))
        yield f"{row.name:<12}{value:>11}{bound:>11}{low:>11}{high:>11}{others}".rstrip()
    yield "-" * WIDTH
    yield from (f"next: {step}" for step in next_steps(session, answer))
    yield "=" * WIDTH
