"""Whether a simulation has to be asked again where the control surfaces were, and not where the record has them.

A simulation is evaluated at the surfaces as recorded, with its slopes there. Of a drag by |elevator| that is wrong in sign while
a late elevator has not crossed zero yet, and looks like a drag that the simulation lacks. One that stands alone explains all.
"""

from estimation.gap.answer.result import GapResult, GapVerdict


def more_beside_moved_controls(result: GapResult) -> bool:
    """Whether effects were found by which a control moves otherwise than recorded, and anything was named or left beside them."""
    before, controls = set(result.model_before.transforms), {s.name for s in result.model_before.inputs if s.control}
    moved = [t for t in result.model_after.transforms if t not in before and t.input in controls]
    return bool(moved) and (len(result.steps) > 1 or result.verdict is GapVerdict.UNKNOWN)
