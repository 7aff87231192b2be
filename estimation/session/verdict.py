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
from estimation.session.aircraft_review import NOTHING, AircraftObjections
from estimation.session.evidence import (
    PREDICTABLE,
    ProcessNoise,
    beneath_instruments,
    corrected_states,
    gain_of_filter,
    parameter_scatter,
    predictability,
)
from estimation.session.lack_sentences import ADD, ambiguous_text, lack_text
from estimation.session.plausible_derivatives import implausible_derivatives
from estimation.session.sanity_checks import Doubt, DoubtKind, doubts_of, impossible_values
from estimation.structure.odd_flights import OddFlight
from estimation.structure.score_test import StructureTest

NOBODY = "none"
TRUST: Mapping[str, int] = {"ml": 0, "fem-noise": 1, "fem": 2, "ngn-improved": 3, "ls": 4, "ngn": 5}
"""Order of trust where nothing else decides: rms error over bound in still air, ml nearest to 1 (docs/estimation.md)."""

FILTERS = ("fem-noise", "fem")
"""Filter error: the published form first, which never failed in the flights of docs/validation.md."""

REGRESSIONS: Mapping[str, float] = {"ls": 0.15, "ngn": 0.15, "ngn-improved": 0.05}
"""Methods that take measured motion for truth -> the part of a derivative by which that is known to move it, which their
bounds leave out (docs/ngn.md: 10-15 % and 5 % against truth)."""

TRUSTED_RECONSTRUCTED = ("ml",)
"""Methods that do not take reconstructed angles for the ones flown; docs/compatibility.md has what gusts do to the others."""

NOISY = 0.6  # mean log ratio of variances, ml over fem: calm and light air up to 0.35, gusts of 0.5 deg from 0.96
COLOURED = 0.3  # correlation of neighbouring innovations: a right model leaves 0.2 at most in 60 flights
FEW = 8.0
"""Measured numbers for each unknown of a filter error, its gains among them, below which the gains take up noise of the outputs:
at five (nine of ten samples missing) roll derivatives were 3.7 bounds off; 14 s at 10 Hz have twenty."""
BENEATH = "filter error takes up less than the noise of any instrument, as in a record without noise, and agrees"
APART = 3.0  # joint bounds between two methods that should agree
COMES_OUT_AS_NONE = 3.0  # bounds from nothing, within which a derivative does
OUTSIDE = 1.0  # of its own bound that a joint estimate may lie beyond all its members
NOTABLE = 1.0  # of its bound by which a printed value has to be moved, before what moves it forbids a recommendation
EXPLAINS = 0.2  # r2 that some output has to reach: a record at rest, or of noise alone, has none
BEYOND = 1.5  # times what any other flight reached, from which a flight stretches a shared linear model


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
    """Results of one flight or of all together, as evidence is gathered. against: method -> why it is not to be believed."""

    results: Mapping[str, Result]
    against: dict[str, str] = field(default_factory=dict)
    doubts: list[Doubt] = field(default_factory=list)
    reconstructed: str = ""

    @property
    def left(self) -> list[str]:
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
    craft: AircraftObjections = NOTHING,
    structure: StructureTest | None = None,
    odd_flights: Sequence[OddFlight] = (),
    fast: Sequence[str] = (),
) -> Verdict:
    """The verdict on the results of several methods on the same data. members: of a joint estimate, each flight's by method.

    reconstructed: flow angles that the model uses and that were not measured but found from the other instruments. They lack
    the gusts: methods that take them for the angles flown miss by bounds (docs/compatibility.md), output error hardly does.
    odd: what the records themselves show to be of another unit or sign, which no result is any better than. craft: what the
    aircraft's own review says. structure: what the model lacks; odd_flights: flights that differ from the others of a joint fit.
    fast: what is over before the records of the controls can show it.
    """
    case = _Case(results, reconstructed=" and ".join(reconstructed))
    for text in craft.impossible:
        case.doubts.append(Doubt(DoubtKind.AIRCRAFT, text))
        case.against = dict.fromkeys(results, text) | case.against
    for text in (f"the aircraft file states {n}, and the model has no term for it: not used" for n in craft.dropped):
        case.doubts.append(Doubt(DoubtKind.STATED, text))
    for text in odd:
        case.doubts.append(Doubt(DoubtKind.CHANNEL, text))
        case.against = dict.fromkeys(results, text) | case.against
    if reconstructed:
        objection = (
            f"{case.reconstructed} reconstructed, not measured, without the gusts, which only output error bears"
        )
        for method in (m for m in results if m not in TRUSTED_RECONSTRUCTED):
            case.object_to(method, DoubtKind.RECONSTRUCTED, objection)
    if corrected := corrected_states(results):
        for method in (m for m in results if m in REGRESSIONS):
            case.against.setdefault(method, f"it takes records for the motion that {corrected} tells from it")
    for method, reason in (failures or {}).items():
        case.doubts.append(Doubt(DoubtKind.FAILED, f"{method}: {reason}"))
    for method, result in results.items():
        _own_doubts(case, method, result, craft.aspect)
    for method, results_of_flights in (members or {}).items():
        if method in results and len(results_of_flights) > 1:
            _members(case, method, results[method], results_of_flights)
    case.doubts += [Doubt(DoubtKind.FAST, text) for text in fast]
    if members:
        case.doubts += _stretched(next(iter(results.values()), None))
    recommendation = of_structure(_choice(case, tested=structure is not None), case.doubts, structure, odd_flights)
    return Verdict(recommendation, tuple(case.doubts))


def _own_doubts(case: _Case, method: str, result: Result, aspect: float) -> None:
    """What one result says against itself."""
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
        text = f"it explains none of the outputs (r2 {max(r2):.2f} at most): nothing here moves as the model says"
        case.object_to(method, DoubtKind.UNEXPLAINED, text)
    if not result.informative:
        case.against.setdefault(method, "it can tell none of the derivatives")


# ------------------------------------------------------------------------------------------------------------ the choice


def of_structure(
    recommendation: Recommendation,
    doubts: list[Doubt],
    structure: StructureTest | None,
    odd_flights: Sequence[OddFlight],
) -> Recommendation:
    """The recommendation in view of what the model lacks and of flights that differ; their doubts are added to `doubts`."""
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
            against = [*(t.removesuffix(advice) for t in against), text + advice]  # said once
        elif recommendation.method in FILTERS:  # which takes up whatever is left out
            against.append(f"{text}; {recommendation.method} may take that for process noise")
    for lack in ambiguous:
        text = ambiguous_text(lack)
        doubts.append(Doubt(DoubtKind.LACK, text))
    names = tuple(dict.fromkeys(n for lack in (*lacks, *ambiguous) for n in lack.names))
    if not against:
        return replace(recommendation, lacks=names) if lacks else recommendation
    reason = "; ".join(against)
    reason = reason if recommendation.method != NOBODY else _joined(reason, recommendation.why)
    return Recommendation(NOBODY, reason, names)


def _choice(case: _Case, *, tested: bool = False) -> Recommendation:
    """The method to believe. tested: what the model lacks has been looked for, so that agreement is more than a shared lack."""
    if not case.results:
        return Recommendation(NOBODY, "no method came to a result")
    noise = _process_noise(case)
    if noise.present and "ml" in case.results and not case.reconstructed:
        case.against.setdefault("ml", noise.text)
    if "ml" not in case.left:  # in rough air a filter that leaves a vane aside had Cn_r 27 bounds off
        for method in (m for m in FILTERS if m in case.left and case.results[m].model.output_delays):
            case.against[method] = "its filter leaves the record that shows late aside: of little use in rough air"
    for method in (m for m in ("ml", *FILTERS) if m in case.left):
        if contradicted := _contradicted(case, method):
            case.object_to(method, DoubtKind.DISAGREEMENT, contradicted)
        else:
            return Recommendation(method, _why(case, method, noise, tested))
    return _without_likelihood(case)


def _process_noise(case: _Case) -> ProcessNoise:
    """Whether process noise drives the residuals of output error; a doubt where it does."""
    ml = case.results.get("ml")
    for method in (m for m in FILTERS if m in case.left):
        _judge_innovations(case, method)
    fem = next((case.results[m] for m in FILTERS if m in case.left), None)
    if ml is None or not ml.converged:
        return ProcessNoise(any(m in case.results for m in FILTERS), "")
    if fem is not None:
        gain = gain_of_filter(ml, fem)
        furthest = _furthest(ml, fem)
        present = gain.beyond_chance and (gain.size > NOISY or (furthest is not None and furthest[1] > APART))
        text = (
            f"process noise (gusts, or what the model lacks): filter error gains {gain.gain:.0f} in twice the log likelihood "
            f"over output error, chance {gain.chance:.0f}, and takes {1.0 - math.exp(-0.5 * gain.size):.0%} off the residuals"
        )
        if present and beneath_instruments(ml) and (furthest is None or furthest[1] <= APART):
            return ProcessNoise(False, text, BENEATH)
        noise = ProcessNoise(present, text)
    else:
        size = predictability(ml)
        text = (
            f"its residuals follow one another ({1.0 - math.exp(-0.5 * size):.0%} of them is foretold by the sample before): "
            "gusts, or what the model lacks, move the aircraft; estimate with --method ml,fem,ls"
        )
        noise = ProcessNoise(size > PREDICTABLE, text)
    if noise.present:
        case.doubts.append(Doubt(DoubtKind.PROCESS_NOISE, f"ml: {noise.text}"))
    return noise


def _judge_innovations(case: _Case, method: str) -> None:
    """Innovations of a right model are white; where they are not, the filter has not taken up what drives the aircraft. Of few
    numbers it makes them so."""
    from estimation.session.evidence import neighbour_correlations

    result = case.results[method]
    unknowns = len(result.names) + sum(len(row) for row in result.extra.get("gain", {}).values())
    numbers = sum(int(np.isfinite(f.residuals).sum()) for f in result.flights)
    if numbers < FEW * unknowns:
        text = f"{numbers} measured numbers are few for its {unknowns} unknowns, gains among them: log faster or fly longer"
        case.object_to(method, DoubtKind.COLOURED, text)
    correlations = neighbour_correlations(case.results[method])
    name, rho = max(correlations.items(), key=lambda item: abs(item[1]), default=("", 0.0))
    if abs(rho) > COLOURED:
        text = f"innovations of {name} are not white (neighbours correlate by {rho:+.2f}): the model lacks something"
        case.object_to(method, DoubtKind.COLOURED, text)


def _contradicted(case: _Case, method: str) -> str:
    """What the sound regressions say against a likelihood that would be recommended; empty unless all of them contradict it.

    They err each in its own way, so one that agrees outweighs one that does not. Output error is no witness against a filter
    error, nor the other way round: where they differ the test of process noise has decided. Of a derivative that is added since
    nothing is believed of it, and that comes out as nothing, a regression's share of error has nothing to be a share of.
    """
    witnesses = [m for m in case.left if m in REGRESSIONS]
    result, sentences = case.results[method], []
    starts = result.model.starts()
    nothing = [
        n
        for n, e in result.parameters.items()
        if not starts.get(n) and abs(e.estimate) < COMES_OUT_AS_NONE * e.std_coloured
    ]
    for witness in witnesses:
        furthest = _furthest(result, case.results[witness], REGRESSIONS[witness], nothing)
        if furthest is None or furthest[1] <= APART:
            return ""
        sentences.append(f"{furthest[0]} lies {furthest[1]:.1f} joint bounds from that of {witness}")
    return " and ".join(sentences)


def _without_likelihood(case: _Case) -> Recommendation:
    """Where neither likelihood is to be believed: a regression that another regression confirms to within bounds alone."""
    regressions = [m for m in case.left if m in REGRESSIONS]
    for i, method in enumerate(regressions):
        for second in regressions[i + 1 :]:
            furthest = _furthest(case.results[method], case.results[second])
            if furthest is not None and furthest[1] <= APART:
                agree = f"{method} and {second} agree within their bounds"
                return Recommendation(method, f"no likelihood is to be believed here ({_said(case)}), and {agree}")
    unranked = [m for m in case.left if m not in REGRESSIONS and m not in ("ml", *FILTERS)]
    if unranked:
        return Recommendation(unranked[0], "nothing that is looked at speaks against it")
    if regressions:
        reason = f"{regressions[0]} takes measured motion for truth, which its bounds leave out; nothing confirms it"
        return Recommendation(NOBODY, _joined(reason, _said(case)))
    return Recommendation(NOBODY, _said(case))


def _said(case: _Case) -> str:
    return "; ".join(f"{m}: {reason}" for m, reason in case.against.items())


def _joined(*sentences: str) -> str:
    return "; ".join(s for s in sentences if s)


def _why(case: _Case, method: str, noise: ProcessNoise, tested: bool) -> str:
    """Why a likelihood is recommended."""
    witnesses = [m for m in case.left if m in REGRESSIONS]
    agree = f"it agrees with {' and '.join(witnesses)}" if witnesses else ""
    if agree and not tested:
        agree += ", which would share what the model lacks (not tested)"
    if case.reconstructed:
        return f"{case.reconstructed} reconstructed, not measured: only output error does not take them for the angles flown"
    if method in FILTERS:
        return _joined(noise.text or "its innovations are white", agree)
    if any(m in case.left for m in FILTERS):
        quiet = noise.quiet
    else:
        quiet = "its residuals do not follow one another more than noise of the inputs makes them"
    return _joined(quiet, agree)


def _furthest(a: Result, b: Result, share: float = 0.0, without: Collection[str] = ()) -> tuple[str, float] | None:
    """The parameter in which two results differ most, and by how many joint bounds. share: known error of `b`, of its value.
    without: parameters that are not compared."""
    distances = [
        (n, abs(e.estimate - o.estimate) / joint)
        for n, e, o in _both(a, b)
        if n not in without and (joint := math.hypot(e.std_coloured, o.std_coloured, share * o.estimate)) > 0.0
    ]
    return max(distances, key=lambda item: item[1], default=None)


def _both(a: Result, b: Result) -> list[tuple[str, Estimate, Estimate]]:
    """Derivatives that both results can tell. Constants are left out: methods need not agree on what trim is."""
    names = a.model.free_of(ParameterRole.DERIVATIVE)
    pairs = [(n, a.parameters[n], b.parameters[n]) for n in names if n in a.parameters and n in b.parameters]
    return [(n, e, o) for n, e, o in pairs if e.identifiable and o.identifiable]


# ------------------------------------------------------------------------------------------------- joint and its members


def _members(case: _Case, method: str, joint: Result, members: Sequence[Result]) -> None:
    """Doubts about a joint estimate that its members give: outside all of them, or bounds that their scatter denies."""
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
            if distance > APART * bound:
                case.against.setdefault(method, text)
    for name, s in parameter_scatter(members).items():
        if s.text:
            case.doubts.append(Doubt(DoubtKind.SCATTER, f"{method}, {name}: {s.text}"))


def _stretched(joint: Result | None) -> list[Doubt]:
    """Flights that move far beyond all others, which a shared linear model then extrapolates to."""
    if joint is None or len(joint.flights) < 2:
        return []
    doubts = []
    for c, name in enumerate(joint.model.output_names):
        extents = [float(np.max(np.abs(_centred(joint, i, c)))) for i in range(len(joint.flights))]
        first, second = sorted(extents, reverse=True)[:2]
        if second > 0.0 and first > BEYOND * second:
            flight = joint.flights[extents.index(first)].name
            sentence = f"{flight} moves {name} {first / second:.1f} times as far as any other flight"
            text = f"{sentence}: one linear model is stretched there"
            doubts.append(Doubt(DoubtKind.EXTRAPOLATION, text))
    return doubts


def _centred(joint: Result, flight: int, channel: int) -> np.ndarray:
    values = joint.flights[flight].measured[:, channel]
    finite = values[np.isfinite(values)]
    return finite - np.median(finite) if finite.size else np.zeros(1)
