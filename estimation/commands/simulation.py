"""The option `--simulation` of the verbs: what they share."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from estimation.simulation.attach import Attached
    from groundstation.flight import Flight


def attached_to(
    spec: str,
    model: str,
    flights: "Sequence[Flight]",
    aircraft: str | None,
    *,
    estimating: bool = False,
    predicting: bool = False,
) -> "Attached":
    """The simulation under `model`, evaluated along the flights; what of it is held is told in the terminal.

    estimating: derivatives are free, and the simulation is taken at the motion of the fit. predicting: nothing is free, and it is
    taken at the motion predicted.
    """
    from estimation.simulation.attach import Free, attach, estimated_about_its_motion, settled

    free = Free.DERIVATIVES if estimating else Free.NOTHING if predicting else Free.FACTORS
    attached = attach(spec, model, flights, aircraft, free)
    for note in attached.notes:
        click.echo(f"simulation: {note}")
    if estimating:
        return estimated_about_its_motion(attached)
    return settled(attached) if predicting else attached
