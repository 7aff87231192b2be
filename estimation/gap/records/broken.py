"""Channels with a dead or stuck sensor: they are no measurement, and the answer says so.

A fit silently ignores a dead output, and the answer reads as if all channels had been compared. A dead input cannot be
replaced: the fit uses it as recorded, so the person has to know.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from estimation.models.base import Model
from groundstation.flight import Flight
from groundstation.flight.arrays import true_runs
from groundstation.flight.quality.repeats import repeats

FEWEST = 10  # values: fewer may be equal by chance


def without_stuck(flight: Flight, columns: Iterable[str]) -> Flight:
    """The flight with NaN in the named columns while their sensor is stuck: an output is not compared there, and the stretch of a
    stuck input is left out."""
    stuck = {c: repeats(flight, c).stuck for c in columns if flight.measured(c)}
    changed = {c: np.where(mask, np.nan, flight[c]) for c, mask in stuck.items() if mask.any()}
    return flight.with_columns(**changed) if changed else flight


def stands_still(flight: Flight, column: str) -> bool:
    """Whether a channel has one value from beginning to end."""
    if not flight.measured(column):
        return False
    values = flight[column][np.isfinite(flight[column])]
    return values.size >= FEWEST and float(np.ptp(values)) == 0.0


def dead_everywhere(model: Model, flights: Sequence[Flight]) -> list[str]:
    """Outputs of `model` that stand still on every flight; none where all outputs do, which the fit itself refuses."""
    still = [s.name for s in model.outputs if all(stands_still(f, s.source) for f in flights)]
    return still if len(still) < len(model.outputs) else []


def broken_in_words(flights: Sequence[Flight], model: Model) -> list[str]:
    """One sentence for each channel that the model needs and that is dead or stuck on some flights.

    An input that stands still on every flight may never have been moved: `unmoved_in_words` reports controls.
    """
    outputs = {s.source for s in model.outputs}
    inputs = {s.source for s in model.inputs if not s.computed} - outputs
    sentences = []
    for column in sorted(outputs | inputs):
        still = [f.name for f in flights if stands_still(f, column)]
        if still and column in outputs:
            where = "every flight" if len(still) == len(flights) else " and ".join(still)
            sentences.append(f"{column} stands still on {where}: a dead channel, not compared there")
        elif still and len(still) < len(flights):
            sentences.append(
                f"{column} stands still on {' and '.join(still)} and moves elsewhere: is its sensor dead there?"
            )
        if stuck := [words for f in flights if (words := _stuck_in_words(f, column))]:
            what = "not compared there" if column in outputs else "those times are left out"
            sentences.append(f"{column} is stuck {' and '.join(stuck)}: {what}")
    return sentences


def _stuck_in_words(flight: Flight, column: str) -> str:
    """When a channel is stuck on a flight; empty where it is not."""
    runs = true_runs(repeats(flight, column).stuck) if flight.measured(column) else []
    if not runs:
        return ""
    first, last = flight.time[runs[0][0]], flight.time[runs[-1][1] - 1]
    times = f", {len(runs)} times" if len(runs) > 1 else f" at {flight[column][runs[0][0]]:.3g}"
    return f"on {flight.name} (between {first:.1f} and {last:.1f} s{times})"


def unmoved_in_words(flights: Sequence[Flight], model: Model) -> str:
    """A sentence on controls that stand still on every flight; empty where none does."""
    controls = [s.source for s in model.inputs if s.control and not s.computed]
    still = [c for c in controls if all(stands_still(f, c) for f in flights)]
    if not still:
        return ""
    return (
        f"{' and '.join(still)} never moved: nothing is known of its effect; if the surface did move, its channel is dead, and "
        "that is the missing effect."
    )
