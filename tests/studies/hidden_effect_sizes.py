"""How visible each hidden effect is at its typical size: residual over noise after the ordinary lateral model is refitted.

    python -m tests.studies.hidden_effect_sizes [NAME...]

Three rich flights at 14.5, 16.5 and 19 m/s in gusts of 0.15 degrees, 20 Hz, direct sensor model, fitted together by output
error. Printed per effect: rms of residual / noise per output, null flights first. The last result is in docs/simulator.md.
"""

import sys

import numpy as np

from estimation import load_model, output_error
from firmware_sim.physics.effects.registry import EFFECTS
from firmware_sim.runs.campaign import CampaignFlights
from firmware_sim.runs.direct import ORDINARY_NOISE
from groundstation.flight import Flight
from tests.unit.firmware_sim.campaigns import fly_campaigns

OUTPUTS = ("beta", "p", "r", "phi", "ay")


def visibility(hidden: tuple[tuple[str, float], ...], seed: int) -> dict[str, float]:
    """rms of residual / noise per output after the refit; empty when the fit did not converge."""
    (flown,) = fly_campaigns([CampaignFlights(hidden=hidden, seed=seed)])
    flights = [
        Flight(
            f"f{k}", c["time"], {n: v for n, v in c.items() if n != "time"}, np.zeros(len(c["time"]), dtype=np.int64)
        )
        for k, c in enumerate(flown.training)
    ]
    result = output_error(load_model("lateral", "cdfp"), flights)
    residuals = np.concatenate([np.asarray(flight.residuals) for flight in result.flights])
    return {
        name: float(np.sqrt(np.nanmean(residuals[:, k] ** 2))) / float(getattr(ORDINARY_NOISE, name))
        for k, name in enumerate(OUTPUTS)
    }


def main() -> None:
    """Print the table."""
    names = sys.argv[1:] or list(EFFECTS)
    print("| effect | group | typical | " + " | ".join(OUTPUTS) + " |")
    print("|---|---|---|" + "---|" * len(OUTPUTS))
    for seed in (1, 2):
        print(f"| none ({seed}) | | | " + " | ".join(f"{v:.2f}" for v in visibility((), seed).values()) + " |")
    for name in names:
        effect = EFFECTS[name]
        seen = visibility(((name, 1.0),), 1)
        print(
            f"| `{name}` | {effect.group} | {effect.typical:.3g} {effect.unit} | "
            + " | ".join(f"{v:.2f}" for v in seen.values())
            + " |",
            flush=True,
        )


if __name__ == "__main__":
    main()
