"""Which models Neural Gauss-Newton has a formulation for; said without loading a network."""

from collections.abc import Collection

from estimation.models.library import LATERAL_DERIVATIVES, LONGITUDINAL_DERIVATIVES

LATERAL, LONGITUDINAL = ("lateral", "lateral-simple"), ("longitudinal",)


def refusal(model: str, parameters: Collection[str] | None = None) -> str:
    """Why a model of that name, and with those parameters, cannot be taken; empty where it can."""
    if model not in (*LATERAL, *LONGITUDINAL):
        known = "lateral, lateral-simple and longitudinal"
        return f"model {model}: Neural Gauss-Newton has a formulation for {known}; use method ml"
    usual = LATERAL_DERIVATIVES if model in LATERAL else LONGITUDINAL_DERIVATIVES
    if parameters is not None and (more := [n for n in parameters if n not in usual]):
        return f"model {model}: Neural Gauss-Newton has no formulation with {', '.join(more)}; use method ml"
    return ""
