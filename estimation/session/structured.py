"""Structure tests of the fits of a session, and new fits with the terms that the model turns out to lack.

The fit of each flight is tested, and the joint one. Built-in models stand for the complete linear model, so derivatives that the
data call for (`estimation.structure.score_test.THRESHOLD`) are always added to them, other candidates on request only.
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
from estimation.session.verdict import FILTERS, verdict
from estimation.structure.candidates import CandidateKind, structure_candidates, with_candidates
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

ROUNDS = 4  # of adding terms: a model that lacks more is another model
AMBIGUOUS = 0.5
"""Relative difference between an estimate and its rival's, above which neither is taken for the value."""
UndecidedTerms = tuple[tuple[str, Mapping[str, float]], ...]
"""Derivatives that a filter's fit neither confirms nor excludes, with what each moves, in the parameters' own units."""
CONFIRMED = 3.0  # score from which a derivative that was added as undecided counts as present
ALWAYS_ADDED = (CandidateKind.LINEAR, CandidateKind.LATE_SENSOR)
"""Kinds that are added to built-in models without request: these stand for the complete linear model, and instruments lag."""


class StructureWish(Enum):
    """The values of `--structure`."""

    OFF = "off"
    TEST = "test"
    AUTO = "auto"

    @classmethod
    def of(cls, text: str) -> "StructureWish":
        """The member of this value. Raises EstimationError, which names the values, for any other text."""
        if text not in {w.value for w in cls}:
            raise EstimationError(f"structure {text!r}: choose from {', '.join(w.value for w in cls)}")
        return cls(text)


def with_structure_tests(
    session: EstimationSession,
    task: Task,
    wish: StructureWish,
    fit_model: Callable[[Model, Collection[str] | None], EstimationSession],
) -> EstimationSession:
    """The session with structure tests of each flight and of the joint fit, fitted again where a term is added.

    fit_model: gives the session of another model by the named methods, None being all. While terms are being added, only the
    methods that the test needs are fitted.
    """
    added_names: list[str] = []
    ambiguous: list[Lack] = []
    tested = _tested(session, task)
    methods = _tested_methods(session)
    left_open: list[UndecidedTerms] = [() for _ in _bases(tested)]
    for _ in range(ROUNDS):
        lacks = _lacks(tested)
        new = [lack for lack in lacks if _to_be_added(lack, tested.model, wish) and lack.names[0] not in added_names]
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
        distinct = {t.name: t for t in terms}.values()
        tested = _tested(fit_model(with_candidates(tested.model, distinct, fitting=True), methods), task)
    if added_names and methods is not None:
        tested = _tested(fit_model(tested.model, None), task)
    return _with_added(tested, added_names, ambiguous, left_open)


def _bases(session: EstimationSession) -> list[tuple[StructureTest | None, Mapping[str, Result]]]:
    """The structure tests and results that decide what a model lacks: of the joint fit, else of each flight."""
    if session.joint:
        return [(session.structure, session.joint)]
    return [(f.structure, f.results) for f in session.flights]


def _undecided(model: Model, structure: StructureTest | None, results: Mapping[str, Result]) -> list[Tested]:
    """Derivatives that are not significant in a filter's fit, though they may move a printed value.

    In rough air the residuals of a filter show little of a missing term: a `Cn_da` of three standard deviations moved `Cn_beta`
    by sixteen bounds. Such derivatives are estimated, and the bounds span the cases with and without them.
    """
    if structure is None or model.name not in WHOLE or _recommended_method(results) not in FILTERS:
        return []
    return [t for t in structure.tested if t.candidate.kind is CandidateKind.LINEAR and t.worst[1] >= NOTABLE]


def _left_open(undecided: Sequence[Tested], results: Mapping[str, Result]) -> UndecidedTerms:
    """Those undecided derivatives that the filter's fit does not confirm, with what each moves."""
    terms = [t for t in undecided if abs(t.score) < CONFIRMED]
    bounds = {n: e.std_coloured for n, e in results[_recommended_method(results)].parameters.items()} if terms else {}
    return tuple((t.candidate.name, {n: m * bounds[n] for n, m in t.moves.items() if n in bounds}) for t in terms)


def _tested_methods(session: EstimationSession) -> tuple[str, ...] | None:
    """The methods whose fits decide what a model lacks: output error alone, or all (None) where a filter is recommended."""
    recommended = {_recommended_method(results) for _, results in _bases(session)}
    others = set(session.methods) - {"ml"}
    return None if not others or "ml" not in session.methods or recommended & {*FILTERS} else ("ml",)


def _lacks(session: EstimationSession) -> list[Lack]:
    """The strongest lack of the joint fit, else of any flight; one at a time, because adding one changes the others."""
    tests = [session.structure] if session.structure is not None else [f.structure for f in session.flights]
    strongest = [lack for s in tests if s is not None for lack in s.lacks[:1]]
    return sorted(strongest, key=lambda lack: -abs(lack.leading.score))[:1]


def _to_be_added(lack: Lack, model: Model, wish: StructureWish) -> bool:
    """Whether a lack is to be added to the model."""
    confirmed = lack.holds and lack.possible  # by the other flights, and of a size that its kind can have
    if not confirmed:
        return False
    if wish is StructureWish.AUTO:
        return True
    return model.name in WHOLE and lack.leading.candidate.kind in ALWAYS_ADDED


def _with_added(
    session: EstimationSession,
    added_names: Sequence[str],
    ambiguous: Sequence[Lack],
    left_open: Sequence[UndecidedTerms],
) -> EstimationSession:
    """The session with the added terms in its structure tests, and bounds that span what stays ambiguous. left_open: of the joint
    fit, else of each flight."""

    def with_record(structure: StructureTest | None) -> StructureTest | None:
        return None if structure is None else structure.with_added(added_names, ambiguous)

    flights = []
    for i, f in enumerate(session.flights):
        structure = with_record(f.structure)
        results = _spanning(f.results, structure, () if session.joint else left_open[i])
        flights.append(replace(f, structure=structure, results=results))
    structure = with_record(session.structure)
    joint = _spanning(session.joint, structure, left_open[0] if session.joint else ())
    return replace(session, flights=tuple(flights), structure=structure, joint=joint)


def _spanning(
    results: Mapping[str, Result], structure: StructureTest | None, left_open: UndecidedTerms
) -> Mapping[str, Result]:
    """Results whose bounds span three things: the estimates with a rival instead, small lacks that do not forbid a
    recommendation, and the presence or absence of undecided derivatives."""
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
    """A result with wider bounds; parameters that these make meaningless are marked not identifiable.

    spans: parameter -> span in its own units; borne: parameter -> span in bounds; alternatives: parameter -> its value where a
    rival takes its place; why: parameter -> what the flights cannot tell.
    """
    parameters = dict(result.parameters)
    for name, e in result.parameters.items():
        rival = [s.get(name, 0.0) for s in spans]
        rival += [e.estimate - alternatives[name]] if name in alternatives else []
        wide = math.hypot(e.std_coloured, *rival, *(e.std_coloured * m.get(name, 0.0) for m in borne))
        parameters[name] = replace(e, std_coloured=wide)
        if e.identifiable and math.hypot(*rival, 0.0) > AMBIGUOUS * abs(e.estimate):
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
    """The structure test of results on the same flights; one without candidates that says why, where it cannot be made."""
    try:
        with numerical_failures():
            return _test_of_likelihood(session, replace(task, flights=flights), results)
    except (UserError, NumericalFailure) as error:
        return StructureTest((), (), why_not=f"not tested: {error}"), ()


def _test_of_likelihood(
    session: EstimationSession, task: Task, results: Mapping[str, Result]
) -> tuple[StructureTest, tuple[OddFlight, ...]]:
    """The structure test of the most trusted likelihood fit, which is made here where no result is one, and odd flights."""
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
    recommended = results.get(trusted, basis)
    if set(recommended.names) != set(basis.names):
        recommended = basis
    unseen = {CandidateKind.PLACE} if "imu" in session.aircraft.sensors else set()
    if any(f.reconstructed for f in task.flights) or any(d.commands for d in ready):
        unseen.add(CandidateKind.DAMPER)
    structure, odd = _test_of_fit(basis, recommended, ready, unseen, scales)
    follows = {
        m: not_gusts(usable[m], ready) if m == trusted else follows_controls(usable[m], ready)
        for m in FILTERS
        if m in usable
    }
    return replace(structure, follows={m: text for m, text in follows.items() if text}), odd


def _likelihood(model: Model, ready: list[FlightData], *, measured: bool) -> Result:
    """The fit to be tested where no method has a likelihood: output error, but filter error in rough air, where gusts make output
    error look as if the model lacked something. measured: whether flow angles are; without them a filter is of no use."""
    result = output_error(model, ready)
    if not measured or predictability(result) <= PREDICTABLE:
        return result
    from estimation.estimators.filter_error import filter_error

    filtered = filter_error(model, ready)
    return filtered if filtered.converged else result


def _recommended_method(results: Mapping[str, Result]) -> str:
    """The method that would be recommended if the model lacked nothing."""
    return verdict(results).recommended.method


def _test_of_fit(
    basis: Result, recommended: Result, ready: list[FlightData], unseen: Collection[CandidateKind], scales: Scales
) -> tuple[StructureTest, tuple[OddFlight, ...]]:
    """What a fit lacks in all flights, and a flight that still differs once that is included. Where there is such a flight, the
    others are tested again without it.

    recommended: the result whose bounds count what a candidate moves. unseen: kinds that these flights cannot show: the place of
    an accelerometer whose readings are corrected to the CG; a damper, without vanes (reconstructed angles follow the motion as a
    damper does: scores of 10 without one) or where the record of a control is a command. scales: as in `odd_flights`.
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
    differ = {o.flight for o in odd if o.moves > NOTABLE}
    if differ and len(linear.flights) > len(differ) + 1:
        linear = replace(linear, flights=tuple(f for f in linear.flights if f.name not in differ))
        structure = structure_of(linear, recommended, filtered=filtered)
    return structure, odd
