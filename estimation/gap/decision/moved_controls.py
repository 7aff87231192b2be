"""Whether the user's simulation has to be evaluated again at the true deflections of the surfaces, not the recorded ones.

A simulation is evaluated, with its slopes, at the recorded surfaces. With a drag by |elevator| the slope has the wrong sign until
a late elevator crosses zero, which looks like a drag that the simulation lacks. An effect that stands alone explains everything.
"""

from estimation.gap.answer.result import GapResult, GapVerdict


def more_beside_moved_controls(result: GapResult) -> bool:
    """Whether effects were found by which a control moves otherwise than recorded, and something else was named or is unknown."""
    before, controls = set(result.model_before.transforms), {s.name for s in result.model_before.inputs if s.control}
    moved = [t for t in result.model_after.transforms if t not in before and t.input in controls]
    return bool(moved) and (len(result.steps) > 1 or result.verdict is GapVerdict.UNKNOWN)
