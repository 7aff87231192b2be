"""The catalogue: built-in effects, extended by installed packages, by files that a person names and by what a model lacks.

A laboratory adds effects in a TOML file with the fields of `Effect` and `Form` (data only, nothing is executed), like the
built-in ones beside this module; in a Python file with a tuple `EFFECTS`; or in a package with an entry point of the group
`sideslip.effects`.
"""

import importlib.metadata
import importlib.util
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

from daq.utilities.input_files import read_toml
from daq.utilities.plain_words import did_you_mean
from estimation.errors import EffectError, ModelError
from estimation.gap.effects.base import Effect, EffectParameter, Form, Group
from estimation.models.base import InputTransform, Model, Signal
from estimation.models.expressions import parse
from estimation.own_code import mistake_text

ENTRY_POINTS = "sideslip.effects"
LARGEST_NUMBER = 1e12  # for a bound or size in any SI unit: no quantity of an aircraft comes near it
LATERAL_LINES, LONGITUDINAL_LINES = frozenset({"CY", "Cl", "Cn"}), frozenset({"CL", "CD", "Cm"})
REFERENCE: Mapping[str, float] = {"m": 3.5, "b": 1.5, "S": 0.787}
"""Mass [kg], span [m] and area [m2] of the aircraft for which the catalogue states its sizes (docs/aircraft.md)."""
PER_PRESSURE = "1/(200 Pa)"


@cache
def plane(name: str) -> tuple[Effect, ...]:
    """Built-in effects of one file: lateral, longitudinal (with effects of the other files that act in pitch too) or
    across_axes."""
    effects = _from_toml(Path(__file__).with_name(f"{name}.toml"), may_lack_forms=True)
    if name == "longitudinal":
        effects += tuple(e for e in plane("across_axes") if e.name == "pitch_inertial_coupling")
        effects += tuple(e for e in plane("lateral") if e.name == "gust")
    return effects


def built_in(model: Model | None = None) -> tuple[Effect, ...]:
    """The built-in effects of the axes that `model` has: lateral (also without a model), longitudinal, or both with their
    coupling. Where two files have an effect of the same name, that of `across_axes` counts."""
    lines = frozenset(model.definitions) if model is not None else frozenset()
    if not lines & LONGITUDINAL_LINES:
        return plane("lateral")
    if not lines & LATERAL_LINES:
        return plane("longitudinal")
    # with roll and yaw in the equations the term p r shows Iyy, which the Cm_* absorb otherwise
    free = tuple(replace(e, tied_to=()) if e.name == "Iyy_error" else e for e in plane("longitudinal"))
    return tuple({e.name: e for e in (*plane("lateral"), *free, *plane("across_axes"))}.values())


def catalogue(extra_files: Iterable[str | Path] = (), model: Model | None = None) -> tuple[Effect, ...]:
    """Built-in effects of the axes of `model` (default lateral), scaled to its aircraft; then those of installed packages and of
    `extra_files`, unscaled. A later effect replaces an earlier one of the same name.

    Raises EffectError naming the file and key that does not fit.
    """
    effects = [*at_size_of(built_in(model), model)]
    for point in importlib.metadata.entry_points(group=ENTRY_POINTS):
        effects += _checked(point.load(), f"entry point {point.name}")
    for path in extra_files:
        effects += load_effects(path)
    return tuple({e.name: e for e in effects}.values())


def at_size_of(effects: Sequence[Effect], model: Model | None) -> tuple[Effect, ...]:
    """The effects with usual sizes and limits scaled to the aircraft whose mass, span and area are constants of `model`; unscaled
    where the model lacks them.

    Dimensionless parameters and time constants of instruments and servos are the same on any aircraft. Lengths scale with the
    span, pressures with the wing loading, times of the motion with the square root of a length (Froude).
    """
    ratio = {n: model.constants[n] / v for n, v in REFERENCE.items() if n in model.constants} if model else {}
    if len(ratio) < len(REFERENCE) or not all(0.0 < r < float("inf") for r in ratio.values()):
        return tuple(effects)
    mass, length, loading = ratio["m"], ratio["b"], ratio["m"] / ratio["S"]
    growth = {
        "m": length, "m/rad": length, "kg": mass, "kg m2": mass * length**2, "kg m2/s": mass * length**1.5,
        PER_PRESSURE: 1.0 / loading,
    }  # fmt: skip

    def sized(p: EffectParameter) -> EffectParameter:
        factor = growth.get(p.unit, 1.0)
        return replace(p, typical=factor * p.typical, lower=factor * p.lower, upper=factor * p.upper)

    return tuple(
        replace(e, forms=tuple(replace(f, parameters=tuple(map(sized, f.parameters))) for f in e.forms))
        for e in effects
    )


def load_effects(path: str | Path) -> tuple[Effect, ...]:
    """Effects of one .toml or .py file."""
    path = Path(path)
    if not path.is_file():
        raise EffectError(f"effects {path}: no such file")
    if path.suffix == ".toml":
        return _from_toml(path)
    if path.suffix == ".py":
        spec = importlib.util.spec_from_file_location(f"sideslip_effects_{path.stem}", path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        try:
            spec.loader.exec_module(module)
        except SystemExit as end:
            raise EffectError(f"effects {path}: it ends Python (exit {end.code}) in place of giving EFFECTS") from end
        except Exception as mistake:
            raise EffectError(f"effects {path}: cannot be run: {mistake_text(mistake)}") from mistake
        if not isinstance(getattr(module, "EFFECTS", None), tuple | list):
            raise EffectError(f"effects {path}: no tuple EFFECTS in it")
        return _checked(module.EFFECTS, str(path))
    raise EffectError(f"effects {path}: give a .toml or a .py file")


def _checked(loaded: Any, where: str) -> tuple[Effect, ...]:
    effects = tuple(loaded)
    for effect in effects:
        if not isinstance(effect, Effect):
            raise EffectError(f"{where}: EFFECTS holds {effect!r}, which is no Effect")
    return _each_once(effects, where)


def _each_once(effects: tuple[Effect, ...], where: str) -> tuple[Effect, ...]:
    """The effects; EffectError where two have the same name: the first would be lost."""
    names = [e.name for e in effects]
    if twice := [n for n in names if names.count(n) > 1]:
        raise EffectError(f"{where}: two effects are called {twice[0]!r}; give each a name of its own")
    return effects


def _from_toml(path: Path, may_lack_forms: bool = False) -> tuple[Effect, ...]:
    data = read_toml(path, "file", EffectError)
    tables = data.get("effect")
    if not isinstance(tables, list) or not tables:
        raise EffectError(f"effects {path}: write each effect as a table [[effect]]")
    try:
        return _each_once(tuple(_effect(table, may_lack_forms) for table in tables), f"effects {path}")
    except KeyError as error:
        raise EffectError(f"effects {path}: the key {error} is missing in one of its tables") from error
    except (TypeError, ValueError, AttributeError, ModelError) as error:
        raise EffectError(f"effects {path}: {error}") from error


def _effect(table: Mapping[str, Any], may_lack_forms: bool) -> Effect:
    data = dict(table)
    for key in ("name", "title"):
        if key not in data:
            raise EffectError(f"effect {data.get('name')!r}: the key {key!r} is missing{did_you_mean(key, data)}")
    forms = tuple(_form(f, data.get("name", "")) for f in data.pop("form", []))
    if not forms and not may_lack_forms:
        raise EffectError(f"effect {data.get('name')!r}: at least one [[effect.form]] is needed")
    texts = {k: str(data.pop(k, "")) for k in ("physics", "equation", "source", "signature", "separate_by", "family")}
    effect = Effect(
        name=data.pop("name"),
        title=data.pop("title"),
        group=Group(data.pop("group", Group.DERIVATIVE)),
        confusions=dict(data.pop("confusions", {})),
        forms=forms,
        tied_to=tuple(data.pop("tied_to", ())),
        **texts,
    )
    if data:
        raise EffectError(f"effect {effect.name!r}: unknown key {next(iter(data))!r}")
    return effect


def _parameter(table: Mapping[str, Any]) -> EffectParameter:
    """An unknown of a form. Raises ValueError where a number is none or too large, or the limits enclose nothing."""
    parameter = EffectParameter(**table)
    numbers = {"typical": parameter.typical, "lower": parameter.lower, "upper": parameter.upper}
    numbers |= {} if isinstance(parameter.none, str) else {"none": parameter.none}
    for key, value in numbers.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= LARGEST_NUMBER:
            raise ValueError(
                f"parameter {str(parameter.name)[:80]!r}: {key} = {str(value)[:40]!r} is not a number up to {LARGEST_NUMBER:g}"
            )
    if not parameter.lower < parameter.upper or not parameter.typical > 0.0:
        raise ValueError(f"parameter {str(parameter.name)[:80]!r}: lower must be below upper, and typical above 0")
    if not all(isinstance(text, str) for text in (parameter.name, parameter.unit, parameter.meaning)):
        raise ValueError(f"parameter {str(parameter.name)[:80]!r}: name, unit and meaning are texts")
    return parameter


def _form(table: Mapping[str, Any], effect: str) -> Form:
    """A form from its TOML table; its label defaults to the effect's name."""
    data = {key: FIELDS[key](value) if key in FIELDS else value for key, value in table.items()}
    for piece in (p for pieces in data.get("terms", {}).values() for p in pieces):
        parse(piece)
    for output in data.get("optional", ()):
        if output not in {**data.get("outputs", {}), **data.get("output_delays", {})}:
            raise ValueError(f"optional {output!r} is none of the form's outputs or output_delays")
    return Form(data.pop("label", effect), data.pop("parameters"), **data)


def _signals(tables: Iterable[Mapping[str, Any]]) -> tuple[Signal, ...]:
    return tuple(Signal(**table) for table in tables)


FIELDS: Mapping[str, Callable[[Any], Any]] = {
    "equation": str,
    "parameters": lambda tables: tuple(_parameter(t) for t in tables),
    "terms": lambda lines: {line: (v,) if isinstance(v, str) else tuple(v) for line, v in lines.items()},
    "lines": tuple,
    "outputs": dict,
    "states": _signals,
    "inputs": _signals,
    "transforms": lambda tables: tuple(InputTransform(t["kind"], t["input"], tuple(t["parameters"])) for t in tables),
    "output_delays": dict,
    "requires": tuple,
    "unless": lambda pairs: tuple((line, symbol) for line, symbol in pairs),
    "optional": tuple,
}
"""Field of a form -> how it is read from TOML; others stay as they are."""


# ------------------------------------------------------------------------------------------------ derivatives that a model lacks

LINEAR_TERMS: tuple[tuple[Mapping[str, str], Mapping[str, tuple[str, str, str]]], ...] = (
    (
        {"CY": "side force", "Cl": "rolling moment", "Cn": "yawing moment"},
        {
            "beta": ("beta", "β", "sideslip"), "p": ("p_hat", "p", "roll rate"), "r": ("r_hat", "r", "yaw rate"),
            "da": ("delta_a", "δa", "aileron"), "dr": ("delta_r", "δr", "rudder"),
        },
    ),
    (
        {"CL": "lift", "Cm": "pitching moment"},
        {
            "alpha": ("alpha", "α", "angle of attack"), "q": ("q_hat", "q", "pitch rate"),
            "de": ("delta_e", "δe", "elevator"),
        },
    ),
)  # fmt: skip
"""Of each plane: line -> words, and ending of a derivative -> (regressor, subscript, words)."""
TYPICAL = {
    "CY_beta": 0.12, "CY_p": 0.05, "CY_r": 0.12, "CY_dr": 0.45, "Cl_beta": 0.09, "Cl_p": 0.45, "Cl_r": 0.10,
    "Cl_da": 0.10, "Cl_dr": 0.02, "Cn_beta": 0.025, "Cn_p": 0.02, "Cn_r": 0.04, "Cn_dr": 0.04,
    "CL_alpha": 3.0, "CL_q": 3.3, "CL_de": 1.0, "Cm_alpha": 0.17, "Cm_q": 0.9, "Cm_de": 0.36,
}  # fmt: skip
"""Usual sizes of derivatives."""
UNLISTED = 0.1  # usual size of a derivative that is not in TYPICAL
LARGEST = 12  # usual sizes to either side of its number: far outside any aircraft


def missing_derivatives(model: Model, known: set[str]) -> tuple[Effect, ...]:
    """One effect for each derivative of the full linear model that is no free parameter of `model`. known: names that the
    catalogue covers.

    A derivative held at a number counts too: the hypothesis is then that the number is wrong.
    """
    return tuple(
        _missing_derivative(model, line, quantity, ending, *motion)
        for lines, motions in LINEAR_TERMS
        for line, quantity in lines.items()
        for ending, motion in motions.items()
        if line in model.definitions and f"{line}_{ending}" not in {*known, *model.free_names}
    )


def _missing_derivative(
    model: Model, line: str, quantity: str, ending: str, regressor: str, subscript: str, motion: str
) -> Effect:
    name = f"{line}_{ending}"
    is_fixed = name in model.parameter_names
    typical = TYPICAL.get(name, UNLISTED)
    start = model.parameter(name).start if is_fixed else 0.0
    lower, upper = start - LARGEST * typical, start + LARGEST * typical
    parameter = EffectParameter(name, "1/rad", typical, lower, upper, start, f"{quantity} per {motion}")
    form = (
        Form(name, (parameter,), frees=(name,))
        if is_fixed
        else Form(name, (parameter,), terms={line: (f"{name}*{regressor}",)}, requires=(line, regressor))
    )
    return Effect(
        name=name,
        title=f"{quantity} due to {motion}",
        group=Group.DERIVATIVE,
        physics=f"The model {'holds' if is_fixed else 'leaves out'} the {quantity} due to {motion}"
        + (f" at {start:g}." if is_fixed else "."),
        equation=f"C_{line[1:]} = ... + C_{line[1:]}{subscript} {regressor}",
        source="the linear model with all its derivatives",
        signature=f"residual in the {quantity}'s channel following {motion}",
        confusions={},
        separate_by=f"a manoeuvre that moves {motion} by itself",
        forms=(form,),
    )
