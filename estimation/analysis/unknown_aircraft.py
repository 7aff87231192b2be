"""Results that need no aircraft file: agreement of the instruments, wind, and natural motion.

The natural motion follows from dimensional derivatives, which need neither mass nor geometry; an aircraft file only makes them
dimensionless. So the model is estimated with the geometry of a stand-in, and only frequencies, dampings and time constants are
reported.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from daq.utilities.errors import UserError
from estimation.aircraft import load_aircraft
from estimation.analysis.choice import models_to_try, moved_controls
from estimation.session.recipe import Recipe
from groundstation.flight import Flight

STAND_IN = "cdfp"  # a built-in aircraft
NEEDS = (
    "span, wing area, mean chord, mass and moments of inertia: 'sideslip aircraft new NAME -o NAME.toml' writes a file to "
    "fill in, then --aircraft NAME.toml"
)
SEED = 3  # of the draws for the spread of the modes
OFF = 3.0  # bounds from its ideal value, beyond which an instrument factor is reported


def without_aircraft(
    flights: Sequence[Flight], recipe_of_log: Recipe, air: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """`verdict`, `lines` and `next`, with the numbers behind them. flights: with their stretches as segments; air: content of the
    stage of air data of each."""
    lines: list[str] = []
    compatibility = _compatibility(flights, lines)
    wind = _wind(flights, air, lines)
    models = [
        m
        for m in models_to_try(recipe_of_log, sorted({c for f in flights for c in moved_controls(f)}))
        if m != "six-dof"
    ]
    modes = [m for model in models[:1] for m in _modes(flights, model, lines)]
    answers = ", ".join(
        [*(["wind"] if wind else []), *(["natural motion"] if modes else []), "agreement of the instruments"]
    )
    verdict = f"No derivatives without an aircraft file; {answers} can be found: {'; '.join(lines)}"
    return {
        "verdict": verdict, "lines": lines, "next": [f"for derivatives give {NEEDS}"],
        "compatibility": compatibility, "wind": wind, "modes": modes,
    }  # fmt: skip


def _compatibility(flights: Sequence[Flight], lines: list[str]) -> list[dict[str, Any]]:
    """Instrument factors of each flight; adds to `lines` those that are off by more than OFF of their bounds."""
    from estimation.answers.checks import check

    results = []
    for flight in flights:
        try:
            entry = check(flight).to_json()["flights"][0]
        except UserError as error:
            lines.append(f"instruments of {flight.name}: {error}")
            continue
        factors = entry["factors"]
        significant = [
            n
            for n, f in factors.items()
            if f.get("identifiable")
            and f.get("std_coloured")
            and abs(f["estimate"] - (n[:2] == "K_")) > OFF * f["std_coloured"]
        ]
        lines.append(
            f"instruments of {flight.name}: "
            + (f"off by more than three bounds: {', '.join(significant)}" if significant else "they agree")
        )
        results.append({"flight": flight.name, "factors": factors})
    return results


def _wind(flights: Sequence[Flight], air: Sequence[Mapping[str, Any]], lines: list[str]) -> list[dict[str, Any]]:
    """Mean wind of each flight whose air data were reconstructed; adds to `lines`."""
    winds = []
    for flight, reconstruction in zip(flights, air, strict=False):
        if not isinstance(reconstruction.get("wind"), Mapping):
            continue
        north, east = reconstruction["wind"]["ned"][:2]
        speed, from_deg = math.hypot(north, east), math.degrees(math.atan2(-east, -north)) % 360.0
        std = max(reconstruction["wind"]["std"][:2])
        lines.append(f"wind of {flight.name}: {speed:.1f} +- {std:.1f} m/s from {from_deg:.0f} deg")
        winds.append({"flight": flight.name, "speed": speed, "from_deg": from_deg, "std": std})
    return winds


def _modes(flights: Sequence[Flight], model: str, lines: list[str]) -> list[dict[str, Any]]:
    """Frequencies and dampings, where an estimate is recommended; adds to `lines`."""
    from estimation.answers.estimates import estimate
    from estimation.report.modes import modes_with_spread

    stand_in = replace(load_aircraft(STAND_IN), name="not stated")
    try:
        session = estimate(list(flights), model, "ml", aircraft=stand_in, joint=len(flights) > 1).session
    except UserError as error:
        lines.append(f"natural motion: {error}")
        return []
    judged = session.verdict or session.flights[0].verdict
    result = next(iter((session.joint or session.flights[0].results).values()), None)
    if result is None or judged is None or judged.recommended.method == "none":
        reason = judged.recommended.why if judged is not None else session.text
        lines.append(f"natural motion: cannot tell: {reason}")
        return []
    modes = []
    for m in modes_with_spread(result, session.flights[0].flight, np.random.default_rng(SEED)):
        periodic = np.isfinite(m.mode.damping)
        text = f"{m.mode.name}: {m.mode.speed:.3g} +- {m.speed_spread:.2g} {'rad/s' if periodic else '1/s'}"
        lines.append(text + (f", damping ratio {m.mode.damping:.3g} +- {m.damping_spread:.2g}" if periodic else ""))
        modes.append(
            {
                "mode": m.mode.name, "speed": m.mode.speed, "std": m.speed_spread,
                "damping": m.mode.damping if periodic else None, "damping_std": m.damping_spread if periodic else None,
            }
        )  # fmt: skip
    return modes
