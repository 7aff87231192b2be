"""A pitot that nobody zeroed: named before flight, zeroed by the logger itself where the aircraft rests, never in motion."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from daq.contract.channels import CHANNEL_BY_NAME
from daq.contract.link.commands import parse_pitot_zero
from daq.contract.scan import Scan
from daq.service.preflight import run_preflight
from daq.telemetry.flight_state import PITOT_CENTRE, PITOT_PA_PER_COUNT, flight_evidence
from daq.telemetry.pitot_zero import REST_S, SETTLING_S, PitotZero
from firmware_sim.hardware.card import SimulatedCard
from firmware_sim.runs.flight import prepare_flight
from firmware_sim.world.scenario import load_scenario

RATE = 20.0


def scan(number: int, offset_pa: float, speed: float | None = 0.0, rate: float = 0.0) -> Scan:
    noise = np.random.default_rng(number).normal(0.0, 2.5)
    gyro = CHANNEL_BY_NAME["gyro_x"].scale or 1.0
    count = round(PITOT_CENTRE + offset_pa / PITOT_PA_PER_COUNT + noise)
    values = {"pitot_pressure": count, "gyro_x": round(rate / gyro)}
    if speed is not None:
        values |= {"gnss_fix": 3, "velocity_north_mm": round(1e3 * speed), "velocity_east_mm": 0}
    return Scan(number, number, 0, 0, 0, {}, values)


def zeros(make: Callable[[int], Scan], count: int) -> list[float]:
    zero = PitotZero(RATE)
    texts = [text for n in range(count) if (text := zero.look(make(n))) is not None]
    return [count for text in texts if (count := parse_pitot_zero(text)) is not None]


@pytest.mark.parametrize("offset_pa", [-140.0, 3.0, 40.0, 130.0])
def test_an_aircraft_at_rest_is_zeroed_whatever_its_sensor_reads(offset_pa: float) -> None:
    assert flight_evidence([scan(n, offset_pa) for n in range(40)]) is None
    (zero,) = zeros(lambda n: scan(n, offset_pa), round((REST_S + SETTLING_S) * RATE) + 5)
    assert zero == pytest.approx(PITOT_CENTRE + offset_pa / PITOT_PA_PER_COUNT, abs=1.0)


@pytest.mark.parametrize(
    "make",
    [
        lambda n: scan(n, 180.0, speed=17.0),
        lambda n: scan(n, 180.0, speed=None),
        lambda n: scan(n, 5.0, rate=0.4),
        lambda n: scan(n, 40.0 * (n % 2)),
    ],
    ids=["moving", "no fix", "turning", "gusts"],
)
def test_nothing_else_is_zeroed(make: Callable[[int], Scan]) -> None:
    assert zeros(make, 400) == []


def test_the_newest_zero_follows_a_sensor_that_warms_up() -> None:
    found = zeros(lambda n: scan(n, 40.0 - 0.02 * n), 1500)
    assert len(found) >= 2
    assert found[-1] < found[0] - 5.0


@pytest.mark.parametrize(
    ("offset_pa", "auto", "verdict"), [(0.0, False, "go"), (38.0, False, "no-go"), (38.0, True, "go")]
)
def test_preflight_says_what_the_pitot_reads_at_rest(
    tmp_path: Path, offset_pa: float, auto: bool, verdict: str
) -> None:
    text = (
        f"[flight]\nduration_s = 20.0\nseed = 4\n[ground]\nbefore_s = 12.0\n[sensors.pitot]\noffset_pa = {offset_pa}\n"
    )
    (tmp_path / "still.toml").write_text(text)
    with prepare_flight(load_scenario(str(tmp_path / "still.toml")), tmp_path / "out") as flight:
        flight.clock.drive()
        limits = flight.config.preflight.model_copy(update={"auto_zero_pitot": auto})
        config = flight.config.model_copy(update={"preflight": limits})
        card = SimulatedCard(flight.aircraft.faults, flight.clock)
        table = run_preflight(config, flight.clock, flight.assembly.sampler, card)
    (check,) = [c for c in table.checks if c.name == "pitot at rest"]
    assert check.verdict.value == verdict
    assert ("(8 m/s)" in check.text) == (offset_pa > 0.0)
