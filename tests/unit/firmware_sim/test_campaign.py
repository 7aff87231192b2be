"""Campaigns: several flights of one aircraft."""

from pathlib import Path

import numpy as np
import pytest

from firmware_sim.runs.campaign import CampaignFlights
from firmware_sim.world.simulation import derivatives_of
from groundstation.flight import read_flight
from tests.unit.firmware_sim.campaigns import fly_campaigns, write_campaign


def test_flights_of_a_campaign_share_the_aircraft_but_not_the_day() -> None:
    plan = CampaignFlights(seed=3).scenarios()
    truths = [derivatives_of(scenario, seed) for scenario, seed in plan]
    assert all(truth == truths[0] for truth in truths)
    assert len({seed for _, seed in plan}) == len(plan) == 4
    other = derivatives_of(*CampaignFlights(seed=4).scenarios()[0])
    assert other != truths[0]


def test_a_campaign_is_flown_at_its_speeds_and_written_as_flights(tmp_path: Path) -> None:
    campaign = CampaignFlights(
        hidden=(("Cn_da", 1.0),), seed=2, duration_s=4.0, training_speeds=(15.0,), holdout_speeds=(19.0,)
    )
    (flown,) = fly_campaigns([campaign])
    training, holdout = write_campaign(flown, tmp_path)
    assert [p.name for p in training + holdout] == ["flight_0.csv", "flight_1.csv"]
    for path, speed in ((training[0], 15.0), (holdout[0], 19.0)):
        assert np.mean(read_flight(path).columns["V"]) == pytest.approx(speed, abs=0.5)


def test_many_campaigns_come_back_in_order() -> None:
    short = {"duration_s": 3.0, "training_speeds": (16.0,), "holdout_speeds": ()}
    plain, hidden, again = fly_campaigns(
        [
            CampaignFlights(seed=1, **short),
            CampaignFlights(seed=1, hidden=(("beta_scale", 3.0),), **short),
            CampaignFlights(seed=1, **short),
        ]
    )
    assert np.array_equal(plain.training[0]["beta"], again.training[0]["beta"])
    assert not np.allclose(plain.training[0]["beta"], hidden.training[0]["beta"], atol=1e-4)
    assert plain.holdout == []
