"""Campaigns flown side by side through the direct sensor model, which stands in for the bus."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from firmware_sim.runs.campaign import CampaignFlights
from firmware_sim.runs.direct import ORDINARY_NOISE, DirectNoise, direct_flights, write_csv


@dataclass(frozen=True, slots=True)
class FlownCampaign:
    """Flight columns of a campaign, each a mapping of name to (samples,)."""

    training: list[dict[str, NDArray[np.float64]]]
    holdout: list[dict[str, NDArray[np.float64]]]


def fly_campaigns(campaigns: Sequence[CampaignFlights], noise: DirectNoise = ORDINARY_NOISE) -> list[FlownCampaign]:
    """Fly many campaigns side by side; those that hide the same names share the arrays."""
    planned = [campaign.scenarios() for campaign in campaigns]
    flat = [item for plan in planned for item in plan]
    flown = iter(direct_flights([s for s, _ in flat], [seed for _, seed in flat], noise))
    out = []
    for campaign, plan in zip(campaigns, planned, strict=True):
        flights = [next(flown) for _ in plan]
        first = len(campaign.training_speeds)
        out.append(FlownCampaign(flights[:first], flights[first:]))
    return out


def write_campaign(flown: FlownCampaign, folder: Path) -> tuple[list[Path], list[Path]]:
    """Write flight_0.csv, flight_1.csv, ... into `folder`; returns training and held-out paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for k, columns in enumerate([*flown.training, *flown.holdout]):
        paths.append(folder / f"flight_{k}.csv")
        write_csv(paths[-1], columns)
    return paths[: len(flown.training)], paths[len(flown.training) :]
