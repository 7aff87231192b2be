"""The catalogue: built-in effects, extended by installed packages and by files that a person names.

A laboratory adds effects in a TOML file with the fields of `Effect` and `Form` (data only, nothing is executed), like the
built-in ones beside this module; in a Python file with a tuple `EFFECTS`; or in a package with an entry point of the group
`sideslip.effects`.
"""

import importlib.metadata
import importlib.util
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

from daq.utilities.input_files import read_toml
from daq.utilities.plain_words import did_you_mean
from estimation.errors import ModelError
from estimation.gap.effects.base import Effect, EffectParameter, Form, Group
from estimation.gap.errors import EffectError
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
    data = dict(table)
    terms = {k: (v,) if isinstance(v, str) else tuple(v) for k, v in data.pop("terms", {}).items()}
    for pieces in terms.values():
        for piece in pieces:
            parse(piece)
    optional = tuple(data.pop("optional", ()))
    for output in optional:
        if output not in {**data.get("outputs", {}), **data.get("output_delays", {})}:
            raise ValueError(f"optional {output!r} is none of the form's outputs or output_delays")
    return Form(
        label=data.pop("label", effect),
        equation=str(data.pop("equation", "")),
        parameters=tuple(_parameter(p) for p in data.pop("parameters")),
        terms=terms,
        lines=tuple(data.pop("lines", ())),
        outputs=dict(data.pop("outputs", {})),
        states=tuple(Signal(**s) for s in data.pop("states", ())),
        inputs=tuple(Signal(**s) for s in data.pop("inputs", ())),
        transforms=tuple(
            InputTransform(t["kind"], t["input"], tuple(t["parameters"])) for t in data.pop("transforms", ())
        ),
        output_delays=dict(data.pop("output_delays", {})),
        requires=tuple(data.pop("requires", ())),
        unless=tuple((line, symbol) for line, symbol in data.pop("unless", ())),
        optional=optional,
        **data,
    )
