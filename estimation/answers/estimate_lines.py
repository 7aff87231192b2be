"""What a person reads of an estimate: a table for each flight and method, mean and scatter, joint."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from estimation.estimators.result import Bootstrap, Result
    from estimation.session.session import EstimationSession
    from estimation.session.verdict import Verdict


def session_lines(session: "EstimationSession", *, brief: bool = False) -> Iterator[str]:
    """The printed answer: a table for each flight and method, mean and scatter, joint."""
    from estimation.report.conventions import conventions_lines

    yield f"aircraft {session.aircraft.name}, model {session.model.name}"
    yield from () if brief else conventions_lines(session)
    for f in session.flights:
        for method, result in f.results.items():
            if brief:
                yield f"{f.flight.name} ({len(f.flight)} samples), {method}: {result.text}"
                yield f"  {brief_numbers(result)}"
                continue
            yield ""
            yield f"{f.flight.name} ({len(f.flight)} samples), {method}: {result.text}"
            yield from result_lines(result)
        for method, why in f.failures.items():
            yield f"{f.flight.name}, {method}: {why}"
        for note in () if brief else f.notes:
            yield f"  note: {note}"
        yield from _verdict_lines(f.verdict, brief=brief)
    if len(session.flights) > 1:
        yield from _mean_lines(session)
    for method, result in session.joint.items():
        yield ""
        yield f"joint over {len(session.flights)} flights, {method}: {result.text}"
        yield from result_lines(result)
    for method, why in session.joint_failures.items():
        yield f"joint over {len(session.flights)} flights, {method}: {why}"
    yield from _verdict_lines(session.verdict, brief=False)


def _verdict_lines(verdict: "Verdict | None", *, brief: bool) -> Iterator[str]:
    """Doubts, and which method to believe."""
    if verdict is None:
        return
    for doubt in () if brief else verdict.doubts:
        yield f"  doubt ({doubt.kind.value}): {doubt.text}"
    yield f"  recommended: {verdict.recommended.text}"


def brief_numbers(result: "Result") -> str:
    """Every estimate that the data could tell with its corrected bound, both to the second figure of the bound, in one line."""
    from estimation.report.tables import rounded

    told = [(n, rounded(e.estimate, e.std_coloured)) for n, e in result.parameters.items() if e.identifiable]
    return "  ".join(f"{n} {value}" + (f" ({bound})" if bound else "") for n, (value, bound) in told)


def result_lines(result: "Result") -> Iterator[str]:
    """Estimate, Cramer-Rao bound, corrected bound and prior belief, parameter by parameter; then the fit."""
    yield f"  {'parameter':<12}{'estimate':>11}{'bound':>10}{'corrected':>11}{'before':>10}"
    for name, e in result.parameters.items():
        before = "" if e.reference is None else f"{e.reference:10.4g} {e.reference_source}"
        why = "" if e.identifiable else f"  cannot tell: {e.why}"
        yield f"  {name:<12}{e.estimate:11.4g}{e.std:10.2g}{e.std_coloured:11.2g}{before}{why}"
    for flight in result.flights:
        line = "  ".join(f"{n} {f.r2:.3f}" for n, f in flight.fit.items())
        yield f"  fit r2{' ' + flight.name if len(result.flights) > 1 else ''}: {line}"
    for first, second, rho in result.collinear[:4]:
        yield f"  correlated: {first} and {second}, {rho:+.3f}"
    for name, p in result.profile.items():
        if p.values.size:
            (low, high), (wide_low, wide_high) = p.interval, p.interval_coloured
            yield f"  profile {name}: 95 % {low:.4g} .. {high:.4g}, corrected {wide_low:.4g} .. {wide_high:.4g}"
        if p.text:
            yield f"  profile {name}: {p.text}"
    if result.bootstrap is not None:
        yield from _bootstrap_lines(result.bootstrap)


def _bootstrap_lines(b: "Bootstrap") -> Iterator[str]:
    if b.text:
        yield f"  bootstrap: {b.text}"
        return
    yield f"  bootstrap, {len(b.estimates)} replicates" + (f", {b.failed} more could not be fitted" if b.failed else "")
    yield f"  {'parameter':<12}{'spread':>11}{'bias':>10}  95 % interval"
    for name, s in b.parameters.items():
        yield f"  {name:<12}{s.std:11.2g}{s.bias:10.1g}  {s.interval[0]:.4g} .. {s.interval[1]:.4g}"


def _mean_lines(session: "EstimationSession") -> Iterator[str]:
    for method, table in session.mean.items():
        yield ""
        yield f"mean over flights, {method}"
        told = f"{'truth':>11}" if session.truth else ""
        yield f"  {'parameter':<12}{'mean':>11}{'scatter':>10}{'bound':>11}{'flights':>9}{told}"
        for name, s in table.items():
            true = f"{session.truth[name]:11.4g}" if name in session.truth else " " * len(told)
            scatter = f"{s.std:.2g}" if s.count > 1 else "-"  # of one flight there is none
            yield f"  {name:<12}{s.mean:11.4g}{scatter:>10}{s.bound:11.2g}{s.count:9d}{true}  {s.text}".rstrip()
