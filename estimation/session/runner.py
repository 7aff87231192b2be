"""Run methods over flights: each by itself, and all of them together. What `sideslip estimate` does."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from estimation.aircraft import Aircraft
from estimation.errors import EstimationError
from estimation.estimators.estimator import NO_EXTRAS, Estimator, Extras, Task
from estimation.estimators.registry import check_extras, find, names
from estimation.estimators.result import Result
from estimation.models.base import Model, ParameterRole
from estimation.session.flights import unique_names
from estimation.session.scatter import scatter
from estimation.session.session import FlightEstimates, Session
from groundstation.flight import Flight


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
) -> Session:
    """Run every method on every flight, and on all of them together where `joint`.

    device: where networks are trained. progress: told each piece of work as it begins. Raises EstimationError for an
    unknown method, and what the first method raises when a flight cannot feed the model.
    """
    if not methods:
        raise EstimationError(f"no method given; choose from {', '.join(names())}")
    chosen = [find(m) for m in methods]
    _check(extras, model, chosen)
    flights = unique_names(flights)
    task = Task(model, flights, aircraft, extras, device, tell=progress or (lambda text: None))
    found = {e.name: _each(e, task) for e in chosen}
    together: dict[str, Result] = {}
    for e in chosen if joint else ():
        task.tell(f"joint over {len(flights)} flights: {e.title}")
        together[e.name] = e.fit(replace(task, model=joint_model(model), number=len(flights)))
    done = [FlightEstimates(f, {m: results[i] for m, results in found.items()}) for i, f in enumerate(flights)]
    mean = {m: scatter(results) for m, results in found.items()}
    return Session(aircraft, model, tuple(found), tuple(done), together, mean)


def _each(estimator: Estimator, task: Task) -> list[Result]:
    """The estimates of each flight by itself."""
    if estimator.fit_each is not None:
        count = len(task.flights)
        task.tell(f"{count} flight{'s' if count > 1 else ''} side by side: {estimator.title}")
        return estimator.fit_each(task)
    results = []
    for number, flight in enumerate(task.flights):
        task.tell(f"{flight.name}: {estimator.title}")
        results.append(estimator.fit(replace(task, flights=[flight], number=number)))
    return results


def run_method(
    method: str,
    model: Model,
    flights: Sequence[Flight],
    aircraft: Aircraft,
    device: str = "cpu",
    extras: Extras = NO_EXTRAS,
) -> Result:
    """One method over one flight or several together."""
    return find(method).fit(Task(model, flights, aircraft, extras, device))


def _check(extras: Extras, model: Model, chosen: Sequence[Estimator]) -> None:
    """EstimationError before any work is done for extras that cannot be had."""
    check_extras(extras.asked, chosen)
    if extras.bootstrap:
        from estimation.estimators.bootstrap import check_replicates

        check_replicates(extras.bootstrap)
    if extras.seed < 0:
        raise EstimationError(f"--seed {extras.seed}: give a whole number from 0")
    for name in extras.profile:
        if model.parameter(name).fixed:
            raise EstimationError(f"model {model.name}: {name} is fixed, so it has no profile; free it first")


def joint_model(model: Model) -> Model:
    """The model for a joint fit: constant coefficients (CY_0 Cl_0 Cn_0 ...) are each flight's own.

    They hold the trim, the centre of gravity and the sensor offsets of the day as much as the aircraft.
    """
    return model.with_local(*model.free_of(ParameterRole.CONSTANT))
