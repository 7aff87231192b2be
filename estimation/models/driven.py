"""Which states of a model forces and moments drive, and which only follow from others."""

from collections.abc import Collection

from estimation.models.base import Model
from estimation.models.expressions import names_in


def force_states(model: Model, parameters: Collection[str] | None = None) -> tuple[str, ...]:
    """States whose rate depends on a parameter: forces and moments act there, not in mere kinematics.

    parameters: those that count; by default all of the model's.
    """
    counted = set(model.parameter_names if parameters is None else parameters)

    def reach(symbol: str, seen: set[str]) -> set[str]:
        for name in names_in(model.definitions[symbol]) if symbol in model.definitions else ():
            if name not in seen:
                seen.add(name)
                reach(name, seen)
        return seen

    return tuple(s for s in model.state_names if reach(f"{s}_dot", set()) & counted)
