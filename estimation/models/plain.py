"""Parts of a model as plain data, as a TOML file holds them, and back."""

from collections.abc import Mapping
from dataclasses import asdict, replace
from enum import Enum
from typing import Any

from daq.utilities.plain_words import one_line
from estimation.errors import ModelError
from estimation.models.parts import EstimatedStretch, InputTransform, Parameter, ParameterRole, Signal, usual_role


def without_defaults(item: Any) -> dict[str, Any]:
    """A part as a table, without keys at their default."""
    cls = type(item)
    default = cls("x", "x", ("x",)) if cls is InputTransform else cls("x")
    if isinstance(item, Parameter):
        default = cls("x", role=usual_role(item.name))
    data = {k: v for k, v in asdict(item).items() if k in ("name", "kind", "input") or v != getattr(default, k)}
    return {k: list(v) if isinstance(v, tuple) else v.value if isinstance(v, Enum) else v for k, v in data.items()}


def read_number(value: object, key: str) -> float:
    """`value` as a float; ModelError naming the key where it is no number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ModelError(f"{key} = {value!r} is not a number")
    return float(value)


def read_ends(value: object, key: str) -> tuple[float, float]:
    """`value` as (least, greatest); ModelError naming the key."""
    if not isinstance(value, list) or len(value) != 2:
        raise ModelError(f"{key} = {value!r} must be two numbers, [least, greatest]")
    low, high = read_number(value[0], key), read_number(value[1], key)
    if not low <= high:
        raise ModelError(f"{key} = {value!r}: the first number must not be greater than the second")
    return low, high


def read_stretch(data: object) -> EstimatedStretch:
    """One of the stretches that a model was estimated from; ModelError for other data."""
    if not isinstance(data, Mapping) or set(data) != {"sha256", "begin", "end"}:
        raise ModelError(f"estimated_from = {data!r} must be a table of sha256, begin and end")
    begin, end = read_ends([data["begin"], data["end"]], "estimated_from")
    return EstimatedStretch(one_line(str(data["sha256"])), begin, end)


def read_list(data: Mapping[str, Any], key: str) -> list[Any]:
    """The list under a key, empty where it is absent; ModelError for another value."""
    value = data.get(key, [])
    if not isinstance(value, list):
        raise ModelError(f"{key} = {value!r} must be a list, like [{value!r}]")
    return value


def read_table(data: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """The table under a key, empty where it is absent; ModelError for another value."""
    value = data.get(key, {})
    if not isinstance(value, Mapping):
        raise ModelError(f"{key} = {value!r} must be a table of names and values")
    return value


def read_signal(key: str, data: object) -> Signal:
    """A state, input or output from a table, or from its name alone."""
    if isinstance(data, Mapping):
        for name in sorted(set(data) & set(Signal.__dataclass_fields__)):
            value = data[name]
            kind = _KINDS.get(name, str)
            if not isinstance(value, kind):
                expected = "true or false" if kind is bool else "text" if kind is str else "text or a number"
                raise ModelError(f"{key} {data.get('name')!r}: {name} = {value!r} must be {expected}")
    return read_item(Signal, key, _floats(data))  # type: ignore[no-any-return]


def _floats(data: object) -> object:
    """A table with its integers as floats: the digest of a model must not depend on a decimal point."""
    if not isinstance(data, Mapping):
        return data
    return {k: float(v) if isinstance(v, int) and not isinstance(v, bool) else v for k, v in data.items()}


_KINDS: Mapping[str, Any] = {
    **dict.fromkeys(("control", "servo", "optional", "held", "computed"), bool),
    "start": (str, int, float),
}


def read_lines(value: object) -> tuple[str, ...]:
    """Equation lines without comments and blank lines, from a list or from one text."""
    rows = value.splitlines() if isinstance(value, str) else value
    if not isinstance(rows, list) or not all(isinstance(r, str) for r in rows):
        raise ModelError("equations must be lines of text: 'name = expression'")
    lines = (row.split("#", 1)[0].strip() for row in rows)
    return tuple(line for line in lines if line)


def read_item(cls: type[Any], key: str, data: object) -> Any:
    """A part of class `cls` from a table, or from its name alone."""
    if isinstance(data, str):
        data = {"name": data}
    if not isinstance(data, Mapping) or "name" not in data:
        raise ModelError(f"{key}: each entry is a table with at least a name, not {data!r}")
    if not isinstance(data["name"], str):
        raise ModelError(f"{key}: name = {data['name']!r} must be text")
    known_keys = set(cls.__dataclass_fields__)
    unknown = sorted(set(data) - known_keys)
    if unknown:
        raise ModelError(
            f"{key} {data['name']!r}: unknown key {unknown[0]!r}; known are {', '.join(sorted(known_keys))}"
        )
    return cls(**data)


def read_parameter(data: object) -> Parameter:
    """A parameter from a table, or from its name alone."""
    if isinstance(data, Mapping):
        texts = {"name", "unit", "reference_source", "description", "role"}
        flags = {"fixed", "local"}
        for key, value in data.items():
            if key in texts - {"name", "role"} and not isinstance(value, str):  # those two are checked elsewhere
                raise ModelError(f"parameter {data.get('name')!r}: {key} = {value!r} must be text")
            if key in Parameter.__dataclass_fields__ and key not in texts | flags:
                read_number(value, f"parameter {data.get('name')!r}: {key}")
            if key in flags and not isinstance(value, bool):
                raise ModelError(f"parameter {data.get('name')!r}: {key} = {value!r} must be true or false")
    built: Parameter = read_item(Parameter, "parameters", _floats(data))
    role = data.get("role") if isinstance(data, Mapping) else None
    return replace(built, role=usual_role(built.name) if role is None else _role(built.name, role))


def _role(name: str, value: object) -> ParameterRole:
    if value not in tuple(ParameterRole):
        raise ModelError(f"parameter {name!r}: role = {value!r} is none of {', '.join(ParameterRole)}")
    return ParameterRole(str(value))


def read_transform(data: object) -> InputTransform:
    """An input transform from a table."""
    if not isinstance(data, Mapping) or set(data) != {"kind", "input", "parameters"}:
        raise ModelError(f"transforms: each entry has kind, input and parameters, not {data!r}")
    if not isinstance(data["parameters"], list | tuple):
        raise ModelError(f"transforms: parameters = {data['parameters']!r} must be a list of names")
    return InputTransform(str(data["kind"]), str(data["input"]), tuple(str(p) for p in data["parameters"]))
