"""What a log allows: which models and methods, what the other models lack, and what one more sensor would add."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from estimation.aircraft import load_aircraft
from estimation.estimators import registry
from estimation.models.base import Model
from estimation.models.library import BUILDERS
from estimation.prepare.columns import DERIVED
from estimation.session.verdict import TRUSTED_RECONSTRUCTED
from estimation.session.without_sensor import MAY_LACK
from groundstation.flight import Flight
from groundstation.flight.contradictions import Contradiction, contradictions
from groundstation.flight.quality.noise import too_slow

RECONSTRUCTION = ("ax", "ay", "az", "p", "q", "r", "phi", "theta", "psi", "vn", "ve", "vd")
"""Needed for `sideslip reconstruct`, with one of AIRSPEED."""
AIRSPEED = ("V", "p_dynamic", "V_cas")
AIR = ("V", "alpha", "beta")
SURFACES = ("delta_e", "delta_a", "delta_r")

SENSORS: Mapping[str, tuple[str, ...]] = {
    "a vane for angle of attack": ("alpha",),
    "a vane for sideslip": ("beta",),
    "a pitot tube": ("V", "p_dynamic"),
    "a GNSS receiver that gives velocity": ("vn", "ve", "vd"),
    "an attitude (or heading) that is logged": ("phi", "theta", "psi"),
    "an IMU that is logged": ("ax", "ay", "az", "p", "q", "r"),
    "a barometer": ("altitude",),
    "surface positions, or servo outputs with trim and travel in a mapping": SURFACES,
    "thrust, from a table over throttle and airspeed or a load cell": ("thrust",),
}
"""Equipment that could be added to an aircraft -> the columns that come with it."""


BELIEVE = (
    f"believe {' and '.join(TRUSTED_RECONSTRUCTED)}: reconstructed angles lack the gusts, which spoils methods that regress on "
    "them"
)


@dataclass(frozen=True)
class Possible:
    """A model on a log. missing: required columns that the log lacks; reconstructed: columns that `sideslip reconstruct` makes;
    silent: outputs that are not compared; slow: why the sampling is too slow for it; methods: names, none where something is
    missing or too slow."""

    model: str
    missing: tuple[str, ...]
    reconstructed: tuple[str, ...]
    silent: tuple[str, ...]
    methods: tuple[str, ...]
    slow: str = ""

    @property
    def able(self) -> bool:
        """Whether it can be fitted."""
        return not self.missing and not self.slow


@dataclass(frozen=True)
class Recipe:
    """measured: columns from sensors; computed, assumed: columns from a program or an assumption -> their origin; adds: sensor ->
    models that it would make possible; contradictions: quantities that the log holds twice with different values."""

    measured: tuple[str, ...]
    models: tuple[Possible, ...]
    adds: Mapping[str, tuple[str, ...]]
    air: str  # "measured", "reconstruct" or why neither
    computed: Mapping[str, str] = field(default_factory=dict)
    assumed: Mapping[str, str] = field(default_factory=dict)
    contradictions: tuple[Contradiction, ...] = ()

    def lines(self) -> list[str]:
        """The text that is printed."""
        lines = [f"measured: {', '.join(self.measured)}"]
        for word, columns in (("computed", self.computed), ("assumed", self.assumed)):
            if columns:
                lines.append(f"{word}, not measured: {', '.join(f'{n} ({origin})' for n, origin in columns.items())}")
        lines.append(f"air data: {self.air}")
        lines += [f"contradiction: {c.text}{f' (moves {c.moves})' if c.moves else ''}" for c in self.contradictions]
        for m in self.models:
            if not m.able:
                reasons = [f"{', '.join(m.missing)} missing"] if m.missing else []
                lines.append(f"{m.model}: not possible: {'; '.join([*reasons, *([m.slow] if m.slow else [])])}")
                continue
            condition = f" after 'sideslip reconstruct' ({', '.join(m.reconstructed)})" if m.reconstructed else ""
            silent = f"; {', '.join(m.silent)} not compared" if m.silent else ""
            trust = f"; {BELIEVE}" if m.reconstructed else ""
            lines.append(f"{m.model}: possible{condition} with {', '.join(m.methods)}{silent}{trust}")
        lines += [
            f"one more: {sensor} would make possible: {', '.join(models)}" for sensor, models in self.adds.items()
        ]
        return lines

    def to_json(self) -> dict[str, object]:
        """The same as data."""
        models = [
            {
                "model": m.model,
                "possible": m.able,
                "missing": list(m.missing),
                "too_slow": m.slow,
                "methods": list(m.methods),
                "reconstructed": list(m.reconstructed),
                "not_compared": list(m.silent),
                "believe": list(TRUSTED_RECONSTRUCTED if m.reconstructed else m.methods),
            }
            for m in self.models
        ]
        adds = {k: list(v) for k, v in self.adds.items()}
        return {
            "version": 1,
            "measured": list(self.measured),
            "computed": dict(self.computed),
            "assumed": dict(self.assumed),
            "air_data": self.air,
            "contradictions": [c.to_json() for c in self.contradictions],
            "models": models,
            "adds": adds,
        }


def recipe(flight: Flight) -> Recipe:
    """What the built-in models and methods can do with a flight's columns; nothing is fitted."""
    available = frozenset(c for c in flight.known_columns if flight.measured(c))
    aircraft = load_aircraft("cdfp")  # for the names in the models only
    models = [build(aircraft) for build in BUILDERS.values()]
    possible = tuple(_possible(m, available, flight) for m in models)
    able = {p.model for p in possible if p.able}
    adds = {}
    for sensor, columns in SENSORS.items():
        columns_with_sensor = available | set(columns)
        gained = tuple(m.name for m in models if m.name not in able and _possible(m, columns_with_sensor, flight).able)
        if gained:
            adds[sensor] = gained
    computed, assumed = (_of_kind(flight, kind) for kind in ("computed", "assumed"))
    measured = tuple(c for c in flight.columns if c in available and c not in {*computed, *assumed})
    return Recipe(measured, possible, adds, _air(available), computed, assumed, contradictions(flight))


def _of_kind(flight: Flight, kind: str) -> dict[str, str]:
    """Columns that the import marked as of this kind -> their origin."""
    return {n: str(c.get("from", "")) for n, c in flight.channels.items() if c["kind"] == kind}


def _can_reconstruct(available: frozenset[str]) -> bool:
    return available.issuperset(RECONSTRUCTION) and not available.isdisjoint(AIRSPEED)


def _air(available: frozenset[str]) -> str:
    if available.issuperset(AIR):
        return "measured"
    if _can_reconstruct(available):
        return "no vanes for all of it; 'sideslip reconstruct' makes V, alpha, beta and wind, with their uncertainty"
    missing = [c for c in RECONSTRUCTION if c not in available]
    if available.isdisjoint(AIRSPEED):
        missing.append("an airspeed by a pitot (V, p_dynamic or V_cas)")
    return f"incomplete, and to reconstruct it this is missing: {', '.join(missing)}"


def _possible(model: Model, available: frozenset[str], flight: Flight) -> Possible:
    reconstructed = tuple(n for n in AIR if n not in available) if _can_reconstruct(available) else ()
    all_there = available | set(reconstructed)
    required = [s.source for s in (*model.inputs, *model.outputs) if not s.optional]
    missing = tuple(dict.fromkeys(n for n in required if not _is_available(n, all_there)))
    may_lack = [n for n in MAY_LACK.get(model.name, ()) if not _is_available(n, all_there)]
    # a model may lack one of these; a note of the fit says what that costs
    missing = tuple(n for n in missing if may_lack != [n])
    model_columns = {s.source for s in (*model.inputs, *model.outputs)}
    silent = tuple(dict.fromkeys((*(s.source for s in model.outputs if s.source not in all_there), *may_lack)))
    slow = too_slow(flight, model_columns)
    methods = () if missing or slow else registry.estimator_names()
    return Possible(model.name, missing, tuple(n for n in reconstructed if n in model_columns), silent, methods, slow)


def _is_available(column: str, available: frozenset[str] | Sequence[str]) -> bool:
    return column in available or any(
        all(n in available for n in derivation.needs) for derivation in DERIVED.get(column, ())
    )
