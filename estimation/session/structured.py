"""The structure test beside the fits of a session, and fits again with what the model turns out to lack.

Each flight's fit is tested, and the joint one. The whole linear model is the built-in models' own: derivatives that the data tell
are added whatever is wished (`estimation.structure.score_test.THRESHOLD`), everything else on request only.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from enum import Enum

from numpy.linalg import LinAlgError

from daq.contract.errors import UserError
from estimation.engine.data import FlightData
from estimation.engine.prepared import compared, prepared
from estimation.estimators.estimator import Extras, Task
from estimation.estimators.output_error import output_error
from estimation.estimators.result import Result
from estimation.models.base import Model
from estimation.models.library import WHOLE
from estimation.session.session import FlightEstimates, Session
from estimation.structure.candidates import Candidate, Kind, candidates, with_candidates
from estimation.structure.excerpt import excerpt
from estimation.structure.linearised import linearise
from estimation.structure.odd_flights import OddFlight, odd_flights
from estimation.structure.score_test import Lack, Structure, structure_of
from groundstation.flight import Flight

ROUNDS = 4  # of adding: a model that lacks more is another model
MOVES = 1.0  # bounds by which an odd flight has to move the joint estimate to be left out of its structure test
FILTERS = ("fem-noise", "fem")


class Wish(Enum):
    """What `--structure` asks for."""

    OFF = "off"
    TEST = "test"
    AUTO = "auto"


def structured(session: Session, extras: Extras, wish: Wish, fitted: Callable[[Model], Session]) -> Session:
    """The session with the structure test of each flight and of the joint fit, fitted again where something is added.

    fitted: the session of another model.
    """
    added: list[str] = []
    ambiguous: list[Lack] = []
    now = _tested(session, extras)
    for _ in range(ROUNDS):
        lacks = _lacks(now)
        new = [lack for lack in lacks if _wanted(lack, now.model, wish) and lack.names[0] not in added]
        if not new:
            break
        chosen = {c.name: c for c in candidates(now.model)}
        terms = [chosen[lack.names[0]] for lack in new if lack.names[0] in chosen]
        added += [t.name for t in terms]
        ambiguous += [lack for lack in new if lack.rivals]
        now = _tested(fitted(with_candidates(now.model, _fresh(terms))), extras)
    return _with_added(now, added, ambiguous)


def _fresh(terms: Sequence[Candidate]) -> list[Candidate]:
    return list({t.name: t for t in terms}.values())


def _lacks(session: Session) -> list[Lack]:
    """The strongest lack of the joint fit, else the strongest of any flight; one at a time, for each changes the others."""
    every = [session.structure] if session.structure is not None else [f.structure for f in session.flights]
    found = [lack for s in every if s is not None for lack in s.lacks[:1]]
    return sorted(found, key=lambda lack: -abs(lack.leading.score))[:1]


def _wanted(lack: Lack, model: Model, wish: Wish) -> bool:
    """Whether something that is lacking is to be added."""
    if wish is Wish.AUTO:
        return True
    return model.name in WHOLE and lack.leading.candidate.kind is Kind.LINEAR


def _with_added(session: Session, added: Sequence[str], ambiguous: Sequence[Lack]) -> Session:
    flights = tuple(
        replace(f, structure=None if f.structure is None else f.structure.with_added(added, ambiguous))
        for f in session.flights
    )
    joint = None if session.structure is None else session.structure.with_added(added, ambiguous)
    return replace(session, flights=flights, structure=joint)


def _tested(session: Session, extras: Extras) -> Session:
    """The session with its structure tests."""
    flights = tuple(replace(f, structure=_test(session, [f.flight], f.results, extras)[0]) for f in session.flights)
    if not session.joint:
        return replace(session, flights=flights)
    structure, odd = _test(session, [f.flight for f in session.flights], session.joint, extras)
    return replace(session, flights=flights, structure=structure, odd=odd)


def _test(
    session: Session, flights: Sequence[Flight], results: "dict[str, Result] | object", extras: Extras
) -> tuple[Structure | None, tuple[OddFlight, ...]]:
    """The structure test of one set of results on the same flights; a structure that says why not where there is none."""
    assert isinstance(results, dict)
    try:
        return _of_basis(session, flights, results, extras)
    except (UserError, LinAlgError, ArithmeticError) as error:
        return Structure((), (), why_not=f"not tested: {error}"), ()


def _of_basis(
    session: Session, flights: Sequence[Flight], results: dict[str, Result], extras: Extras
) -> tuple[Structure | None, tuple[OddFlight, ...]]:
    usable = {m: r for m, r in results.items() if r.converged and r.method == m}
    if not usable:
        return Structure((), (), why_not="not tested: no fit to test"), ()
    basis = usable.get("ml") or next((usable[m] for m in FILTERS if m in usable), None)
    model = next(iter(usable.values())).model if basis is None else basis.model
    data = list(Task(model, flights, session.aircraft, extras).data)
    ready = compared(model, prepared(model, data))[1] if basis is None else _ready(basis, data)
    if basis is None:
        basis = output_error(model, ready)
    return _of_result(basis, _moved_result(results, basis), ready)


def _ready(basis: Result, data: Sequence["Flight | FlightData"]) -> list[FlightData]:
    """Flights prepared for the model of a result, compared in the outputs in which it was."""
    made = prepared(basis.model, data)
    return compared(basis.model, made)[1]


def _moved_result(results: dict[str, Result], basis: Result) -> Result:
    """The result whose bounds the moves are counted in: a filter's where it is trusted with rough air, else the basis."""
    from estimation.session.verdict import verdict

    method = verdict(results).recommended.method
    chosen = results.get(method, basis)
    return chosen if set(chosen.names) == set(basis.names) else basis


def _of_result(basis: Result, chosen: Result, ready: list[FlightData]) -> tuple[Structure | None, tuple[OddFlight, ...]]:
    filtered = chosen.method in FILTERS
    at = chosen if filtered else basis
    linear = linearise(*excerpt(at, ready))
    if linear is None:
        return Structure((), (), why_not="not tested: the motion runs away from the smallest change"), ()
    odd = odd_flights(linear, chosen)
    differ = {o.flight for o in odd if o.moves > MOVES}
    if differ and len(linear.flights) > len(differ) + 1:
        linear = replace(linear, flights=tuple(f for f in linear.flights if f.name not in differ))
    return structure_of(linear, chosen, filtered=filtered), odd
