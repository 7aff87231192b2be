"""The choice of stretches and model: the richest model that the channels and the inputs allow."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from estimation.prepare.stretches import cut, select_segments
from estimation.session.recipe import Recipe
from groundstation.flight import Flight
from groundstation.flight.arrays import true_runs
from groundstation.flight.contradictions import Contradiction, contradictions
from groundstation.flight.errors import FlightError
from groundstation.flight.manoeuvres import CONTROLS, ManoeuvreStretch, cut_to_manoeuvres, find_manoeuvres
from groundstation.flight.marks import marks_of
from groundstation.flight.stretches import airborne

BY_HAND = ("MANUAL",)
"""Modes in which the pilot alone moves the surfaces: an autopilot moves them with the motion, which hides damping."""
ENOUGH = 5.0
"""[s] of flight that suffice for an estimate."""
MOSTLY = 0.6
"""Share of a flight in manoeuvres from which on the rest is not cut off."""
MOVED = 0.01
"""[rad] between the 5th and 95th percentile of a control, from which on it was an input and not trimming."""
LONGEST_TEXT = 400  # characters of a list from a log

RICHEST = ("six-dof", "lateral", "longitudinal", "lateral-simple")
"""Models in the order of trial, until the estimate of one is recommended."""
NEEDS_MOVED = {
    "six-dof": (("delta_a", "delta_r"), ("delta_e",)),
    "lateral": (("delta_a", "delta_r"),),
    "lateral-simple": (("delta_a", "delta_r"),),
    "longitudinal": (("delta_e",),),
}
"""Model -> groups of controls, of each of which one must have moved."""


@dataclass(frozen=True)
class ChosenStretches:
    """flight: its stretches as segments. by: how they were chosen, where possible as for `--segments`. notes: what was left out;
    hint: how a better flight would be flown."""

    flight: Flight
    by: str
    notes: tuple[str, ...] = ()
    hint: str = ""

    def to_json(self) -> list[dict[str, Any]]:
        """As in `answer.json`: each stretch with its time."""
        time = self.flight.time
        return [
            {"flight": self.flight.name, "by": self.by, "from": float(time[s.start]), "to": float(time[s.stop - 1])}
            for s in self.flight.segments
        ]


def without_failures(flight: Flight) -> tuple[Flight, tuple[Contradiction, ...]]:
    """The flight without the times in which a sensor failed, where enough is left; and its contradictions, of which those that
    were cut out do not stop the analysis."""
    contradicted = contradictions(flight)
    sound = np.ones(len(flight), bool)
    for begin, end in (span for c in contradicted for span in c.spans):
        sound &= (flight.time < begin) | (flight.time > end)
    if sound.all() or float(sound.sum()) * flight.sample_interval < ENOUGH:
        return flight, contradicted
    label = np.full(len(flight), -1, np.int64)
    for number, (a, b) in enumerate(true_runs(sound, flight.segments)):
        label[a:b] = number
    part = cut(flight, label)
    left_out = [replace(c, stops=False, text=f"{c.text} (left out here)") for c in contradicted if c.spans]
    return part, (*left_out, *contradictions(part))


def choose_stretches(flight: Flight) -> ChosenStretches:
    """Stretches flown by hand with inputs, else manoeuvres, else all of the flight."""
    modes = {m.name.upper() for m in marks_of(flight).modes}
    hint = ""
    for mode in BY_HAND:
        if mode not in modes:
            continue
        try:
            part = select_segments(flight, f"mode:{mode}")
        except FlightError:
            continue  # not in flight in this mode, or too briefly
        if _duration(part) >= ENOUGH and moved_controls(part):
            return ChosenStretches(part, f"mode:{mode}", _new_notes(flight, part))
    if modes:
        mode_names = ", ".join(sorted(modes))
        hint = (
            f"{flight.name}: no inputs in MANUAL (its modes are {mode_names:.{LONGEST_TEXT}}); an autopilot that moves the "
            "surfaces with the motion hides damping: fly the inputs by hand"
        )
    airborne_part = airborne(flight)
    notes = (airborne_part.text,) if airborne_part.text else ()
    flight_part = flight if airborne_part.flying.all() else flight.part(airborne_part.flying)
    manoeuvres = find_manoeuvres(flight_part)
    if manoeuvres and sum(m.stop - m.start for m in manoeuvres) < MOSTLY * _duration(flight_part):
        return ChosenStretches(cut_to_manoeuvres(flight_part, manoeuvres, flight.name), _times(manoeuvres), notes, hint)
    return ChosenStretches(flight_part, "all that was flown", notes, hint)


def _times(manoeuvres: Sequence[ManoeuvreStretch]) -> str:
    return "manoeuvres " + ",".join(f"{m.start:.2f}:{m.stop:.2f}" for m in manoeuvres)[:LONGEST_TEXT]


def _new_notes(original: Flight, part: Flight) -> tuple[str, ...]:
    texts_before = {n.text for n in original.notes}
    return tuple(n.text for n in part.notes if n.text not in texts_before and "left out" in n.text)


def _duration(flight: Flight) -> float:
    """Time in segments [s]."""
    return float(sum(flight.time[s.stop - 1] - flight.time[s.start] for s in flight.segments))


def moved_controls(flight: Flight) -> tuple[str, ...]:
    """Controls that were moved."""
    controls = []
    for name in CONTROLS:
        values = flight[name][np.isfinite(flight[name])] if flight.measured(name) else np.zeros(0)
        if values.size and float(np.subtract(*np.percentile(values, [95, 5]))) >= MOVED:
            controls.append(name)
    return tuple(controls)


def models_to_try(recipe: Recipe, controls: Sequence[str]) -> list[str]:
    """Models that the channels allow and for which the inputs suffice, the richest first."""
    possible = {m.model for m in recipe.models if m.able}
    return [m for m in RICHEST if m in possible and all(set(group) & set(controls) for group in NEEDS_MOVED[m])]
