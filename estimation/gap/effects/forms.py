"""Forms that many effects share: one coefficient times a regressor, one transform of a control, one change of an instrument."""

from estimation.gap.effects.base import EffectParameter, Form
from estimation.models.base import InputTransform, Signal


def one_term(
    name: str,
    line: str,
    term: str,
    typical: float,
    reach: float,
    meaning: str,
    unit: str = "1/rad",
    requires: tuple[str, ...] = (),
    inputs: tuple[Signal, ...] = (),
) -> tuple[Form, ...]:
    """`name` times `term` added to one line; reach: largest magnitude that is physically possible."""
    parameter = EffectParameter(name, unit, typical, -reach, reach, meaning=meaning)
    return (Form(name, (parameter,), terms={line: (f"{name}*{term}",)}, inputs=inputs, requires=(line, *requires)),)


def one_transform(
    name: str, kind: str, of: str, unit: str, typical: float, upper: float, meaning: str
) -> tuple[Form, ...]:
    """A delay, lag, play or rate limit of one input; without effect at 0 and never below."""
    parameter = EffectParameter(name, unit, typical, 0.0, upper, meaning=meaning)
    return (Form(name, (parameter,), transforms=(InputTransform(kind, of, (name,)),), requires=(of,)),)


def one_reading(
    name: str,
    outputs: dict[str, str],
    unit: str,
    typical: float,
    reach: float,
    meaning: str,
    requires: tuple[str, ...] = (),
    label: str = "",
) -> Form:
    """An instrument that shows something else than what is there."""
    parameter = EffectParameter(name, unit, typical, -reach, reach, meaning=meaning)
    return Form(label or name, (parameter,), outputs=outputs, requires=requires)
