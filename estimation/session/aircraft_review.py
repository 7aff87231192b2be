"""What in an aircraft file is missing, doubtful, or enough for which method; what of that speaks against an estimate."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from estimation.aircraft import Aircraft
from estimation.errors import AircraftError
from estimation.models.base import Model
from estimation.models.expressions import names_in
from estimation.models.library import BUILDERS, not_in_model

Verdict = Literal["ok", "warn", "fail"]

SIGNS = {
    **dict.fromkeys(("CY_beta", "Cl_p", "Cl_da", "Cn_r", "Cn_dr", "Cm_alpha", "Cm_q", "Cm_de"), -1),
    **dict.fromkeys(("CL_alpha", "CL_de", "CY_dr", "Cn_beta", "CD_0", "CD_k"), 1),
}
"""Signs in the conventions of this house; damping and lift slope hold for any aircraft in normal flight, stiffnesses for a
stable one."""

GYRATION = {"Ixx": ("span", 0.10, 0.60), "Iyy": ("chord", 0.3, 6.0), "Izz": ("span", 0.15, 1.4)}
"""Radius of gyration over half the span, or over the chord: twice as far out as any aircraft of Raymer, table 16.1
(0.22-0.34 and 0.34-0.52 of the half span), pitch wider still since chords say little about lengths, and yaw as far as aircraft
whose fuselage is longer than their wing: 0.74 of a T-38, 0.99 of an F-104, 1.15 of an X-15 (Heffley and Jewell, NASA CR-2144)."""

FAR_OFF = (0.3, 2.0)
"""The same, beyond which no choice of chord explains it: span or area is in another unit."""

FILLED = (0.6, 1.02)
"""Area over span times mean aerodynamic chord: 1 for a rectangle, 0.75 for a triangle; above 1 is impossible."""


@dataclass(frozen=True, slots=True)
class ReviewNote:
    """One line of the review. about: constants of equations that it doubts."""

    check: str
    verdict: Verdict
    text: str
    about: tuple[str, ...] = ()

    def to_json(self) -> dict[str, str]:
        """As `check --json` has its findings."""
        return {"check": self.check, "verdict": self.verdict, "text": self.text}


def review_aircraft(aircraft: Aircraft) -> tuple[ReviewNote, ...]:
    """Notes on geometry, inertia, beliefs and each method. A "fail" is what no aircraft can be, or no method can do with."""
    return (*_geometry(aircraft), *_inertia(aircraft), *_signs(aircraft), *_places(aircraft), *_methods(aircraft))


def _geometry(a: Aircraft) -> Iterator[ReviewNote]:
    filled = a.area / (a.span * a.chord)
    if math.isfinite(filled) and not FILLED[0] <= filled <= FILLED[1]:
        text = f"area is {filled:.2f} of span times chord; a wing has {FILLED[0]} to 1"
        constants = ("S", "b", "c") if not FAR_OFF[0] <= filled <= FAR_OFF[1] else ("c",)
        yield ReviewNote("geometry", "warn", f"{text}: another unit, or not the mean aerodynamic chord?", constants)
    loading = a.mass / a.area
    if math.isfinite(loading) and not 0.5 <= loading <= 1000.0:
        yield ReviewNote(
            "mass",
            "warn",
            f"{loading:.3g} kg/m2 of wing; aircraft have 1 to 800: is one of them in other units?",
            ("m", "S"),
        )


def _inertia(a: Aircraft) -> Iterator[ReviewNote]:
    for i, j, k in (("Ixx", "Iyy", "Izz"), ("Iyy", "Izz", "Ixx"), ("Izz", "Ixx", "Iyy")):
        if getattr(a, i) + getattr(a, j) < getattr(a, k):
            yield ReviewNote("inertia", "fail", f"{i} + {j} is less than {k}, which no body can have", (i, j, k))
    for name, (length, low, high) in GYRATION.items():
        reach = getattr(a, length) * (0.5 if length == "span" else 1.0)
        ratio = math.sqrt(getattr(a, name) / a.mass) / reach
        if math.isfinite(ratio) and not low <= ratio <= high:
            reference = "half span" if length == "span" else length
            text = f"{name}: radius of gyration is {ratio:.2g} of the {reference}, usual are {low} to {high}"
            yield ReviewNote("inertia", "warn", text, (name,))


def _signs(a: Aircraft) -> Iterator[ReviewNote]:
    for name, sign in SIGNS.items():
        prior = a.prior(name)
        if prior is not None and prior.value * sign < 0:
            yield ReviewNote(
                "beliefs",
                "warn",
                f"{name} = {prior.value:g} has an unusual sign; check the sign conventions in docs/aircraft.md",
            )
    wide = [n for n, p in a.derivatives.items() if p.std is None]
    if wide:
        yield ReviewNote("beliefs", "warn", f"no standard deviation stated for {', '.join(wide)}")


def _places(a: Aircraft) -> Iterator[ReviewNote]:
    for name, place in a.sensors.items():
        if math.isfinite(a.span) and math.dist((0, 0, 0), place) > 2.0 * a.span:
            yield ReviewNote(
                "sensors", "warn", f"{name} is {math.dist((0, 0, 0), place):.3g} m from the CG, more than two spans"
            )
    if not a.sensors:
        yield ReviewNote(
            "sensors", "ok", "no positions stated: calibration files and `check` factors place the instruments"
        )


def _methods(a: Aircraft) -> Iterator[ReviewNote]:
    from estimation.models.library import BUILDERS
    from estimation.models.load import load_model

    yield ReviewNote("method check", "ok", "data compatibility needs no aircraft")
    for name in BUILDERS:
        try:
            model = load_model(name, a)
        except AircraftError as error:
            yield ReviewNote(f"model {name}", "fail", str(error))
            continue
        blind = [n for n in model.free_names if a.prior(n) is None]
        text = "enough" if not blind else f"enough; nothing believed of {', '.join(blind)}: they start from zero"
        yield ReviewNote(f"model {name}", "ok", text)
    yield _simulation(a)


def _simulation(a: Aircraft) -> ReviewNote:
    missing = [f"[{n}]" for n in ("servos", "engine", "simulation") if getattr(a, n) is None]
    if missing:
        return ReviewNote("sideslip fly", "ok", f"not for simulation: no {', '.join(missing)}")
    return ReviewNote("sideslip fly", "ok", "servos, engine and speeds are there")


@dataclass(frozen=True)
class AircraftObjections:
    """impossible: sentences on constants of the model; dropped: stated derivatives that the model has no term for; span,
    area, chord [m, m2, m]: NaN where not stated."""

    impossible: tuple[str, ...] = ()
    dropped: tuple[str, ...] = ()
    aspect: float = float("nan")


NOTHING = AircraftObjections()


def aircraft_objections(aircraft: Aircraft, model: Model) -> AircraftObjections:
    """What the review of an aircraft says of the constants that a model takes from it."""
    from_file = {n for n, v in aircraft.constants().items() if model.constants.get(n) == v}
    names = frozenset[str]().union(*(names_in(text) for text in model.definitions.values())) & from_file
    if "q_dot" not in model.definitions:  # without pitch it only couples, by what q and r or p and q do together
        names = names - {"Iyy"}
    notes = [n for n in review_aircraft(aircraft) if _concerns(n, names)] if names else []
    impossible = tuple(f"aircraft {aircraft.name}: {n.text} (sideslip aircraft check)" for n in notes)
    built_in = model.name in BUILDERS
    unused = not_in_model(model, aircraft) if built_in else ()
    return AircraftObjections(impossible, unused, aircraft.span**2 / aircraft.area)


def _concerns(note: ReviewNote, names: frozenset[str]) -> bool:
    """Whether a note doubts what a model takes; that three moments do not go together, only where it takes all of them."""
    if len(note.about) == 3 and note.check == "inertia":
        return names.issuperset(note.about)
    return bool(names.intersection(note.about))
