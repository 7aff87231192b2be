"""Curves over the envelope from tables of estimates with known truth: coverage of bands, bad flights told, good ones left alone.

    python -m tests.studies.aerodynamic_database [-n 60]

Estimates are drawn as those of `tests/unit/estimation/campaign/aerodynamics/test_envelope_curves.py`; seconds,
for no flight is flown.
"""

import click
import numpy as np

from tests.unit.estimation.campaign.aerodynamics.test_envelope_curves import (
    NAMES,
    SLOPES,
    conditions,
    curves_of,
    estimates,
    truth,
)

OFF = 8.0  # bounds that one parameter of a bad flight is off


def campaigns(flights: int, count: int) -> dict[str, float]:
    """Shares over `count` campaigns of so many flights."""
    inside, points, wrong, told = np.zeros(len(NAMES)), 0, 0, 0
    for seed in range(count):
        rng = np.random.default_rng([flights, seed])
        at, values, std, _ = estimates(rng, flights, SLOPES)
        found = curves_of(at, values, std)
        wrong += int((~found.sound).sum())
        held = conditions(rng, 60)
        near = found.flown(held)
        points += int(near.sum())
        for j in range(len(NAMES)):
            value, spread = found.at(j, held)
            inside[j] += np.sum((np.abs(value - truth(held, SLOPES)[:, j]) < found.half_band(j, spread))[near])
        bad = rng.choice(flights, 3, replace=False)
        for i in bad:
            j = int(rng.integers(len(NAMES)))
            values[i, j] += rng.choice([-1.0, 1.0]) * OFF * std[i, j]
        told += len(set(np.flatnonzero(~curves_of(at, values, std).sound)) & set(bad))
    each = {f"{n} in 95 %": float(c / points) for n, c in zip(NAMES, inside, strict=True)}
    return {"flights": flights, **each, "bad told": told / (3 * count), "good told, a campaign": wrong / count}


@click.command()
@click.option("-n", "count", default=60)
def main(count: int) -> None:
    """A line for each size of campaign."""
    for flights in (30, 60, 150):
        print({k: round(v, 3) for k, v in campaigns(flights, count).items()}, flush=True)


if __name__ == "__main__":
    main()
