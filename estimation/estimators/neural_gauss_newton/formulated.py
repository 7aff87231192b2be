"""Which models Neural Gauss-Newton has a formulation for; said without loading a network."""

LATERAL, LONGITUDINAL = ("lateral", "lateral-simple"), ("longitudinal",)


def refusal(model: str) -> str:
    """Why a model of that name cannot be taken, empty where it can."""
    if model in (*LATERAL, *LONGITUDINAL):
        return ""
    return f"model {model}: Neural Gauss-Newton has a formulation for lateral, lateral-simple and longitudinal; use method ml"
