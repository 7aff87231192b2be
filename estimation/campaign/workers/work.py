"""The work itself: read a flight, check it, estimate, and return rows of the result table.

The same function runs in this process (`--serial`) and on a cluster. A fault of a flight becomes rows with a reason, never the
end of the campaign.
"""

import json
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from daq.utilities.errors import UserError
from estimation.aircraft import Aircraft
from estimation.campaign.keys import versions
from estimation.campaign.tasks import Row, Work
from estimation.campaign.workers.subjects import CHECK, aircraft_of_subject, measured, model_of, read_subject
from estimation.estimators.estimator import Extra, Extras
from estimation.estimators.registry import find_estimator
from estimation.estimators.result import Result, finite_or_none
from estimation.models.base import ParameterRole
from estimation.threads import one_thread
from groundstation.flight import Flight

BOUNDS, FIT = ("estimate", "std", "std_coloured"), ("r2", "theil", "rms", "whiteness")
FAILED, DOUBTFUL, OPEN, OK = "failed", "doubtful", "not converged", "ok"


class OtherSoftwareError(UserError):
    """A worker whose libraries are not those of the client: its numbers would differ from those of other workers."""


def do_work(work: Work) -> list[Row]:
    """All rows of a piece of work. Raises OtherSoftwareError for other versions than the client's, and nothing else."""
    _refuse_other_software(work.versions)
    try:
        with one_thread():
            return list(_KINDS[work.kind](work))
    except UserError as error:
        return failed_rows(work, str(error))
    except Exception as error:  # noqa: BLE001  one flight must not end the campaign
        return failed_rows(
            work, f"{work.name}: {type(error).__name__}: {error}; a mistake of the program or of own code"
        )


def failed_rows(work: Work, why: str) -> list[Row]:
    """A row for each piece with the reason why it has no result."""
    return [_row(work, piece, FAILED, why) for piece in work.pieces]


def _refuse_other_software(client_versions: Mapping[str, str]) -> None:
    for name, version in client_versions.items():
        if versions()[name] != version:
            raise OtherSoftwareError(
                f"a worker has {name} {versions()[name]}, this machine {version}: install the same on both"
            )


def _row(work: Work, piece: str, status: str, why: str, **more: Any) -> Row:
    """A row of results; by default of kind "run". more: columns that replace or extend those of every row."""
    software_versions = versions()
    columns: Row = {
        "kind": "run",
        "method": piece,
        "key": work.pieces[piece],
        "status": status,
        "why": why,
        "software": json.dumps({k: v for k, v in software_versions.items() if k != "code"}),
        "code": software_versions["code"],
    }
    if work.kind in ("joint", "envelope"):
        envelope_columns = {"model_text": "", "flights": len(work.subjects)} if work.kind == "envelope" else {}
        return {**columns, **envelope_columns, "group": work.group, **more}
    source = work.subjects[0].source
    return {**columns, "flight": source.name, "source": source.location, "sha256": source.sha256, **more}


# ------------------------------------------------------------------------------------------------ one flight


def _flight(work: Work) -> Iterator[Row]:
    subject = work.subjects[0]
    flight = read_subject(subject)
    aircraft = aircraft_of_subject(subject, flight, work)
    parts = _parts(flight, work)
    for number, part in enumerate(parts, start=1):
        conditions: Row = {**measured(part), "aircraft": aircraft.name}
        if len(parts) > 1:
            conditions["manoeuvre"] = str(number)
        quality_problem = _bad_quality(part) if work.quality else ""
        for piece in work.pieces:
            if quality_problem:
                yield _row(work, piece, FAILED, quality_problem, **conditions)
            elif piece == CHECK:
                yield from _checked(work, part, conditions)
            else:
                yield from _estimated(work, piece, part, aircraft, conditions)


def _parts(flight: Flight, work: Work) -> list[Flight]:
    from estimation.prepare.stretches import flights_of_segments

    return flights_of_segments(flight) if work.each_segment else [flight]


def _bad_quality(flight: Flight) -> str:
    """The failed checks of the data quality; empty where none failed."""
    from groundstation.flight.quality.report import quality_report

    words = [f"{f.kind}: {f.text}" for f in quality_report(flight) if f.severity == "fail"]
    return f"{flight.name}: {'; '.join(words)}" if words else ""


def _checked(work: Work, flight: Flight, conditions: Row) -> Iterator[Row]:
    """Instrument factors by flight-path reconstruction."""
    from estimation.compatibility.reconstruction import compatibility

    start_s = time.thread_time()
    try:
        check_result = compatibility(flight)
    except UserError as error:
        yield _row(work, CHECK, FAILED, str(error), **conditions)
        return
    status = OK if check_result.converged else OPEN
    why = "" if check_result.converged else check_result.text
    cpu = time.thread_time() - start_s
    yield _row(work, CHECK, status, why, iterations=check_result.iterations, cpu=cpu, **conditions)
    for place, (name, factor) in enumerate(check_result.factors.items()):
        columns = {**conditions, **_finite(factor, BOUNDS), "kind": "check", "parameter": name, "place": place}
        yield _row(work, CHECK, status, factor.why, identifiable=factor.identifiable, **columns)


def _estimated(work: Work, method: str, flight: Flight, aircraft: Aircraft, conditions: Row) -> Iterator[Row]:
    from estimation.prepare.measured_cg import with_cg_history
    from estimation.prepare.measured_mass import with_mass_history
    from estimation.session import runner
    from estimation.session.sanity_checks import DoubtKind
    from estimation.session.structured import StructureWish

    start_s = time.thread_time()
    try:
        model, flown, _ = with_mass_history(model_of(work.subjects[0], aircraft), [flight], aircraft)
        model, flown, _ = with_cg_history(model, flown)
        conditions = {**conditions, "model": model.name}
        session = runner.estimate(
            model, flown, aircraft, [method], extras=_extras(work, method), structure=StructureWish.OFF
        )
    except UserError as error:
        yield _row(work, method, FAILED, str(error), **conditions)
        return
    name = find_estimator(method).name
    if name in session.flights[0].failures:
        yield _row(work, method, FAILED, session.flights[0].failures[name], **conditions)
        return
    result, doubts = session.flights[0].results[name], session.flights[0].doubts
    grave = [d.text for d in doubts if d.kind is not DoubtKind.UNEXPLAINED]
    status = OPEN if not result.converged else DOUBTFUL if grave else OK
    reason = result.text if not result.converged else "; ".join(grave or [d.text for d in doubts])
    yield from _result_rows(work, method, result, status, reason, "estimate", time.thread_time() - start_s, conditions)


def _extras(work: Work, method: str) -> Extras:
    supported = find_estimator(method).supports
    return Extras(
        bootstrap=work.bootstrap if Extra.BOOTSTRAP in supported else 0,
        seed=work.seeds[method] if Extra.SEED in supported else 0,
    )


def _result_rows(
    work: Work, method: str, result: Result, status: str, why: str, kind: str, cpu: float, conditions: Row
) -> Iterator[Row]:
    """The run, its parameters, and the fit of each channel."""
    cost = finite_or_none(result.cost)
    yield _row(work, method, status, why, iterations=result.iterations, cost=cost, cpu=cpu, **conditions)
    for name, e in result.parameters.items():
        columns = {**conditions, "kind": kind, "parameter": name, **_finite(e, BOUNDS)}
        more = {**_spread(result, name), **_covariance(result, name)}
        yield _row(
            work, method, status, e.why or why, identifiable=e.identifiable, reference=e.reference, **columns, **more
        )
    if len(result.flights) > 1:
        return
    for output, fit in result.flights[0].fit.items():
        yield _row(work, method, status, why, **conditions, kind="fit", parameter=output, **_finite(fit, FIT))


def _finite(source: object, names: Sequence[str]) -> Row:
    """The attributes `names` of an estimate or a fit; None where one is not finite."""
    return {name: finite_or_none(getattr(source, name)) for name in names}


def _spread(result: Result, name: str) -> Row:
    if result.bootstrap is None or name not in result.bootstrap.parameters:
        return {}
    s = result.bootstrap.parameters[name]
    return {"bootstrap_std": s.std, "bootstrap_low": s.interval[0], "bootstrap_high": s.interval[1]}


def _covariance(result: Result, name: str) -> Row:
    if name not in result.names:
        return {}
    place = result.names.index(name)
    return {"place": place, "covariance": [finite_or_none(v) for v in result.covariance_coloured[place].tolist()]}


# ------------------------------------------------------------------------------------------ several flights


def _joint(work: Work) -> Iterator[Row]:
    from estimation.models.base import joint_model
    from estimation.prepare.stretches import unique_names
    from estimation.session.runner import run_method

    flights = unique_names([part for s in work.subjects for part in _parts(read_subject(s), work)])
    aircraft = aircraft_of_subject(work.subjects[0], flights[0], work)
    model = joint_model(model_of(work.subjects[0], aircraft))
    for method in work.pieces:
        start_s = time.thread_time()
        columns: Row = {"aircraft": aircraft.name, "model": model.name}
        try:
            result = run_method(method, model, flights, aircraft, extras=_extras(work, method))
        except UserError as error:
            yield _row(work, method, FAILED, str(error), **columns)
            continue
        status = OK if result.converged else OPEN
        reason = "" if result.converged else result.text
        yield from _result_rows(work, method, result, status, reason, "joint", time.thread_time() - start_s, columns)


def _envelope(work: Work) -> Iterator[Row]:
    """One model over the envelope of all flights, with the gain of each of its terms."""
    from estimation.campaign.aerodynamics.joint import global_model
    from estimation.models.load import model_text

    flights = [part for s in work.subjects for part in _parts(read_subject(s), work)]
    aircraft = aircraft_of_subject(work.subjects[0], flights[0], work)
    start_s = time.thread_time()
    (method,) = work.pieces
    global_fit = global_model(model_of(work.subjects[0], aircraft), flights)
    status = OK if global_fit.result.converged else OPEN
    columns: Row = {"aircraft": aircraft.name, "model": global_fit.model.name}
    cpu = time.thread_time() - start_s
    rows = list(_result_rows(work, method, global_fit.result, status, global_fit.text, "envelope", cpu, columns))
    yield {**rows[0], "model_text": model_text(global_fit.model) if global_fit.result.converged else ""}
    yield from rows[1:]
    for place, gain in enumerate(global_fit.gains):
        numbers = {"estimate": gain.gain, "std": gain.std, "place": place}
        yield _row(work, method, status, "", **columns, kind="term", parameter=gain.name, **numbers)


def _match(work: Work) -> Iterator[Row]:
    """The flight predicted with the estimates of the others of its group; trim and initial states are fitted to it."""
    from estimation.session.proof_of_match import predict_flight

    flight = read_subject(work.subjects[0])
    aircraft = aircraft_of_subject(work.subjects[0], flight, work)
    base_model = model_of(work.subjects[0], aircraft)
    for piece, values in work.values.items():
        model = base_model.with_starts(values)
        proof = predict_flight(model, flight, free=model.free_of(ParameterRole.CONSTANT))
        status = OK if proof.converged else OPEN
        columns: Row = {**measured(flight), "aircraft": aircraft.name, "model": model.name, "group": work.group}
        yield _row(work, piece, status, "" if proof.converged else proof.text, **columns)
        for output, fit in proof.fit.items():
            yield _row(work, piece, status, "", **columns, kind="match", parameter=output, **_finite(fit, FIT))


_KINDS = {"flight": _flight, "joint": _joint, "envelope": _envelope, "match": _match}
