"""Get a model: by built-in name, from a TOML file of equations, or from a class of one's own; write one to TOML."""

import json
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from estimation.aircraft import Aircraft, load_aircraft
from estimation.errors import ModelError
from estimation.models.base import Model
from estimation.models.library import BUILDERS
from estimation.own_code import MISTAKES, named, said


def load_model(which: str | Path | type | Model, aircraft: Aircraft | str | None = None) -> Model:
    """The model meant by `which`: a built-in name, a TOML file, `module:Class`, a class, or a model.

    aircraft: gives the built-in models constants and starting derivatives (default: the built-in CDFP).
    Raises ModelError naming what was not found or does not fit.
    """
    if isinstance(which, Model):
        return which
    if isinstance(which, type):
        return _from_class(which, aircraft)
    text = str(which)
    if text in BUILDERS:
        return BUILDERS[text](aircraft if isinstance(aircraft, Aircraft) else load_aircraft(aircraft or "cdfp"))
    if text.endswith(".toml"):
        return read_model(text)
    if ":" in text:
        return _from_class(_import_class(text), aircraft)
    raise ModelError(f"model {text!r}: none of {', '.join(BUILDERS)}, no .toml file and not of the form module:Class")


def asks_for_aircraft(which: str) -> bool:
    """Whether a model takes constants or derivatives from an aircraft: a built-in one, or a class that is given it."""
    if which in BUILDERS:
        return True
    if which.endswith(".toml"):
        return False
    from estimation.models.own import takes_aircraft

    return takes_aircraft(_import_class(which))


def read_model(path: str | Path) -> Model:
    """A model from a TOML file, parsed and never evaluated; ModelError names file and key."""
    path = Path(path)
    if not path.is_file():
        raise ModelError(f"model {path}: no such file")
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
        return Model.from_dict({"name": path.stem, **data})
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ModelError(f"{path}: not a TOML file: {error}") from error
    except (ModelError, TypeError, ValueError) as error:
        raise ModelError(f"{path}: {error}") from error


def write_model(model: Model, path: str | Path) -> None:
    """Write a model so that `read_model` gives an equal one; the file is replaced in one step."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(path.suffix + ".part")
    partial.write_text("\n".join(_toml(model)) + "\n", encoding="utf-8")
    partial.replace(path)


def _toml(model: Model) -> Iterator[str]:
    data = model.to_dict()
    for key in ("name", "title", "description"):
        if data[key]:
            yield f"{key} = {json.dumps(data[key])}"
    yield "equations = ["
    yield from (f"  {json.dumps(line)}," for line in data["equations"])
    yield "]"
    for key in ("states", "inputs", "outputs", "transforms", "parameters"):
        if data[key]:
            yield f"{key} = ["
            yield from (f"  {_inline(item)}," for item in data[key])
            yield "]"
    for key in ("constants", "output_delays"):
        if data[key]:
            yield f"\n[{key}]"
            yield from (f"{name} = {_value(value)}" for name, value in data[key].items())


def _inline(item: Mapping[str, Any]) -> str:
    return "{ " + ", ".join(f"{key} = {_value(value)}" for key, value in item.items() if value is not None) + " }"


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float | int):
        return repr(float(value))
    return json.dumps(value)


def _import_class(text: str) -> type:
    found = named(text, f"model {text!r}", "module:Class, like docs.examples.roll_yaw:RollYaw", ModelError)
    if not isinstance(found, type):
        raise ModelError(f"model {text!r}: that is {type(found).__name__}, not a class")
    return found


def _from_class(cls: type, aircraft: Aircraft | str | None) -> Model:
    from estimation.models.own import model_from_class

    try:
        return model_from_class(cls, load_aircraft(aircraft) if isinstance(aircraft, str) else aircraft)
    except MISTAKES as error:
        raise ModelError(f"model class {cls.__name__}: {said(error)}") from error
