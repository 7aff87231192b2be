"""Estimators by name, for `--method`; help, progress, JSON, tables and figures take names and titles from here.

An estimator is an `Estimator` record in one file. Those of Sideslip are in `estimators/methods`, each module with a tuple
ESTIMATORS; an installed package adds its own under the entry point group `sideslip.estimators`, and `--method module:NAME`
takes one that is not installed. Importing this module or calling `estimator_names` loads no estimator of another package, and no
numerical library.
"""

import importlib
import pkgutil
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import EntryPoint, entry_points

from daq.utilities.plain_words import did_you_mean
from estimation.errors import EstimationError
from estimation.estimators import methods
from estimation.estimators.estimator import Estimator, Extra
from estimation.own_code import MISTAKES, import_named, mistake_text

ENTRY_POINTS = "sideslip.estimators"


@cache
def built_in() -> Mapping[str, Estimator]:
    """The estimators of `estimators/methods` by name, in the order of their rank."""
    modules = (importlib.import_module(f"{methods.__name__}.{m.name}") for m in pkgutil.iter_modules(methods.__path__))
    estimators: list[Estimator] = [e for module in modules for e in module.ESTIMATORS]
    return {e.name: e for e in sorted(estimators, key=lambda e: (e.rank, e.name))}


@cache
def _installed() -> Mapping[str, EntryPoint]:
    return {p.name: p for p in entry_points(group=ENTRY_POINTS)}


def estimator_names(extra: Extra | None = None) -> tuple[str, ...]:
    """All names; with `extra`, those of Sideslip's estimators that support it (those of other packages are not loaded)."""
    built_in_estimators = built_in()
    if extra is not None:
        return tuple(n for n, e in built_in_estimators.items() if extra in e.supports)
    return (*built_in_estimators, *sorted(set(_installed()) - set(built_in_estimators)))


def find_estimator(name: str) -> Estimator:
    """The estimator of that name, or of `module:NAME`; EstimationError naming the known ones."""
    estimator, point = built_in().get(name), _installed().get(name)
    if estimator is not None and point is not None:
        raise EstimationError(f"method {name}: {point.value} brings one too, but the name is taken; give it another")
    if estimator is not None:
        return estimator
    if point is not None:
        try:
            value = point.load()
        except MISTAKES as error:
            raise EstimationError(f"method {name}: {point.value} cannot be loaded: {mistake_text(error)}") from error
        return _checked(value, f"method {name}: {point.value}", name)
    if ":" in name:
        imported = _checked(import_named(name, f"method {name!r}", "module:NAME, like my_fits:OWN"), f"method {name}")
        if imported.name in estimator_names():
            raise EstimationError(f"method {name} calls itself {imported.name!r}: the name is taken; give it another")
        return imported
    alternatives = f"known are {', '.join(estimator_names())}, or give module:NAME"
    raise EstimationError(f"method {name!r} is unknown; {alternatives}{did_you_mean(name, estimator_names())}")


def _checked(value: object, source: str, name: str = "") -> Estimator:
    """`value` if it is an Estimator, of that name where one is given; EstimationError otherwise."""
    if not isinstance(value, Estimator):
        raise EstimationError(f"{source} is {type(value).__name__}, not an estimation.Estimator")
    if name and value.name != name:
        raise EstimationError(f"{source} calls itself {value.name!r}: give it the name of its entry point")
    return value


def listed_words(words: Sequence[str]) -> str:
    """`a`, `a and b`, `a, b and c`."""
    return " and ".join(filter(None, (", ".join(words[:-1]), *words[-1:])))


def check_extras(extras: Sequence[Extra], estimators: Sequence[Estimator]) -> None:
    """EstimationError for an extra that none of the chosen estimators supports."""
    for extra in extras:
        if not any(extra in e.supports for e in estimators):
            names = estimator_names(extra)
            methods_text = f"method{'s' if len(names) > 1 else ''} {listed_words(names)}"
            raise EstimationError(f"{extra.value} is for {methods_text}: add {names[0]} to --method")
