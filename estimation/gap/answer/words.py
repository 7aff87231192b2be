"""The answer in words that a flight-test engineer can act on."""

from collections.abc import Mapping, Sequence

from estimation.gap.answer.result import EffectStep, Gap, GapVerdict, Rejected
from estimation.gap.answer.shape import (
    TURN,
    EventReport,
    Happened,
    HeldInstrument,
    LaggedTerm,
    NotPredicted,
    ShapeCurve,
    SwingingTerm,
)
from estimation.gap.effects.base import Effect

EXAMPLES = ("Cn_da", "CY_da", "beta_lag", "Cl_beta3", "aileron_delay", "p_sin_alpha")
"""Effects with which the paragraph shows what size would have been seen."""
FEW, NAMES, MANOEUVRES = 4, 8, 3  # examples, effects and manoeuvres in one paragraph; the JSON file has all


def describe_step(step: EffectStep) -> str:
    """One or two sentences on one effect."""
    if step.effect == "unknown":
        return describe_unknown(step)
    numbers = ", ".join(f"{_with_bound(n, e)} {step.units.get(n, '')}".rstrip() for n, e in step.estimates.items())
    label = step.effect if step.form in (step.effect, *step.estimates) else f"{step.effect}, {step.form}"
    text = f"{step.title} ({label}: {numbers}), score {step.score:.1f} against a threshold of {step.threshold:.1f}."
    if step.sampling_bound:
        text += f" Of that bound {1e3 * step.sampling_bound:.2g} ms is what sampling leaves open of any time."
    if step.followed:
        shifts = " and ".join(f"{n} by {1e3 * v:.0f} ms" for n, v in step.followed.items())
        text += f" Without it the base moves {shifts} to follow; the gap before it is counted without that."
    if step.gap.says_nothing:
        text += course_stands_out(step.gap)
    if step.holdout is not None and step.holdout.says_nothing:
        text += not_in_held_out_gap(step.holdout)
    if len(step.members) > 1:
        rivals = " or ".join(f"{m.effect} ({m.weight:.2f})" for m in step.members)
        text += f" These flights cannot tell {rivals} apart; to separate them: {step.separate_by}."
    return text


def _with_bound(name: str, estimate: tuple[float, float]) -> str:
    value, std = estimate
    return f"{name} = {value:.4g} +- {std:.2g}"


def not_in_held_out_gap(held: Gap) -> str:
    """A sentence on held-out flights whose gap does not show an effect."""
    text = f" The held-out flights did not show it in their gap ({held.before:.2f}, up to {held.highest:.2f} with nothing hidden)"
    if held.grows and held.before > held.highest:
        text = f" The gap of the held-out flights grows ({held.before:.2f} to {held.after:.2f}), as slow errors of gusts make it"
    if held.confirmed is None:
        return f"{text}: the share closed there speaks neither for it nor against it."
    return f"{text}; by their likelihood they confirm {held.confirmed:.0%} of what it predicts for them."


def describe_unknown(step: EffectStep) -> str:
    """What is known of an effect that the catalogue does not hold."""
    shape = step.shape
    if isinstance(shape, ShapeCurve):
        return describe_curve(shape)
    if isinstance(shape, Happened):
        return describe_events(shape)
    if isinstance(shape, HeldInstrument):
        return describe_held(shape)
    if isinstance(shape, NotPredicted):
        return f"The training flights show nothing, but {describe_not_predicted(shape)}"
    channels, regime = ", ".join(step.where.channels), step.where.regime
    place = f"it lives in {channels} ({regime})" if channels else "no channel shows it alone"
    text = f"Something the catalogue does not hold: {place}{_example(step.where.segments)}. "
    text += "No name is given, because none explains enough of it."
    if step.gap.within_floor:
        text += course_stands_out(step.gap)
    if isinstance(shape, LaggedTerm):
        text += (
            f" No function of the motion closes the gap either; a part of {shape.line} that follows {shape.variable} some "
            f"{shape.time:.2g} s late gains (score {shape.score:.1f} against {shape.threshold:.1f})."
        )
    if isinstance(shape, SwingingTerm):
        text += f" {describe_swing(shape)}"
    return text


def _example(segments: Sequence[tuple[float, float]]) -> str:
    return f", for example at {segments[0][0]:.1f} to {segments[0][1]:.1f} s" if segments else ""


def course_stands_out(gap: Gap) -> str:
    """A sentence on an effect that is certain although flights with nothing hidden have such a gap too."""
    usual = f"{gap.floor:.3g}" if gap.within_floor else f"up to {gap.highest:.3g}"
    return (
        f" Its size is no larger than gusts and errors of the inputs leave (a gap of {gap.before:.3g}, "
        f"{usual} with nothing hidden): its course stands out."
    )


def describe_swing(swing: SwingingTerm) -> str:
    """What swings, how fast, and where to look."""
    hertz, std = swing.frequency / TURN, swing.frequency_std
    fast = f"{hertz:.2g} Hz" if std is None else f"{hertz:.3g} +- {std / TURN:.1g} Hz"
    return (
        f"A part of {swing.line} that goes on swinging at {fast} with a damping of {swing.damping:.2g}, driven by "
        f"{' and '.join(swing.by)}, gains (score {swing.score:.1f} against {swing.threshold:.1f}): look for what can move or "
        "bend in the airframe at that frequency (tap it, fly it with the tank full and empty, film it)."
    )


def describe_curve(curve: ShapeCurve) -> str:
    """A curve in words: where, how certain, in which range, and what would settle it."""
    dependence = " times ".join((f"a function of {curve.variables[0]}", *curve.variables[1:]))
    subject = "that no effect of the catalogue stands for" if curve.alike else "the catalogue does not hold"
    text = (
        f"Something {subject}, and no physical name is given to it: "
        f"a part of {curve.output} that is {dependence}, known from {curve.low:.3g} to {curve.high:.3g} {curve.unit} and held "
        f"outside ({curve.regime}). It closes {curve.closed:.0%} of the gap above what nothing hidden would leave, with "
        "residuals weighed by their noise."
    )
    formulas = [
        f"{formula} with {', '.join(_with_bound(n, e) for n, e in estimates.items())}"
        for formula, estimates, _, as_good in curve.candidates
        if as_good
    ]
    if formulas:
        text += f" As good as the curve: {' or '.join(formulas)}."
    else:
        text += " No plain formula does as well as the curve."
    for a in curve.alike:
        value, std = a.estimate
        text += f" {a.effect} ({a.title}) has that form and would be {value:.4g} +- {std:.2g} {a.unit}; {a.why_not}."
    if curve.rivals:
        rivals = " or ".join(f"{o} by {' times '.join(v)} ({g:.2f} of the gain)" for o, v, g in curve.rivals)
        text += f" Nearly as well: {rivals}."
    return f"{text} To settle it: {curve.separate_by}."


def describe_events(happened: Happened) -> str:
    """Which events, when, and that they are no term of the model."""
    events = "; ".join(_event(e) for e in happened.events)
    return (
        f"Something that goes with time and not with the motion: {events}. Without it nothing is left that a term of the model "
        "would have to explain: no model term is wrong. Look at the instrument or the weather there, or leave the stretch out."
    )


def _event(e: EventReport) -> str:
    place = f"on {e.flight}" if e.flight else "on these flights"
    size = f"{', '.join(f'{v:.2g} +- {s:.1g}' for v, s in e.sizes)} {e.unit}"
    span = f"from {e.start:.1f} to {e.end:.1f} s"
    if e.air:
        return f"a gust changes {e.air} {place} {span} by up to {size}"
    return {
        "drift": f"{e.channel} drifts {place} by {size} over each",
        "slip": f"{e.channel} jumps {place} at {e.start:.1f} s by {size}",
        "burst": f"the motion is disturbed {place} {span}, as by a gust",
    }[e.what]


def describe_held(held: HeldInstrument) -> str:
    """Which instrument holds its values, for how long, and that this is no term of the model."""
    return (
        f"{held.channel} holds its values: a new one comes every {held.every:.2g} s, and at the {held.share:.0%} of the samples "
        f"that repeat the last it is {held.ratio:.1f} times as far from the model as at new ones. At new ones nothing is left "
        "that a term of the model would have to explain: no model term is wrong. Look at the instrument and what reads it; where "
        "it is known to be that slow, there is no gap."
    )


def describe_not_predicted(unlike: NotPredicted) -> str:
    """Which held-out flight the model misses, by how much and where, and what to look at; begins in lower case."""
    place = f", mostly in {' and '.join(unlike.channels)}" if unlike.channels else ""
    return (
        f"the model does not predict the held-out {unlike.flight}: a gap of {unlike.gap:.3g}, up to {unlike.highest:.3g} with "
        f"nothing hidden{place}{_example(unlike.segments)}. Look at the instruments, the signs and the configuration of "
        f"{unlike.flight} before anything is concluded from it."
    )


def unconfirmed_in_words(rejected: Sequence[Rejected]) -> str:
    """A sentence on effects that only the held-out flights speak against; empty without any."""
    reasons = [f"{r.effect} {r.why}" for r in rejected if r.unconfirmed]
    if not reasons:
        return ""
    return (
        f"On the training flights something stands out that these do not confirm ({', '.join(dict.fromkeys(reasons))}): fly once "
        "more before you rely on there being no gap."
    )


def conclude(
    verdict: GapVerdict,
    steps: Sequence[EffectStep],
    detectable: Mapping[str, float],
    cannot: Sequence[Effect],
    tied: Sequence[Effect],
    holdout: bool,
    odd: Sequence[str] = (),
    stale: Sequence[str] = (),
    following: Sequence[str] = (),
    left: str = "",
    flights: int = 0,
    inputs: str = "",
    unlike: str = "",
) -> str:
    """The paragraph of the verdict.

    detectable: effect -> smallest size that would have been seen. cannot: effects that these flights could not show. tied:
    effects that no flight can tell from parameters of the base. odd: those of the `flights` training flights that do not repeat
    the others. stale: outputs that repeat their last value in many samples. following: controls that only follow the motion.
    left: the unexplained rest beside a shape, in words. inputs: sentence from `rest_of_inputs`. unlike: from
    `describe_not_predicted`.
    """
    parts = []
    if verdict is GapVerdict.NO_GAP:
        parts.append(
            "No effect found: what is left of the disagreement looks like the noise, gusts and input errors of these flights."
        )
        examples = [f"{n} of {detectable[n]:.2g}" for n in EXAMPLES if n in detectable][:FEW]
        if examples:
            parts.append(f"Anything larger than for example {', '.join(examples)} would have been seen.")
    elif verdict is GapVerdict.CANNOT_TELL and inputs:
        parts.append(f"No effect found: {inputs}")
    elif verdict is GapVerdict.CANNOT_TELL:
        parts.append(
            "No effect found, but these flights could not have shown many of them: they hardly excite the motion."
        )
    parts += [s.text for s in steps]
    if inputs and verdict is not GapVerdict.CANNOT_TELL:
        parts.append(f"Beside this, {inputs}")
    if unlike:
        parts.append(f"And {unlike}")
    if left:
        parts.append(f"Beside all this something is left that is not explained ({left}).")
    if steps and not holdout:
        parts.append(
            "No held-out flight was given, so the better model is not confirmed on data it has not seen: "
            "fly one more of the same kind."
        )
    if odd:
        none_repeats = len(odd) == flights
        explains = none_repeats or verdict is GapVerdict.UNKNOWN  # then it is the first place to look
        parts.insert(0 if explains else len(parts), odd_in_words(odd, none_repeats))
    if stale:
        parts.append(
            f"{' and '.join(stale)} repeat{'s' if len(stale) == 1 else ''} the last value in many samples (a stale, slow or "
            "coarsely rounded sensor): an error of the instrument, which no term of the model has to explain."
        )
    if following:
        verb = "rests or only follows" if len(following) == 1 else "rest or only follow"
        parts.append(
            f"{' and '.join(following)} {verb} the motion, as a pilot or an autopilot steers: answered gusts look like terms of "
            "the model, and these flights do not show when and how far the surface moves; move it by itself, in steps."
        )
    if cannot:
        names, whose = ", ".join(e.name for e in cannot[:NAMES]), "its" if len(cannot) == 1 else "their"
        more = f" and {len(cannot) - NAMES} more" if len(cannot) > NAMES else ""
        manoeuvres = list(dict.fromkeys(e.separate_by for e in cannot if e.separate_by))[:MANOEUVRES]
        fly = f"; fly {'; '.join(manoeuvres)}" if manoeuvres else ""
        parts.append(f"These flights cannot tell anything about {names}{more} at {whose} usual size{fly}.")
    if tied and verdict in (GapVerdict.NO_GAP, GapVerdict.CANNOT_TELL):
        hidden = [f"{e.name} cannot be told from {', '.join(e.tied_to)}" for e in tied]
        if all(e.name != "rho_error" for e in tied):  # lateral: only the derivatives carry mass and density
            hidden.append(
                "errors of mass, of Ixx and Izz or of air density scale all coefficients alike and cannot be told from them"
            )
        parts.append(f"Not visible in any flight: {'; '.join(hidden)}.")
    return " ".join(parts)


def rest_of_inputs(commanded: Mapping[str, float], what: str, score: float, threshold: float) -> str:
    """A sentence: `what` cannot be told from errors of surfaces that are recorded as commands. commanded: control -> interval [s]
    of its records."""
    are = "are known by commands" if len(commanded) > 1 else "is known by commands"
    return (
        f"{' and '.join(commanded)} {are} that the log has every {1e3 * max(commanded.values()):.0f} ms, each move at an unknown "
        f"time within that, and what this leaves wrong looks like {what} (score {score:.1f} where "
        f"{threshold:.1f} is chance): no effect is named for that, and no smaller one can be seen. Log the servo outputs "
        "as often as the gyros, or measure the surfaces."
    )


def odd_in_words(odd: Sequence[str], none_repeats: bool) -> str:
    """A sentence on training flights that do not repeat the others. none_repeats: not one does, and the joint fit describes no
    aircraft."""
    if none_repeats:
        return (
            "No training flight repeats the others even with this model: each has derivatives of its own, and what stands below "
            "may stand for what differs between them (Mach number, mass, centre of gravity, flaps, a damper). Give flights of "
            "one regime together."
        )
    verb, them = ("does", "that flight") if len(odd) == 1 else ("do", "those flights")
    return (
        f"{' and '.join(odd)} {verb} not repeat the other training flights even with this model: look at {them} (weather, "
        "instruments, configuration) before relying on the joint fit."
    )
