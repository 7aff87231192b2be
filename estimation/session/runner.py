"""Run methods over flights: each by itself, and all of them together. What `sideslip estimate` does."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from daq.utilities.errors import UserError
from estimation.aircraft import Aircraft
from estimation.errors import AircraftError, DataError, EstimationError
from estimation.estimators.arithmetic import NumericalFailure, mark_not_finite, numerical_failures
from estimation.estimators.estimator import NO_EXTRAS, Estimator, Extras, Task
from estimation.estimators.registry import check_extras, estimator_names, find_estimator
from estimation.estimators.result import Result
from estimation.models.base import Model, joint_model
from estimation.prepare.columns import way_to
from estimation.prepare.stretches import unique_names
from estimation.session.aircraft_review import aircraft_objections
from estimation.session.evidence import parameter_scatter, with_airspeed_error
from estimation.session.fast_modes import fast_modes, with_fast_modes
from estimation.session.session import EstimationSession, FlightEstimates
from estimation.session.stated_uncertainty import with_stated_uncertainty
from estimation.session.structured import StructureWish, with_structure_tests
from estimation.session.thinned import thinned
from estimation.session.verdict import verdict
from estimation.session.without_sensor import with_unknown_thrust, without_sensor
from groundstation.flight import Flight
from groundstation.flight.contradictions import Contradiction, contradictions
from groundstation.flight.quality.noise import too_slow
from groundstation.flight.quality.plausibility import suspicions
from groundstation.flight.quality.repeats import one_record_twice

Outcome = Result | UserError | NumericalFailure
"""What a method makes of one flight: a result, or the error that says why there is none."""


def estimate(
    model: Model,
    flights: Sequence[Flight],
    aircraft: Aircraft,
    methods: Sequence[str] = ("ml",),
    *,
    joint: bool = False,
    device: str = "cpu",
    progress: Callable[[str], None] | None = None,
    extras: Extras = NO_EXTRAS,
    structure: StructureWish = StructureWish.TEST,
) -> EstimationSession:
    """Run every method on every flight, and on all of them together where `joint`.

    structure: whether terms that the model may lack are tested beside the fits, and added. device: where networks are trained.
    progress: called with a sentence as each piece of work begins. Raises EstimationError for an unknown method, DataError where a
    joint estimate would count one record twice, and the first method's error where no method can use a flight.
    """
    if not methods:
        raise EstimationError(f"no method given; choose from {', '.join(estimator_names())}")
    estimators = [find_estimator(m) for m in methods]
    _check(extras, model, estimators)
    for e in estimators:
        if e.needs_aircraft:
            _refuse_unknown(aircraft, e)
    flights = unique_names(flights)
    if joint and (duplicates := one_record_twice(flights)) is not None:
        first, second = (flights[k].name for k in duplicates)
        raise DataError(
            f"{second} is of the same record as {first}, which would count twice jointly: give every flight once"
        )
    model, flights = without_sensor(model, flights)
    flights = thinned(model, flights, keep_held=extras.keep_held)
    task = Task(model, flights, aircraft, extras, device, tell=progress or (lambda text: None))
    session = _fit_all(task, estimators, joint)
    if structure is not StructureWish.OFF:
        session = with_structure_tests(
            session,
            task,
            structure,
            lambda other_model, names: _fit_all(
                replace(task, model=other_model, plain=model),
                [e for e in estimators if names is None or e.name in names],
                joint,
            ),
        )
    return with_stated_uncertainty(_with_verdicts(session))


def _fit_all(task: Task, estimators: Sequence[Estimator], joint: bool) -> EstimationSession:
    """Every method over every flight, and over all of them together where `joint`."""
    flights = task.flights
    base_model = None if task.plain is None else joint_model(task.plain)
    together = replace(task, number=len(flights), model=joint_model(task.model), plain=base_model) if joint else task
    outcomes_by_method = {
        e.name: _with_limits_of_records(_fit_each(e, task), [[f] for f in flights]) for e in estimators
    }
    for flight, outcomes in zip(flights, zip(*outcomes_by_method.values(), strict=True), strict=True):
        _refuse_useless(flight, outcomes)
    joint_outcomes: dict[str, Outcome] = {}
    for e in estimators if joint else ():
        task.tell(f"joint over {len(flights)} flights: {e.title}")
        joint_outcomes[e.name] = _with_limits_of_records([_fit_or_error(e, together)], [flights])[0]
    estimates = []
    for i, flight in enumerate(flights):
        results, failures = _split({m: outcomes[i] for m, outcomes in outcomes_by_method.items()})
        estimates.append(FlightEstimates(flight, results, failures))
    mean = {
        m: parameter_scatter(r)
        for m, outcomes in outcomes_by_method.items()
        if (r := [o for o in outcomes if isinstance(o, Result)])
    }
    results, failures = _split(joint_outcomes)
    return EstimationSession(
        task.aircraft, task.model, tuple(outcomes_by_method), tuple(estimates), results, mean, joint_failures=failures
    )


def _with_limits_of_records(outcomes: Sequence[Outcome], flights: Sequence[Sequence[Flight]]) -> list[Outcome]:
    """Outcomes with airspeed errors in their bounds; parameters that the records cannot determine are marked not identifiable."""
    return [
        with_unknown_thrust(with_fast_modes(with_airspeed_error(o, members), members)) if isinstance(o, Result) else o
        for o, members in zip(outcomes, flights, strict=True)
    ]


def _with_verdicts(session: EstimationSession) -> EstimationSession:
    """The session with a verdict on each flight, and on the joint estimate where there is one."""
    reconstructed = {f.flight.name: _reconstructed_angles(session.model, f.flight) for f in session.flights}
    odd = {f.flight.name: _odd_columns(session.model, f.flight) for f in session.flights}
    objections = aircraft_objections(session.aircraft, session.model)
    flights = tuple(
        replace(
            f,
            verdict=verdict(
                f.results,
                f.failures,
                reconstructed=reconstructed[f.flight.name],
                odd=odd[f.flight.name],
                objections=objections,
                structure=f.structure,
                fast=_fast(f.results, [f.flight]),
            ),
        )
        for f in session.flights
    )
    if not session.joint and not session.joint_failures:
        return replace(session, flights=flights)
    reconstructed_angles = tuple(sorted(set().union(*reconstructed.values())))
    members = {m: [f.results[m] for f in session.flights if m in f.results] for m in session.methods}
    all_odd = [f"{name}: {text}" for name, texts in odd.items() for text in texts]
    joint_verdict = verdict(
        session.joint,
        session.joint_failures,
        members,
        reconstructed_angles,
        all_odd,
        objections=objections,
        structure=session.structure,
        odd_flights=session.odd,
        fast=_fast(session.joint, [f.flight for f in session.flights]),
    )
    return replace(session, flights=flights, verdict=joint_verdict)


def _fast(results: Mapping[str, Result], flights: Sequence[Flight]) -> tuple[str, ...]:
    """Sentences on dampings that the records of the controls are too slow for, by the first method's result."""
    first = next(iter(results.values()), None)
    return tuple(m.text for m in fast_modes(first, flights)) if first is not None else ()


def _reconstructed_angles(model: Model, flight: Flight) -> tuple[str, ...]:
    """Flow angles of the model that `sideslip reconstruct` has put into the flight."""
    model_columns = {s.source for s in (*model.inputs, *model.outputs, *model.states)}
    return tuple(sorted(model_columns & set(flight.reconstructed) & {"alpha", "beta"}))


def _odd_columns(model: Model, flight: Flight) -> tuple[str, ...]:
    """Sentences on columns of the model that the record itself shows in another unit or sign or sampled too slowly, and on
    contradictions that move derivatives."""
    model_columns = {"time", *(s.source for s in (*model.inputs, *model.outputs, *model.states))}
    odd = tuple(s.text for s in suspicions(flight.time, flight.columns) if model_columns & set(s.columns))
    slow = too_slow(flight, model_columns)
    return (
        *odd,
        *([slow] if slow else []),
        *contradicted_columns(model_columns, flight),
    )


def contradicted_columns(model_columns: set[str], flight: Flight) -> tuple[str, ...]:
    """Sentences on contradictions of a flight that forbid to recommend any estimate by a model of these columns."""
    stopping = [c for c in contradictions(flight) if c.stops and _matters(c, model_columns, flight)]
    return tuple(f"{c.text} (moves {c.moves})" for c in stopping)


def _matters(contradiction: Contradiction, model_columns: set[str], flight: Flight) -> bool:
    """Whether a contradiction concerns the model. A failed sensor does where a column of the model is its own or made from it."""
    derivations = [way_to(flight, n) for n in model_columns if not flight.measured(n)]
    used_columns = model_columns.union(*(w.needs for w in derivations if w is not None))
    return not contradiction.failed or bool(flight.reconstructed) or bool(used_columns & set(contradiction.failed))


def _fit_or_error(estimator: Estimator, task: Task) -> Outcome:
    """One fit; where it fails, its error, so that the other methods and flights keep their results."""
    try:
        with numerical_failures():
            return mark_not_finite(estimator.fit(task.for_estimator(estimator)))
    except (UserError, NumericalFailure) as error:
        return error


def _fit_each(estimator: Estimator, task: Task) -> list[Outcome]:
    """What the method makes of each flight by itself."""
    if estimator.fit_each is not None:
        count = len(task.flights)
        task.tell(f"{count} flight{'s' if count > 1 else ''} side by side: {estimator.title}")
        try:
            with numerical_failures():
                return [mark_not_finite(r) for r in estimator.fit_each(task.for_estimator(estimator))]
        except (UserError, NumericalFailure):
            pass  # one flight cannot be used: fitting each by itself shows which
    outcomes = []
    for number, flight in enumerate(task.flights):
        task.tell(f"{flight.name}: {estimator.title}")
        outcomes.append(_fit_or_error(estimator, replace(task, flights=[flight], number=number)))
    return outcomes


def _refuse_useless(flight: Flight, outcomes: Sequence[Outcome]) -> None:
    """Raise the first method's error where no method can use the flight: it cannot feed the model."""
    refusals = [o for o in outcomes if isinstance(o, UserError)]
    if len(refusals) == len(outcomes):
        raise refusals[0]


def _split(outcomes: Mapping[str, Outcome]) -> tuple[dict[str, Result], dict[str, str]]:
    """Results, and sentences on why there are none, by method."""
    results = {m: o for m, o in outcomes.items() if isinstance(o, Result)}
    return results, {m: str(o) for m, o in outcomes.items() if not isinstance(o, Result)}


def run_method(
    method: str,
    model: Model,
    flights: Sequence[Flight],
    aircraft: Aircraft,
    device: str = "cpu",
    extras: Extras = NO_EXTRAS,
) -> Result:
    """One method over one flight or several together; NumericalFailure where its arithmetic fails."""
    with numerical_failures():
        return mark_not_finite(find_estimator(method).fit(Task(model, flights, aircraft, extras, device)))


def _check(extras: Extras, model: Model, estimators: Sequence[Estimator]) -> None:
    """Raise EstimationError, before any work is done, for extras that cannot be computed."""
    check_extras(extras.asked, estimators)
    if extras.bootstrap:
        from estimation.estimators.refits import check_replicates

        check_replicates(extras.bootstrap)
    if extras.seed < 0:
        raise EstimationError(f"--seed {extras.seed}: give a whole number from 0")
    for name in extras.profile:
        if model.parameter(name).fixed:
            raise EstimationError(f"model {model.name}: {name} is fixed, so it has no profile; free it first")


def _refuse_unknown(aircraft: Aircraft, estimator: Estimator) -> None:
    """Raise AircraftError for a method that uses geometry and mass itself where nothing is known of the aircraft."""
    if aircraft.unknown:
        raise AircraftError(
            f"method {estimator.name} takes geometry and mass of the aircraft, and none is known of aircraft"
            f" {aircraft.name!r}; say which with --aircraft NAME or FILE"
        )
