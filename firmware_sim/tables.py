"""Tables of a scenario: how they are checked and written, and what can be wrong with a request to the simulator."""

from collections.abc import Mapping
from typing import Any, TypeVar

import tomli_w
from pydantic import BaseModel, ConfigDict, ValidationError

from daq.utilities.errors import UserError


class ScenarioError(UserError):
    """A scenario that cannot be flown: unknown name, malformed TOML, impossible or unknown key."""


class SimulatorTable(BaseModel):
    """Base of the tables: unknown keys are mistakes, values do not change after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True)


_Table = TypeVar("_Table", bound=BaseModel)


def checked(
    model: type[_Table], table: Mapping[str, Any], where: str, *keys: str, hints: Mapping[str, str] | None = None
) -> _Table:
    """A table of the scenario `where`, which lies there under `keys`; raises ScenarioError naming the key that is wrong.

    hints: beginning of a key -> what to say besides.
    """
    try:
        return model.model_validate(table)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join([*keys, *(str(part) for part in first["loc"])]) or "(top level)"
        hint = next((text for start, text in (hints or {}).items() if key.startswith(start)), "")
        raise ScenarioError(f"scenario {where}: {key}: {first['msg'].removeprefix('Value error, ')}{hint}") from error


def merged(defaults: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Tables with some keys replaced, key by key at every depth."""
    result = dict(defaults)
    for key, value in changes.items():
        old = result.get(key)
        result[key] = merged(old, value) if isinstance(old, Mapping) and isinstance(value, Mapping) else value
    return result


def toml_text(table: Mapping[str, Any]) -> str:
    """A table as TOML text that reads back to the same table; None values, for which TOML has no word, are left out."""
    return tomli_w.dumps(_without_none(table))


def _without_none(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _without_none(item) for key, item in value.items() if item is not None}
    return [_without_none(item) for item in value] if isinstance(value, list | tuple) else value
