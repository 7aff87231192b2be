"""Review of an aircraft file: what is missing or doubtful, what suffices for which method, what speaks against an estimate."""

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
"""Usual signs in this project's conventions: of damping and lift slope for any aircraft in normal flight, of stiffness for a
stable one."""

GYRATION = {"Ixx": ("span", 0.10, 0.60), "Iyy": ("chord", 0.3, 6.0), "Izz": ("span", 0.15, 1.4)}
"""Inertia -> length, least and greatest radius of gyration over half the span or over the chord. Twice the spread of Raymer,
table 16.1 (0.22-0.34 and 0.34-0.52 of the half span); in pitch wider, as chords say little about lengths; in yaw up to aircraft
whose fuselage is longer than their wing: 0.74 of a T-38, 0.99 of an F-104, 1.15 of an X-15 (Heffley and Jewell, NASA CR-2144)."""

AREA_RATIO = (0.6, 1.02)
"""Area over span times mean aerodynamic chord: 1 for a rectangle, 0.75 for a triangle; above 1 is impossible."""

ANOTHER_UNIT = (0.3, 2.0)
"""Area ratio outside of which no choice of chord explains it: span or area is in another unit."""


LOADING = (0.05, 1000.0)
"""kg/m2 of wing: an indoor model of 50 g that flies at 2 m/s has 0.2, an airliner 750."""


@dataclass(frozen=True, slots=True)
class ReviewNote:
    """One line of the review. about: the constants of the equations that it concerns."""

    check: str
    verdict: Verdict
    text: str
    about: tuple[str, ...] = ()

    def to_json(self) -> dict[str, str]:
        """One entry, shaped like the findings of `check --json`."""
        return {"check": self.check, "verdict": self.verdict, "text": self.text}


def review_aircraft(aircraft: Aircraft) -> tuple[ReviewNote, ...]:
    """Notes on geometry, inertia, beliefs, sensors and each model. "fail" marks what is impossible, or not enough for a model."""
    return (*_geometry(aircraft), *_inertia(aircraft), *_signs(aircraft), *_places(aircraft), *_methods(aircraft))


def _geometry(a: Aircraft) -> Iterator[ReviewNote]:
    ratio = a.area / (a.span * a.chord)
    if math.isfinite(ratio) and not AREA_RATIO[0] <= ratio <= AREA_RATIO[1]:
        text = f"area is {ratio:.2f} of span times chord; a wing has {AREA_RATIO[0]} to 1"
        constants = ("c",) if ANOTHER_UNIT[0] <= ratio <= ANOTHER_UNIT[1] else ("S", "b", "c")
        yield ReviewNote("geometry", "warn", f"{text}: another unit, or not the mean aerodynamic chord?", constants)
    loading = a.mass / a.area
    if math.isfinite(loading) and not LOADING[0] <= loading <= LOADING[1]:
        yield ReviewNote(
            "mass",
            "warn",
            f"{loading:.3g} kg/m2 of wing; aircraft have 0.1 to 800: is one of them in other units?",
            ("m", "S"),
        )


def _inertia(a: Aircraft) -> Iterator[ReviewNote]:
    for i, j, k in (("Ixx", "Iyy", "Izz"), ("Iyy", "Izz", "Ixx"), ("Izz", "Ixx", "Iyy")):
        if getattr(a, i) + getattr(a, j) < getattr(a, k):
            yield ReviewNote("inertia", "fail", f"{i} + {j} is less than {k}, which no body can have", (i, j, k))
    for name, (length, low, high) in GYRATION.items():
        reference_length = getattr(a, length) * (0.5 if length == "span" else 1.0)
        ratio = math.sqrt(getattr(a, name) / a.mass) / reference_length
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
    without_std = [n for n, p in a.derivatives.items() if p.std is None]
    if without_std:
        yield ReviewNote("beliefs", "warn", f"no standard deviation stated for {', '.join(without_std)}")


def _places(a: Aircraft) -> Iterator[ReviewNote]:
    for name, place in a.sensors.items():
        if math.isfinite(a.span) and math.hypot(*place) > 2.0 * a.span:
            yield ReviewNote(
                "sensors", "warn", f"{name} is {math.hypot(*place):.3g} m from the CG, more than two spans"
            )
    if not a.sensors:
        yield ReviewNote(
            "sensors", "ok", "no positions stated: calibration files and `check` factors place the instruments"
        )


def _methods(a: Aircraft) -> Iterator[ReviewNote]:
    from estimation.models.load import load_model

    yield ReviewNote("method check", "ok", "data compatibility needs no aircraft")
    for name in BUILDERS:
        try:
            model = load_model(name, a)
        except AircraftError as error:
            yield ReviewNote(f"model {name}", "fail", str(error))
            continue
        without_prior = [n for n in model.free_names if a.prior(n) is None]
        text = "enough"
        if without_prior:
            text += f"; nothing believed of {', '.join(without_prior)}: they start from zero"
        yield ReviewNote(f"model {name}", "ok", text)
    yield _simulation(a)


def _simulation(a: Aircraft) -> ReviewNote:
    missing = [f"[{n}]" for n in ("servos", "engine", "simulation") if getattr(a, n) is None]
    if missing:
        return ReviewNote("sideslip fly", "ok", f"not for simulation: no {', '.join(missing)}")
    return ReviewNote("sideslip fly", "ok", "servos, engine and speeds are there")


@dataclass(frozen=True)
class AircraftObjections:
    """impossible: sentences on doubtful constants of the model; dropped: stated derivatives that the model has no term for;
    aspect: aspect ratio of the wing, NaN where not stated."""

    impossible: tuple[str, ...] = ()
    dropped: tuple[str, ...] = ()
    aspect: float = math.nan


NO_OBJECTIONS = AircraftObjections()


def aircraft_objections(aircraft: Aircraft, model: Model) -> AircraftObjections:
    """What the review of an aircraft says against the constants that a model takes from it."""
    from_file = {n for n, v in aircraft.constants().items() if model.constants.get(n) == v}
    names = frozenset[str]().union(*(names_in(text) for text in model.definitions.values())) & from_file
    if "q_dot" not in model.definitions:  # without pitch Iyy acts only through the inertial coupling by q r and p q
        names = names - {"Iyy"}
    notes = [n for n in review_aircraft(aircraft) if _concerns(n, names)] if names else []
    impossible = tuple(f"aircraft {aircraft.name}: {n.text} (sideslip aircraft check)" for n in notes)
    built_in = model.name in BUILDERS
    unused = not_in_model(model, aircraft) if built_in else ()
    return AircraftObjections(impossible, unused, aircraft.span**2 / aircraft.area)


def _concerns(note: ReviewNote, names: frozenset[str]) -> bool:
    """Whether a note concerns the constants of a model. A note on all three moments of inertia does only if the model has all."""
    if len(note.about) == 3 and note.check == "inertia":
        return names.issuperset(note.about)
    return bool(names.intersection(note.about))
