"""Sentences of the verdict on terms that a model lacks, and on added terms that a rival explains as well."""

from estimation.structure.candidates import CandidateKind
from estimation.structure.score_test import Lack

NEGATIVE = {
    CandidateKind.LATE_CONTROL: " (below zero: the motion is there before the record of the control)",
    CandidateKind.LATE_SENSOR: " (below zero: the other channels are late)",
}
ADD = "; add it with: --structure auto"


def lack_text(lack: Lack) -> str:
    """What the model lacks, with its score, its size and what leaving it out moves."""
    leading = lack.leading
    name, bounds = leading.worst
    rivals = (
        f" (or {', '.join(r.candidate.phrase for r in lack.rivals)}: these flights cannot tell which)"
        if lack.rivals
        else ""
    )
    size = f"{leading.value:.3g} {leading.candidate.parameter.unit}".removesuffix(" 1")
    if leading.value < 0.0:
        size += NEGATIVE.get(leading.candidate.kind, "")
    moves = f"leaving it out moves {name} by {bounds:.1f} of its bounds" if name else "it moves nothing that is printed"
    if not lack.possible:
        return (
            f"something is left out that is none of what was tested: score {abs(leading.score):.1f} where chance reaches"
            f" {leading.threshold:g} for {leading.candidate.phrase}, which would have to be {size}; {moves}; see whether"
            " a channel is filtered, clipped or of another axis"
        )
    return (
        f"the model lacks {leading.candidate.phrase}{rivals}: score {abs(leading.score):.1f} where chance reaches"
        f" {leading.threshold:g}, about {size}; {moves}"
    )


def ambiguous_text(lack: Lack) -> str:
    """What was added, what would explain the flights as well, and how to separate the two."""
    leading = lack.leading.candidate
    rivals = ", ".join(f"{r.candidate.phrase} ({r.candidate.name} = {r.value:.3g})" for r in lack.rivals)
    return (
        f"{leading.name} was added (score {abs(lack.leading.score):.1f}), but {rivals} instead explains these flights as well"
        f" and moves estimates by up to {lack.largest_difference:.1f} of their bounds, which the bounds now span: to tell them,"
        f" state {leading.name} in the aircraft file, measure the other (a swing test for inertia), or fly a symmetric pull-up"
        " with aileron 3-2-1-1"
    )
