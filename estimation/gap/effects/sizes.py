"""Usual sizes and physical limits for the aircraft at hand.

The catalogue states sizes for the reference aircraft of docs/aircraft.md (3.5 kg, 1.5 m of span). What has no dimension (a
derivative, a factor, an angle) and what an instrument or servo has of itself (a time constant) is the same on any aircraft. A
length grows with the aircraft, a product of inertia with its mass and the square of its length, what a surface gives way with
the pressure it flies at. Lengths are measured in spans, pressures in wing loadings, times of the motion by Froude's law as
the square root of a length.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from estimation.gap.effects.base import Effect, EffectParameter
from estimation.models.base import Model

REFERENCE: Mapping[str, float] = {"m": 3.5, "b": 1.5, "S": 0.787}
"""Mass [kg], span [m] and area [m2] for which the catalogue states its sizes."""
PER_PRESSURE = "1/(200 Pa)"


def at_size_of(effects: Sequence[Effect], model: Model | None) -> tuple[Effect, ...]:
    """The effects with usual sizes and limits for the aircraft whose mass, span and area are constants of `model`; as they are
    where it has none."""
    ratio = {n: model.constants[n] / v for n, v in REFERENCE.items() if n in model.constants} if model else {}
    if len(ratio) < len(REFERENCE) or not all(0.0 < r < float("inf") for r in ratio.values()):
        return tuple(effects)
    mass, length, loading = ratio["m"], ratio["b"], ratio["m"] / ratio["S"]
    grown = {
        "m": length,
        "m/rad": length,
        "kg": mass,
        "kg m2": mass * length**2,
        "kg m2/s": mass * length**1.5,
        PER_PRESSURE: 1.0 / loading,
    }
    return tuple(_sized(e, grown) for e in effects)


def _sized(effect: Effect, grown: Mapping[str, float]) -> Effect:
    if all(grown.get(p.unit, 1.0) == 1.0 for f in effect.forms for p in f.parameters):
        return effect
    return replace(
        effect,
        forms=tuple(
            replace(f, parameters=tuple(_grown(p, grown.get(p.unit, 1.0)) for p in f.parameters)) for f in effect.forms
        ),
    )


def _grown(parameter: EffectParameter, by: float) -> EffectParameter:
    return replace(parameter, typical=by * parameter.typical, lower=by * parameter.lower, upper=by * parameter.upper)
