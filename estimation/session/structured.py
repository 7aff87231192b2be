"""The structure test beside the fits of a session, and fits again with what the model turns out to lack.

Each flight's fit is tested, and the joint one. The whole linear model is the built-in models' own: derivatives that the data
tell are added whatever is wished (`estimation.structure.score_test.THRESHOLD`), everything else on request only.
"""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from enum import Enum

from daq.utilities.errors import UserError
from estimation.errors import EstimationError
from estimation.estimators.arithmetic import NumericalFailure, numerical_failures
from estimation.estimators.estimator import Task
from estimation.estimators.output_error import output_error
from estimation.estimators.result import Result
from estimation.models.base import Model, joint_model
from estimation.models.library import WHOLE
from estimation.prepare.flight_data import FlightData, without_absent_outputs
from estimation.session.evidence import PREDICTABLE, predictability
from estimation.session.session import EstimationSession
from estimation.structure.candidates import Candidate, CandidateKind, structure_candidates, with_candidates
from estimation.structure.gusts import follows_controls, not_gusts
from estimation.structure.linearised import linearise_fit
from estimation.structure.odd_flights import (
    OddFlight,
    Scales,
    attenuations,
    first_part,
    odd_flights,
    scale_bounds,
)
from estimation.structure.score_test import NOTABLE, Lack, StructureTest, Tested, structure_of
from groundstation.flight import Flight

ROUNDS = 4  # of adding: a model that lacks more is another model
MOVES = 1.0  # bounds by which an odd flight has to move the joint estimate to be left out of its structure test
UNTOLD = 0.5
"""Part of an estimate by which a rival's differs from it, from which neither is the value."""
LeftOpen = tuple[tuple[str, Mapping[str, float]], ...]
"""Derivatives of which a filter's fit does not tell whether they are there -> what they move, in the parameters' own units."""
TOLD = 3.0
"""Standard deviations from which a derivative that a filter's fit leaves open counts as there."""
FILTERS = ("fem-noise", "fem")
ADDED_ANYWAY = (CandidateKind.LINEAR, CandidateKind.LATE_SENSOR)
"""What is added whatever is wished: the built-in models are the whole linear model, and instruments have lags of their own."""


class StructureWish(Enum):
    """What `--structure` asks for."""

    OFF = "off"
    TEST = "test"
    AUTO = "auto"

    @classmethod
    def of(cls, text: str) -> "StructureWish":
        """The wish by its word; EstimationError naming what there is."""
        if text not in {w.value for w in cls}:
            raise EstimationError(f"structure {text!r}: choose from {', '.join(w.value for w in cls)}")
        return cls(text)


def with_structure_tests(
    session: EstimationSession,
    task: Task,
    wish: StructureWish,
    fitted: Callable[[Model, Collection[str] | None], EstimationSession],
) -> EstimationSession:
    """The session with the structure test of each flight and of the joint fit, fitted again where something is added.

    fitted: the session of another model by some methods, None being all. Until nothing more is to be added, only those that
    the test looks at are fitted again.
    """
    added_names: list[str] = []
    ambiguous: list[Lack] = []
    tested = _tested(session, task)
    looked_at = _looked_at(session)
    left_open: list[LeftOpen] = [() for _ in _bases(tested)]
    for _ in range(ROUNDS):
        lacks = _lacks(tested)
        new = [lack for lack in lacks if _wanted(lack, tested.model, wish) and lack.names[0] not in added_names]
        by_name = {c.name: c for c in structure_candidates(tested.model)}
        terms = [by_name[lack.names[0]] for lack in new if lack.names[0] in by_name]
        if not terms:
            undecided = [_undecided(tested.model, *basis) for basis in _bases(tested)]
            terms = [t.candidate for tests in undecided for t in tests]
            left_open = [
                (*known, *_left_open(tests, results))
                for known, tests, (_, results) in zip(left_open, undecided, _bases(tested), strict=True)
            ]
        if not terms:
            break
        added_names += dict.fromkeys(t.name for t in terms)
        ambiguous += [lack for lack in new if lack.rivals]
        tested = _tested(fitted(with_candidates(tested.model, _fresh(terms), fitting=True), looked_at), task)
    if added_names and looked_at is not None:
        tested = _tested(fitted(tested.model, None), task)
    return _with_added(tested, added_names, ambiguous, left_open)


def _bases(session: EstimationSession) -> list[tuple[StructureTest | None, Mapping[str, Result]]]:
    """What decides what a model lacks: the joint fit, else each flight's."""
    if session.joint:
        return [(session.structure, session.joint)]
    return [(f.structure, f.results) for f in session.flights]


def _undecided(model: Model, structure: StructureTest | None, results: Mapping[str, Result]) -> list[Tested]:
    """Derivatives that a filter's fit leaves open: not significant, yet what they may be moves a printed value.

    In rough air the residuals of a filter tell little of what is left out: a `Cn_da` of three of its standard deviations moved
    `Cn_beta` by sixteen bounds. They are estimated, and the bounds span whether they are there.
    """
    if structure is None or model.name not in WHOLE or _recommended_method(results) not in FILTERS:
        return []
    return [t for t in structure.tested if t.candidate.kind is CandidateKind.LINEAR and t.worst[1] >= NOTABLE]


def _left_open(undecided: Sequence[Tested], results: Mapping[str, Result]) -> LeftOpen:
    """Of derivatives that are undecided, those of which the filter's fit does not tell whether they are there."""
    terms = [t for t in undecided if abs(t.score) < TOLD]
    bounds = {n: e.std_coloured for n, e in results[_recommended_method(results)].parameters.items()} if terms else {}
    return tuple((t.candidate.name, {n: m * bounds[n] for n, m in t.moves.items() if n in bounds}) for t in terms)


def _looked_at(session: EstimationSession) -> tuple[str, ...] | None:
    """The methods whose fits decide what a model lacks; None where that takes all: output error alone unless a filter is
    believed."""
    believed = {_recommended_method(results) for _, results in _bases(session)}
    others = set(session.methods) - {"ml"}
    return None if not others or "ml" not in session.methods or believed & {*FILTERS} else ("ml",)


def _fresh(terms: Sequence[Candidate]) -> list[Candidate]:
    return list({t.name: t for t in terms}.values())


def _lacks(session: EstimationSession) -> list[Lack]:
    """The strongest lack of the joint fit, else the strongest of any flight; one at a time, for each changes the others."""
    tests = [session.structure] if session.structure is not None else [f.structure for f in session.flights]
    strongest = [lack for s in tests if s is not None for lack in s.lacks[:1]]
    return sorted(strongest, key=lambda lack: -abs(lack.leading.score))[:1]


def _wanted(lack: Lack, model: Model, wish: StructureWish) -> bool:
    """Whether something that is lacking is to be added."""
    if not (lack.holds and lack.possible):  # the other flights do not confirm it, or nothing of that kind has that size
        return False
    if wish is StructureWish.AUTO:
        return True
    return model.name in WHOLE and lack.leading.candidate.kind in ADDED_ANYWAY


def _with_added(
    session: EstimationSession, added_names: Sequence[str], ambiguous: Sequence[Lack], left_open: Sequence[LeftOpen]
) -> EstimationSession:
    """The session with what was added, and the bounds that what cannot be told leaves open. left_open: of the joint fit, else
    of each flight."""

    def settled(structure: StructureTest | None) -> StructureTest | None:
        return None if structure is None else structure.with_added(added_names, ambiguous)

    flights = tuple(
        replace(
            f,
            structure=settled(f.structure),
            results=_spanning(f.results, settled(f.structure), () if session.joint else left_open[i]),
        )
        for i, f in enumerate(session.flights)
    )
    joint = settled(session.structure)
    return replace(
        session,
        flights=flights,
        structure=joint,
        joint=_spanning(session.joint, joint, left_open[0] if session.joint else ()),
    )


def _spanning(
    results: Mapping[str, Result], structure: StructureTest | None, left_open: LeftOpen
) -> Mapping[str, Result]:
    """Results whose bounds span what rivals would make of them, what is left out without being refused for it, and whether a
    derivative is there that is left open."""
    if structure is None:
        return results
    spans = [*(lack.differs for lack in structure.ambiguous), *(moves for _, moves in left_open)]
    why = {n: f"whether there is {term}" for term, moves in left_open for n in moves} | {
        n: f"it from {lack.rivals[0].candidate.phrase}"
        for lack in structure.ambiguous
        for n in (lack.leading.candidate.name, *lack.differs)
    }
    borne = [
        t.moves for lack in structure.lacks if not lack.matters(structure.bears) for t in (lack.leading, *lack.rivals)
    ]
    alternatives = {lack.leading.candidate.name: lack.leading.candidate.null for lack in structure.ambiguous}
    return {m: _spanned(r, spans, borne, alternatives, why) for m, r in results.items()}


def _spanned(
    result: Result,
    spans: Sequence[Mapping[str, float]],
    borne: Sequence[Mapping[str, float]],
    alternatives: Mapping[str, float],
    why: Mapping[str, str],
) -> Result:
    """A result with wider bounds; what they leave nothing of is not told.

    spans: in parameters' own units; borne: in bounds; alternatives: parameter -> its value where a rival takes its place.
    """
    parameters = dict(result.parameters)
    for name, e in result.parameters.items():
        rival = [s.get(name, 0.0) for s in spans]
        rival += [e.estimate - alternatives[name]] if name in alternatives else []
        wide = math.hypot(e.std_coloured, *rival, *(e.std_coloured * m.get(name, 0.0) for m in borne))
        parameters[name] = replace(e, std_coloured=wide)
        if e.identifiable and math.hypot(*rival, 0.0) > UNTOLD * abs(e.estimate):
            parameters[name] = replace(
                parameters[name],
                identifiable=False,
                why=f"these flights cannot tell {why.get(name, 'it from a rival')}",
            )
    return replace(result, parameters=parameters)


def _tested(session: EstimationSession, task: Task) -> EstimationSession:
    """The session with its structure tests."""
    flights = tuple(replace(f, structure=_test(session, [f.flight], f.results, task)[0]) for f in session.flights)
    if not session.joint:
        return replace(session, flights=flights)
    structure, odd = _test(session, [f.flight for f in session.flights], session.joint, task)
    return replace(session, flights=flights, structure=structure, odd=odd)


def _test(
    session: EstimationSession, flights: Sequence[Flight], results: Mapping[str, Result], task: Task
) -> tuple[StructureTest, tuple[OddFlight, ...]]:
    """The structure test of one set of results on the same flights; a structure that says why not where there is none."""
    try:
        with numerical_failures():
            return _of_basis(session, replace(task, flights=flights), results)
    except (UserError, NumericalFailure) as error:
        return StructureTest((), (), why_not=f"not tested: {error}"), ()


def _of_basis(
    session: EstimationSession, task: Task, results: Mapping[str, Result]
) -> tuple[StructureTest, tuple[OddFlight, ...]]:
    usable = {m: r for m, r in results.items() if r.converged}
    if not usable:
        return StructureTest((), (), why_not="not tested: no fit to test"), ()
    basis = next((usable[m] for m in ("ml", *FILTERS) if m in usable), None)
    _, ready = without_absent_outputs(session.model, replace(task, model=session.model).data)
    if basis is None:
        model = session.model if len(ready) == 1 else joint_model(session.model)
        basis = _likelihood(model, ready, measured=not any(f.reconstructed for f in task.flights))
    scales = {
        f.name: {**scale_bounds(f), **attenuations(session.model, d)} for f, d in zip(task.flights, ready, strict=True)
    }
    trusted = _recommended_method(results)
    moved = _moved_result(results.get(trusted, basis), basis)
    unseen = {CandidateKind.PLACE} if "imu" in session.aircraft.sensors else set()
    if any(f.reconstructed for f in task.flights) or any(d.commands for d in ready):
        unseen.add(CandidateKind.DAMPER)
    structure, odd = _of_result(basis, moved, ready, unseen, scales)
    follows = {
        m: not_gusts(usable[m], ready) if m == trusted else follows_controls(usable[m], ready)
        for m in FILTERS
        if m in usable
    }
    return replace(structure, follows={m: text for m, text in follows.items() if text}), odd


def _likelihood(model: Model, ready: list[FlightData], *, measured: bool) -> Result:
    """The fit to be tested beside methods that have no likelihood: output error, in rough air filter error, for what gusts do to
    output error looks like what a model lacks. measured: the flow angles, without which a filter is of no use."""
    result = output_error(model, ready)
    if not measured or predictability(result) <= PREDICTABLE:
        return result
    from estimation.estimators.filter_error import filter_error

    filtered = filter_error(model, ready)
    return filtered if filtered.converged else result


def _moved_result(recommended: Result, basis: Result) -> Result:
    """The result whose bounds the moves are counted in: a filter's where it is trusted with rough air, else the basis."""
    return recommended if set(recommended.names) == set(basis.names) else basis


def _recommended_method(results: Mapping[str, Result]) -> str:
    """What would be recommended, were nothing lacking."""
    from estimation.session.verdict import verdict

    return verdict(results).recommended.method


def _of_result(
    basis: Result, recommended: Result, ready: list[FlightData], unseen: Collection[CandidateKind], scales: Scales
) -> tuple[StructureTest, tuple[OddFlight, ...]]:
    """What a fit lacks in all flights, and the flight that still differs with that; what is lacking is then asked of the
    others.

    unseen: what these flights cannot show: the place of an accelerometer whose readings are brought to the CG; a damper, without
    vanes (reconstructed angles follow the motion as one does: scores of 10 with nothing behind the record) or where the record
    of a control is a command. scales: what instruments may be off.
    """
    linearised_result = recommended if recommended.method in FILTERS else basis
    filtered = linearised_result.method in FILTERS
    linear = linearise_fit(*first_part(linearised_result, ready))
    if linear is None:
        return StructureTest((), (), why_not="not tested: the motion runs away from the smallest change"), ()
    for kind in unseen:
        linear = linear.without(kind)
    structure = structure_of(linear, recommended, filtered=filtered)
    names = [lack.leading.candidate.name for lack in structure.lacks]
    odd = odd_flights(linear.absorbing(names), recommended, scales)
    differ = {o.flight for o in odd if o.moves > MOVES}
    if differ and len(linear.flights) > len(differ) + 1:
        linear = replace(linear, flights=tuple(f for f in linear.flights if f.name not in differ))
        structure = structure_of(linear, recommended, filtered=filtered)
    return structure, odd
