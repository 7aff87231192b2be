"""The verdict in words a flight-test engineer can act on."""

from collections.abc import Mapping, Sequence

from estimation.gap.answer.result import Step, Verdict
from estimation.gap.effects.base import Effect

EXAMPLES = (
    "Cn_da",
    "CY_da",
    "beta_lag",
    "Cl_beta3",
    "aileron_delay",
    "p_sin_alpha",
)  # of sizes that would have been seen
FEW, NAMES, MANOEUVRES = 4, 8, 3  # examples, effects and manoeuvres in one paragraph; the JSON file has all


def describe_step(step: Step) -> str:
    """One or two sentences on one effect."""
    if step.effect == "unknown":
        return (
            f"Something the catalogue does not hold: it lives in {', '.join(step.where.channels)} ({step.where.regime})"
            + (
                f", for example at {step.where.segments[0][0]:.1f} to {step.where.segments[0][1]:.1f} s"
                if step.where.segments
                else ""
            )
            + ". No name is given, because none explains enough of it."
        )
    numbers = ", ".join(
        f"{n} = {v:.4g} +- {s:.2g} {step.units.get(n, '')}".rstrip() for n, (v, s) in step.estimates.items()
    )
    text = (
        f"{step.title} ({step.effect}: {numbers}), score {step.score:.1f} against a threshold of {step.threshold:.1f}."
    )
    if step.followed:
        moved = " and ".join(f"{n} by {1e3 * v:.0f} ms" for n, v in step.followed.items())
        text += f" Without it the base moves {moved} to follow; the gap before it is counted without that."
    if len(step.members) > 1:
        others = " or ".join(f"{m.effect} ({m.weight:.2f})" for m in step.members)
        text += f" These flights cannot tell {others} apart; to separate them: {step.separate_by}."
    return text


def conclude(
    verdict: Verdict,
    steps: Sequence[Step],
    detectable: Mapping[str, float],
    cannot: Sequence[Effect],
    tied: Sequence[Effect],
    holdout: bool,
    odd: Sequence[str] = (),
) -> str:
    """The paragraph of the verdict. odd: training flights that do not repeat the others."""
    parts = []
    if verdict is Verdict.NO_GAP:
        parts.append(
            "No effect found: what is left of the disagreement looks like the noise, gusts and input errors of these flights."
        )
        if detectable:
            some = [f"{n} of {detectable[n]:.2g}" for n in EXAMPLES if n in detectable][:FEW]
            if some:
                parts.append(f"Anything larger than for example {', '.join(some)} would have been seen.")
    elif verdict is Verdict.CANNOT_TELL:
        parts.append(
            "No effect found, but these flights could not have shown many of them: they hardly excite the motion."
        )
    parts += [s.text for s in steps]
    if steps and not holdout:
        parts.append(
            "No held-out flight was given, so the better model is not confirmed on data it has not seen: "
            "fly one more of the same kind."
        )
    if odd:
        parts.append(
            f"{' and '.join(odd)} {'does' if len(odd) == 1 else 'do'} not repeat the other training flights even with this "
            "model: look at that flight (weather, instruments, configuration) before relying on the joint fit."
        )
    if cannot:
        names = ", ".join(e.name for e in cannot[:NAMES]) + (
            f" and {len(cannot) - NAMES} more" if len(cannot) > NAMES else ""
        )
        wanted = list(dict.fromkeys(e.separate_by for e in cannot))[:MANOEUVRES]
        parts.append(f"These flights cannot tell anything about {names} at their usual size; fly {'; '.join(wanted)}.")
    if tied and verdict in (Verdict.NO_GAP, Verdict.CANNOT_TELL):
        parts.append(
            "Not visible in any flight: "
            + "; ".join(f"{e.name} cannot be told from {', '.join(e.tied_to)}" for e in tied)
            + "; errors of mass, of Ixx and Izz or of air density scale all coefficients alike and cannot be told from them."
        )
    return " ".join(parts)
