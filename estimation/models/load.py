"""Models by built-in name, from a TOML file of equations or from the user's class; models written to TOML."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from daq.utilities.input_files import read_toml
from daq.utilities.outputs import write_text
from daq.utilities.plain_words import did_you_mean
from estimation.aircraft import Aircraft, built_in_aircraft, load_aircraft
from estimation.errors import ModelError
from estimation.models.base import Model
from estimation.models.expressions import names_in
from estimation.models.library import BUILDERS, WHOLE, stated_terms
from estimation.own_code import MISTAKES, import_named, mistake_text


def load_model(which: str | Path | type | Model, aircraft: Aircraft | str | None = None) -> Model:
    """The model meant by `which`: a built-in name, a TOML file, `module:Class`, a class, or a model.

    aircraft: an aircraft, a built-in name or a file. Built-in models, and classes whose constructor takes an aircraft, get
    constants and start values from it. Raises ModelError naming what was not found or is inconsistent, AircraftError for
    what the aircraft lacks.
    """
    if isinstance(which, Model):
        return which
    if isinstance(which, type):
        return _from_class(which, aircraft)
    text = str(which)
    if text in BUILDERS:
        loaded = _required_aircraft(aircraft, f"model {text}")
        built = _with_known_constants(BUILDERS[text](loaded), loaded, f"model {text}")
        return stated_terms(built, loaded) if text in WHOLE else built
    if text.endswith(".toml"):
        return read_model(text)
    if ":" in text:
        return _from_class(_import_class(text), aircraft)
    raise ModelError(
        f"model {text!r}: none of {', '.join(BUILDERS)}, no .toml file and not of the form module:Class"
        f"{did_you_mean(text, BUILDERS)}"
    )


def _required_aircraft(aircraft: Aircraft | str | None, purpose: str) -> Aircraft:
    """The aircraft, loaded where it is a name or file; ModelError where there is none."""
    if aircraft is None:
        raise ModelError(
            f"{purpose} takes mass and geometry of an aircraft and was given none; name a built-in one"
            f" ({', '.join(built_in_aircraft())}), or write a file with: sideslip aircraft new NAME"
        )
    return aircraft if isinstance(aircraft, Aircraft) else load_aircraft(aircraft)


def _with_known_constants(model: Model, aircraft: Aircraft | None, purpose: str) -> Model:
    """The model without constants that its aircraft lacks; AircraftError where an equation uses one of them."""
    unknown = {name for name, value in model.constants.items() if math.isnan(value)}
    if aircraft is None or not unknown:
        return model
    aircraft.need(sorted(frozenset[str]().union(*(names_in(text) for text in model.definitions.values()))), purpose)
    return replace(model, constants={n: v for n, v in model.constants.items() if n not in unknown})


def check_model(which: str) -> None:
    """Raise the ModelError of `load_model` for an unknown name, or a file or class in error, without an aircraft."""
    if not asks_for_aircraft(which):
        load_model(which)


def asks_for_aircraft(which: str | Path | type | Model) -> bool:
    """Whether a model takes constants or derivatives from an aircraft: a built-in one, or a class whose constructor takes it."""
    from estimation.models.own import takes_aircraft

    if isinstance(which, type):
        return takes_aircraft(which)
    text = "" if isinstance(which, Model) else str(which)
    if text in BUILDERS:
        return True
    return ":" in text and not text.endswith(".toml") and takes_aircraft(_import_class(text))


def read_model(path: str | Path) -> Model:
    """A model from a TOML file, parsed and never evaluated; ModelError names file and key."""
    path = Path(path)
    data = read_toml(path, "file", ModelError)
    try:
        return Model.from_dict({"name": path.stem, **data})
    except (ModelError, TypeError, ValueError) as error:
        raise ModelError(f"{path}: {error}") from error


def write_model(model: Model, path: str | Path) -> None:
    """Write a model so that `read_model` gives an equal one; the file is replaced in one step."""
    write_text(model_text(model), Path(path))


def model_text(model: Model) -> str:
    """The model as TOML text that `read_model` reads back."""
    import tomli_w

    data = {key: _for_toml(value) for key, value in model.to_dict().items() if value}
    order = ("name", "title", "description", "equations")  # what a person reads first
    return tomli_w.dumps({key: data[key] for key in (*(k for k in order if k in data), *data)}, indent=2)


def _for_toml(value: Any) -> Any:
    """A value as TOML can hold it: without None, which TOML lacks, and with integers as floats."""
    if isinstance(value, dict):
        return {k: _for_toml(v) for k, v in value.items() if v is not None}
    if isinstance(value, list):
        return [_for_toml(v) for v in value]
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else value


def _import_class(text: str) -> type:
    imported = import_named(text, f"model {text!r}", "module:Class, like docs.examples.roll_yaw:RollYaw", ModelError)
    if not isinstance(imported, type):
        raise ModelError(f"model {text!r}: that is {type(imported).__name__}, not a class")
    return imported


def _from_class(cls: type, aircraft: Aircraft | str | None) -> Model:
    from estimation.models.own import model_from_class

    loaded = load_aircraft(aircraft) if isinstance(aircraft, str) else aircraft
    try:
        return _with_known_constants(model_from_class(cls, loaded), loaded, f"model class {cls.__name__}")
    except MISTAKES as error:
        raise ModelError(f"model class {cls.__name__}: {mistake_text(error)}") from error
