"""The recommended method for a flight, or for all flights together, with the reason; `none` where no method is recommended.

The criteria: whether filter error improves on output error beyond chance (process noise: gusts, or a model that lacks something),
or, without filter error, how well residuals predict their successors; whether methods agree within their joint bounds; whether
biases and constants are plausible for instruments and trims; a joint estimate against its members; scatter over flights against
bounds; flights that differ from all others. Thresholds: docs/estimation.md (`verdict_study`).
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from estimation.estimators.result import Estimate, Result
from estimation.models.base import ParameterRole
from estimation.session.aircraft_review import NO_OBJECTIONS, AircraftObjections
from estimation.session.evidence import (
    PREDICTABLE,
    ProcessNoise,
    beneath_instruments,
    corrected_states,
    gain_of_filter,
    neighbour_correlations,
    parameter_scatter,
    predictability,
)
from estimation.session.lack_sentences import ADD, ambiguous_text, lack_text
from estimation.session.plausible_derivatives import implausible_derivatives
from estimation.session.sanity_checks import Doubt, DoubtKind, doubts_of, impossible_values
from estimation.structure.odd_flights import OddFlight
from estimation.structure.score_test import NOTABLE, StructureTest

NO_METHOD = "none"
TRUST: Mapping[str, int] = {"ml": 0, "fem-noise": 1, "fem": 2, "ngn-improved": 3, "ls": 4, "ngn": 5}
"""Order of trust where nothing else decides: rms error over bound in still air, ml nearest to 1 (docs/estimation.md)."""

FILTERS = ("fem-noise", "fem")
"""Filter error: the published form first, which never failed in the flights of docs/validation.md."""

REGRESSIONS: Mapping[str, float] = {"ls": 0.15, "ngn": 0.15, "ngn-improved": 0.05}
"""Methods that take measured motion for truth -> relative error of a derivative that this causes and their bounds leave out
(docs/ngn.md: 10-15 % and 5 % against truth)."""

TRUSTED_RECONSTRUCTED = ("ml",)
"""Methods that do not take reconstructed angles for the true ones; docs/compatibility.md shows what gusts do to the others."""

NOISY = 0.6  # mean log ratio of variances, ml over fem: calm and light air up to 0.35, gusts of 0.5 deg from 0.96
COLOURED = 0.3  # correlation of successive innovations: a right model leaves 0.2 at most in 60 flights
FEW = 8.0
"""Measured numbers per unknown of a filter error, gains included, below which the gains absorb output noise: at five (nine of
ten samples missing) roll derivatives were 3.7 bounds off; 14 s at 10 Hz have twenty."""
BELOW_NOISE = "filter error takes up less than the noise of any instrument, as in a record without noise, and agrees"
DISAGREE = 3.0  # joint bounds by which two estimates must differ to contradict each other
NEAR_ZERO = 3.0  # bounds within which an estimate counts as zero
OUTSIDE = 1.0  # bounds by which a joint estimate may lie outside the range of its members
EXPLAINS = 0.2  # r2 that some output has to reach: a record at rest, or of noise alone, has none
STRETCHED = 1.5  # motion over the largest of any other flight, from which a flight stretches a shared linear model


@dataclass(frozen=True, slots=True)
class Recommendation:
    """The method to believe, or `none`, and why: a sentence. lacks: what the model lacks, the likeliest first."""

    method: str
    why: str
    lacks: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """As it is printed and shown on the page."""
        return f"{self.method}: {self.why}"

    def to_json(self) -> dict[str, str | list[str]]:
        """As `recommended` in `estimate --json`."""
        return {"method": self.method, "why": self.why, "lacks": list(self.lacks)}


@dataclass(frozen=True, slots=True)
class Verdict:
    """What is recommended of one set of results, and what is doubted in it."""

    recommended: Recommendation
    doubts: tuple[Doubt, ...] = ()


@dataclass
class _Case:
    """Results of one flight or of all together, while evidence is collected. against: method -> why it is not to be believed;
    reconstructed: names of reconstructed flow angles, for sentences."""

    results: Mapping[str, Result]
    against: dict[str, str] = field(default_factory=dict)
    doubts: list[Doubt] = field(default_factory=list)
    reconstructed: str = ""

    @property
    def credible(self) -> list[str]:
        """Methods without an objection, the most trusted first."""
        methods = [m for m in self.results if m not in self.against]
        return sorted(methods, key=lambda m: TRUST.get(m, len(TRUST)))

    def object_to(self, method: str, kind: DoubtKind, text: str) -> None:
        """Add a doubt that is an objection to a method."""
        self.doubts.append(Doubt(kind, f"{method}: {text}"))
        self.against.setdefault(method, text)


def verdict(
    results: Mapping[str, Result],
    failures: Mapping[str, str] | None = None,
    members: Mapping[str, Sequence[Result]] | None = None,
    reconstructed: Sequence[str] = (),
    odd: Sequence[str] = (),
    objections: AircraftObjections = NO_OBJECTIONS,
    structure: StructureTest | None = None,
    odd_flights: Sequence[OddFlight] = (),
    fast: Sequence[str] = (),
) -> Verdict:
    """The verdict on the results of several methods on the same data.

    failures: method -> why it gives no result. members: method -> results of the single flights of a joint estimate.
    reconstructed: flow angles of the model that were computed from other instruments. They lack the gusts: methods that take
    them for the true angles are off by several bounds (docs/compatibility.md), output error hardly is. odd: sentences on
    columns that the record itself shows in another unit or sign, which spoils every result. objections: of the aircraft
    review. structure: what the model lacks; odd_flights: flights that differ from the others of a joint fit. fast: sentences on
    dampings that the records of the controls are too slow for.
    """
    case = _Case(results, reconstructed=" and ".join(reconstructed))
    for text in objections.impossible:
        case.doubts.append(Doubt(DoubtKind.AIRCRAFT, text))
        case.against = dict.fromkeys(results, text) | case.against
    for text in (
        f"the aircraft file states {n}, and the model has no term for it: not used" for n in objections.dropped
    ):
        case.doubts.append(Doubt(DoubtKind.STATED, text))
    for text in odd:
        case.doubts.append(Doubt(DoubtKind.CHANNEL, text))
        case.against = dict.fromkeys(results, text) | case.against
    if reconstructed:
        objection = (
            f"{case.reconstructed} reconstructed, not measured, without the gusts, which only output error tolerates"
        )
        for method in (m for m in results if m not in TRUSTED_RECONSTRUCTED):
            case.object_to(method, DoubtKind.RECONSTRUCTED, objection)
    if corrected := corrected_states(results):
        for method in (m for m in results if m in REGRESSIONS):
            case.against.setdefault(
                method, f"it takes records for the true motion, from which {corrected} shows them to differ"
            )
    for method, reason in (failures or {}).items():
        case.doubts.append(Doubt(DoubtKind.FAILED, f"{method}: {reason}"))
    for method, result in results.items():
        _doubt_result(case, method, result, objections.aspect)
    for method, results_of_flights in (members or {}).items():
        if method in results and len(results_of_flights) > 1:
            _doubt_joint(case, method, results[method], results_of_flights)
    case.doubts += [Doubt(DoubtKind.FAST, text) for text in fast]
    if members:
        case.doubts += _stretched(next(iter(results.values()), None))
    choice = _choice(case, tested=structure is not None)
    recommendation = _in_view_of_structure(choice, case.doubts, structure, odd_flights)
    return Verdict(recommendation, tuple(case.doubts))


def _doubt_result(case: _Case, method: str, result: Result, aspect: float) -> None:
    """Add doubts and objections that one result gives by itself."""
    if not result.converged:
        case.object_to(method, DoubtKind.FAILED, result.text)
        return
    for text in impossible_values(result):
        case.object_to(method, DoubtKind.INSTRUMENT, text)
    for text in implausible_derivatives(result, aspect):
        case.object_to(method, DoubtKind.IMPLAUSIBLE, text)
    for doubt in doubts_of(result):
        if doubt.kind in (DoubtKind.SIGN, DoubtKind.CHANNEL_SIGN, DoubtKind.UNIT):
            case.against.setdefault(method, doubt.text)
    r2 = [f.r2 for fit in result.flights for f in fit.fit.values() if math.isfinite(f.r2)]
    if r2 and max(r2) < EXPLAINS:
        text = f"it explains none of the outputs (r2 {max(r2):.2f} at most): the motion is not the model's"
        case.object_to(method, DoubtKind.UNEXPLAINED, text)
    if not result.informative:
        case.against.setdefault(method, "it determines none of the derivatives")


# ------------------------------------------------------------------------------------------------------------ the choice


def _in_view_of_structure(
    recommendation: Recommendation,
    doubts: list[Doubt],
    structure: StructureTest | None,
    odd_flights: Sequence[OddFlight],
) -> Recommendation:
    """The recommendation, or none, in view of what the model lacks and of odd flights; their doubts are added to `doubts`."""
    structure = structure or StructureTest((), ())
    lacks, ambiguous = structure.lacks, structure.ambiguous
    against = [structure.follows[recommendation.method]] if recommendation.method in structure.follows else []
    doubts += [Doubt(DoubtKind.PROCESS_NOISE, f"{method}: {text}") for method, text in structure.follows.items()]
    for odd in odd_flights:
        doubts.append(Doubt(DoubtKind.ODD_FLIGHT, odd.text))
        against += [odd.text] if odd.moves > NOTABLE else []
    for lack in sorted(lacks, key=lambda lack: not lack.possible):
        text, advice = lack_text(lack), ADD if lack.possible else ""
        doubts.append(Doubt(DoubtKind.LACK, text + advice))
        if lack.matters(structure.bears):
            against = [*(t.removesuffix(advice) for t in against), text + advice]  # the advice only once, at the end
        elif recommendation.method in FILTERS:  # a filter absorbs whatever the model lacks
            against.append(f"{text}; {recommendation.method} may take that for process noise")
    doubts += [Doubt(DoubtKind.LACK, ambiguous_text(lack)) for lack in ambiguous]
    names = tuple(dict.fromkeys(n for lack in (*lacks, *ambiguous) for n in lack.names))
    if not against:
        return replace(recommendation, lacks=names) if lacks else recommendation
    reason = "; ".join(against)
    reason = reason if recommendation.method != NO_METHOD else _joined(reason, recommendation.why)
    return Recommendation(NO_METHOD, reason, names)


def _choice(case: _Case, *, tested: bool = False) -> Recommendation:
    """The method to recommend. tested: a structure test was made, so that methods do not agree merely by a shared lack."""
    if not case.results:
        return Recommendation(NO_METHOD, "no method came to a result")
    noise = _process_noise(case)
    if noise.present and "ml" in case.results and not case.reconstructed:
        case.against.setdefault("ml", noise.text)
    if "ml" not in case.credible:  # in rough air a filter that ignored a late vane had Cn_r 27 bounds off
        for method in (m for m in FILTERS if m in case.credible and case.results[m].model.output_delays):
            case.against[method] = "its filter does not correct by the late record: of little use in rough air"
    for method in (m for m in ("ml", *FILTERS) if m in case.credible):
        if contradicted := _contradicted(case, method):
            case.object_to(method, DoubtKind.DISAGREEMENT, contradicted)
        else:
            return Recommendation(method, _why(case, method, noise, tested))
    return _without_likelihood(case)


def _process_noise(case: _Case) -> ProcessNoise:
    """Whether process noise drives the residuals of output error; a doubt where it does."""
    ml = case.results.get("ml")
    for method in (m for m in FILTERS if m in case.credible):
        _doubt_innovations(case, method)
    fem = next((case.results[m] for m in FILTERS if m in case.credible), None)
    if ml is None or not ml.converged:
        return ProcessNoise(any(m in case.results for m in FILTERS), "")
    if fem is not None:
        gain = gain_of_filter(ml, fem)
        furthest = _furthest(ml, fem)
        present = gain.beyond_chance and (gain.size > NOISY or (furthest is not None and furthest[1] > DISAGREE))
        text = (
            f"process noise (gusts, or what the model lacks): filter error gains {gain.gain:.0f} in twice the log likelihood "
            f"over output error, chance {gain.chance:.0f}, and takes {1.0 - math.exp(-0.5 * gain.size):.0%} off the residuals"
        )
        if present and beneath_instruments(ml) and (furthest is None or furthest[1] <= DISAGREE):
            return ProcessNoise(False, text, BELOW_NOISE)
        noise = ProcessNoise(present, text)
    else:
        size = predictability(ml)
        text = (
            f"its residuals follow one another (the sample before predicts {1.0 - math.exp(-0.5 * size):.0%} of them): "
            "gusts, or what the model lacks, move the aircraft; estimate with --method ml,fem,ls"
        )
        noise = ProcessNoise(size > PREDICTABLE, text)
    if noise.present:
        case.doubts.append(Doubt(DoubtKind.PROCESS_NOISE, f"ml: {noise.text}"))
    return noise


def _doubt_innovations(case: _Case, method: str) -> None:
    """Object to a filter whose innovations are not white, as those of a right model are. With few measured numbers per unknown
    the gains make them white whatever the model, so too few numbers are an objection as well."""
    result = case.results[method]
    unknowns = len(result.names) + sum(len(row) for row in result.extra.get("gain", {}).values())
    numbers = sum(int(np.isfinite(f.residuals).sum()) for f in result.flights)
    if numbers < FEW * unknowns:
        text = f"{numbers} measured numbers are few for its {unknowns} unknowns, gains among them: log faster or fly longer"
        case.object_to(method, DoubtKind.COLOURED, text)
    correlations = neighbour_correlations(result)
    name, rho = max(correlations.items(), key=lambda item: abs(item[1]), default=("", 0.0))
    if abs(rho) > COLOURED:
        text = f"innovations of {name} are not white (neighbours correlate by {rho:+.2f}): the model lacks something"
        case.object_to(method, DoubtKind.COLOURED, text)


def _contradicted(case: _Case, method: str) -> str:
    """What the credible regressions say against a likelihood method; empty unless all of them contradict it.

    Each regression errs in its own way, so one that agrees outweighs one that does not. Output error and filter error are not
    compared: the test of process noise decides between them. Derivatives without a belief that are estimated as zero are not
    compared, because the error of a regression is stated relative to the value.
    """
    witnesses = [m for m in case.credible if m in REGRESSIONS]
    result, sentences = case.results[method], []
    starts = result.model.starts()
    zeros = [
        n for n, e in result.parameters.items() if not starts.get(n) and abs(e.estimate) < NEAR_ZERO * e.std_coloured
    ]
    for witness in witnesses:
        furthest = _furthest(result, case.results[witness], REGRESSIONS[witness], zeros)
        if furthest is None or furthest[1] <= DISAGREE:
            return ""
        sentences.append(f"{furthest[0]} lies {furthest[1]:.1f} joint bounds from that of {witness}")
    return " and ".join(sentences)


def _without_likelihood(case: _Case) -> Recommendation:
    """The recommendation where no likelihood method is credible: a regression that another one confirms within its bounds."""
    regressions = [m for m in case.credible if m in REGRESSIONS]
    for i, method in enumerate(regressions):
        for second in regressions[i + 1 :]:
            furthest = _furthest(case.results[method], case.results[second])
            if furthest is not None and furthest[1] <= DISAGREE:
                agree = f"{method} and {second} agree within their bounds"
                return Recommendation(
                    method, f"no likelihood method is credible here ({_objections(case)}), and {agree}"
                )
    unranked = [m for m in case.credible if m not in REGRESSIONS and m not in ("ml", *FILTERS)]
    if unranked:
        return Recommendation(unranked[0], "no check speaks against it")
    if regressions:
        reason = (
            f"{regressions[0]} takes measured motion for truth, which its bounds leave out; no other method confirms it"
        )
        return Recommendation(NO_METHOD, _joined(reason, _objections(case)))
    return Recommendation(NO_METHOD, _objections(case))


def _objections(case: _Case) -> str:
    return "; ".join(f"{m}: {reason}" for m, reason in case.against.items())


def _joined(*sentences: str) -> str:
    return "; ".join(s for s in sentences if s)


def _why(case: _Case, method: str, noise: ProcessNoise, tested: bool) -> str:
    """Why a likelihood method is recommended."""
    witnesses = [m for m in case.credible if m in REGRESSIONS]
    agree = f"it agrees with {' and '.join(witnesses)}" if witnesses else ""
    if agree and not tested:
        agree += ", which would share what the model lacks (not tested)"
    if case.reconstructed:
        return f"{case.reconstructed} reconstructed, not measured: only output error does not take them for the angles flown"
    if method in FILTERS:
        return _joined(noise.text or "its innovations are white", agree)
    if any(m in case.credible for m in FILTERS):
        quiet = noise.quiet
    else:
        quiet = "its residuals follow one another no more than noise of the inputs explains"
    return _joined(quiet, agree)


def _furthest(a: Result, b: Result, share: float = 0.0, without: Collection[str] = ()) -> tuple[str, float] | None:
    """The derivative in which two results differ most, and by how many joint bounds. share: known relative error of `b`;
    without: parameters that are not compared."""
    distances = [
        (n, abs(e.estimate - o.estimate) / joint)
        for n, e, o in _common_derivatives(a, b)
        if n not in without and (joint := math.hypot(e.std_coloured, o.std_coloured, share * o.estimate)) > 0.0
    ]
    return max(distances, key=lambda item: item[1], default=None)


def _common_derivatives(a: Result, b: Result) -> list[tuple[str, Estimate, Estimate]]:
    """Derivatives identifiable in both results. Constants are left out: methods need not agree on trim."""
    names = a.model.free_of(ParameterRole.DERIVATIVE)
    pairs = [(n, a.parameters[n], b.parameters[n]) for n in names if n in a.parameters and n in b.parameters]
    return [(n, e, o) for n, e, o in pairs if e.identifiable and o.identifiable]


# ------------------------------------------------------------------------------------------------- joint and its members


def _doubt_joint(case: _Case, method: str, joint: Result, members: Sequence[Result]) -> None:
    """Add doubts about a joint estimate: where it lies outside its members, or their scatter exceeds their bounds."""
    for name, e in joint.parameters.items():
        identifiable = [r.parameters[name] for r in members if name in r.parameters and r.converged]
        identifiable = [o for o in identifiable if o.identifiable]
        if not e.identifiable or e.local or len(identifiable) < 2:
            continue
        nearest = min(identifiable, key=lambda o: abs(o.estimate - e.estimate))
        low, high = min(o.estimate for o in identifiable), max(o.estimate for o in identifiable)
        distance = max(low - e.estimate, e.estimate - high)
        bound = math.hypot(e.std_coloured, nearest.std_coloured)
        if distance > OUTSIDE * max(e.std_coloured, nearest.std_coloured):
            place = f"outside its members ({low:.3g} to {high:.3g}) by {distance / bound:.1f} joint bounds"
            text = f"joint {name} {e.estimate:.3g} lies {place}"
            case.doubts.append(Doubt(DoubtKind.JOINT, f"{method}: {text}"))
            if distance > DISAGREE * bound:
                case.against.setdefault(method, text)
    for name, s in parameter_scatter(members).items():
        if s.text:
            case.doubts.append(Doubt(DoubtKind.SCATTER, f"{method}, {name}: {s.text}"))


def _stretched(joint: Result | None) -> list[Doubt]:
    """Doubts about a flight that moves far more than all others, to which a shared linear model extrapolates."""
    if joint is None or len(joint.flights) < 2:
        return []
    doubts = []
    for c, name in enumerate(joint.model.output_names):
        extents = [float(np.max(np.abs(_centred(joint, i, c)))) for i in range(len(joint.flights))]
        first, second = sorted(extents, reverse=True)[:2]
        if second > 0.0 and first > STRETCHED * second:
            flight = joint.flights[extents.index(first)].name
            sentence = f"{flight} moves {name} {first / second:.1f} times as far as any other flight"
            text = f"{sentence}: one linear model is stretched there"
            doubts.append(Doubt(DoubtKind.EXTRAPOLATION, text))
    return doubts


def _centred(joint: Result, flight: int, channel: int) -> np.ndarray:
    """Finite measured values about their median; one zero where there are none."""
    values = joint.flights[flight].measured[:, channel]
    finite = values[np.isfinite(values)]
    return finite - np.median(finite) if finite.size else np.zeros(1)
