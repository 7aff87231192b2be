"""What each fault looks like in the scans that the real sampler makes: the sensor concerned is marked, others are whole."""

import math

import numpy as np
import pytest

from daq.contract.channels import channels_of
from daq.contract.scan import SensorState
from firmware_sim.hardware.bus import BusModel
from firmware_sim.hardware.sensing.sensor_models import SensorModels
from tests.unit.firmware_sim.hardware import truth_at_rest
from tests.unit.firmware_sim.scans import ON_BUS, all_well, between, standing, states

OK, ABSENT, STUCK, RECOVERING = SensorState.OK, SensorState.ABSENT, SensorState.STUCK, SensorState.RECOVERING


def test_a_healthy_aircraft() -> None:
    scans, aircraft, _ = standing(duration_s=4.0)
    assert all_well(scans)
    assert [s.number for s in scans] == list(range(len(scans)))
    last = scans[-1].values
    assert last["accel_z"] == pytest.approx(-4096, abs=150)
    assert last["static_pressure"] > 0
    late = scans[10:]  # before that, those that came while the load cell settled are caught up with
    fixes = [s for s in late if "gnss_fix" in s.values]
    assert len(fixes) == pytest.approx(10 * (late[-1].time - late[0].time), abs=2)
    assert aircraft.bus.busy_ns < 0.3 * scans[-1].time_monotonic_ns


@pytest.mark.parametrize("device", ON_BUS)
def test_unplugged_and_back(device: str) -> None:
    """Marked within two scans; everything else complete; the return noticed within three seconds."""
    scans, _, sampler = standing({"kind": "absent", "device": device, "start_s": 2.0, "stop_s": 4.0}, duration_s=8.0)
    gone = between(scans, 2.0, 4.0)
    mine = {device, "mag"} if device == "imu" else {device}  # one package
    assert all(state is not OK for state in states(gone[2:], device))
    assert states(gone[4:], device)[-1] is ABSENT
    for channel in channels_of(device):
        assert all(channel.name not in s.values for s in gone[2:])
    assert all_well(gone, but=tuple(mine))
    assert all_well(between(scans, 0.0, 2.0))
    assert states(scans, device)[-1] is OK
    assert RECOVERING in states(between(scans, 4.0, 8.0), device)
    assert sampler.health().group(device).state is OK


def test_unplugged_gps_and_back() -> None:
    scans, _, _ = standing({"kind": "absent", "device": "gnss", "start_s": 2.0, "stop_s": 6.0}, duration_s=9.0)
    assert all("gnss_fix" not in s.values for s in between(scans, 2.3, 6.0))
    assert states(between(scans, 5.0, 6.0), "gnss")[-1] is not OK
    assert all_well(scans)
    assert states(scans, "gnss")[-1] is OK


def test_never_there() -> None:
    scans, _, sampler = standing({"kind": "absent", "device": "thrust"}, duration_s=3.0)
    assert set(states(scans, "thrust")) == {ABSENT}
    assert all_well(scans, but=("thrust",))
    assert "does not answer" in sampler.health().words


def test_single_refusals_are_repeated_and_cost_nothing() -> None:
    scans, _, sampler = standing({"kind": "nack", "device": "pitot", "probability": 0.05}, duration_s=6.0)
    share = np.mean([state is OK for state in states(scans, "pitot")])
    assert share > 0.9
    assert sampler.health().group("pitot").retries > 0
    assert all_well(scans, but=("pitot",))


def test_bus_held_low_and_released() -> None:
    scans, _, _ = standing({"kind": "stuck_bus", "start_s": 2.0, "stop_s": 3.0}, duration_s=7.0)
    held = between(scans, 2.2, 3.0)
    assert held  # scans go on
    assert all(s.lateness_us < 50_000 for s in scans)
    assert all(s.groups[g].state is not OK for s in held for g in ON_BUS if g in s.groups)
    assert any("gnss_fix" in s.values for s in held)
    assert all_well(scans[-10:])


def test_slow_bus_stays_in_time() -> None:
    scans, _, _ = standing({"kind": "slow_bus", "size": 8.0, "start_s": 2.0, "stop_s": 4.0}, duration_s=7.0)
    assert len(scans) == pytest.approx(20 * (scans[-1].time - scans[0].time) + 1, abs=1)
    assert all_well(scans[-10:])


@pytest.mark.parametrize(
    ("device", "group", "channel"),
    [
        ("imu", "imu", "gyro_x"),
        ("mag", "mag", "mag_x"),
        ("beta_vane", "analog_a", "beta_vane"),
        ("pitot", "pitot", "pitot_pressure"),
        ("static", "static", "static_pressure"),
        ("thrust", "thrust", "thrust_load"),
    ],
)
def test_stuck_value(device: str, group: str, channel: str) -> None:
    scans, _, sampler = standing(
        {"kind": "stuck_value", "device": device, "start_s": 2.0, "stop_s": 7.0}, duration_s=9.0
    )
    stuck = between(scans, 2.1, 7.0)
    assert len({s.values[channel] for s in stuck if channel in s.values}) == 1
    assert states(stuck, group)[-1] is STUCK
    assert all_well(scans, but=(group,))
    assert states(scans, group)[-1] is OK
    assert sampler.health().group(group).state is OK


def test_spikes_are_marked() -> None:
    line = {"kind": "spikes", "device": "pitot", "probability": 0.05, "size": 3000.0, "start_s": 2.0}
    scans, _, _ = standing(line, duration_s=10.0)
    rest = np.median([s.values["pitot_pressure"] for s in between(scans, 0.0, 2.0)])
    off = [s for s in scans if abs(s.values.get("pitot_pressure", rest) - rest) > 1000]
    assert off
    assert all(s.groups["pitot"].state is not OK for s in off)
    clean = [s for s in between(scans, 2.0, 10.0) if s.groups["pitot"].state is OK]
    assert len(clean) > 0.7 * 160


def test_torn_gps_messages_lose_only_themselves() -> None:
    scans, _, _ = standing({"kind": "torn_gnss", "probability": 0.3, "start_s": 1.0}, duration_s=12.0)
    fixes = [s.values for s in between(scans, 1.5, 12.0) if "gnss_fix" in s.values]
    assert len(fixes) == pytest.approx(0.7 * 105, abs=20)
    assert all(f["latitude_e7"] == pytest.approx(260_000_000, abs=1000) for f in fixes)


def test_power_dip_resets_all_chips_and_they_come_back() -> None:
    scans, _, sampler = standing({"kind": "power_dip", "start_s": 2.02, "stop_s": 2.025}, duration_s=8.0)
    after = between(scans, 2.05, 4.0)
    assert any(s.groups["imu"].state is not OK for s in after)
    for scan in scans:  # a chip at its reset ranges must never pass as good
        if scan.groups["imu"].state is OK:
            assert scan.values["accel_z"] == pytest.approx(-4096, abs=200)
    assert all_well(scans[-10:])
    assert states(scans, "gnss")[-1] is OK
    assert sampler.health().ready


def test_clock_step_is_survived() -> None:
    """The machine's UTC jumps; monotonic time and the UTC from GPS do not."""
    scans, aircraft, _ = standing({"kind": "clock_step", "start_s": 3.0, "size": 3600.0}, duration_s=6.0)
    intervals = np.diff([s.time_monotonic_ns for s in scans])
    assert np.all(np.abs(intervals - 50e6) < 2e6)
    known = [s for s in scans if s.time_utc_ns]
    offsets = np.array([s.time_utc_ns - s.time_monotonic_ns for s in known]) * 1e-9
    assert np.ptp(offsets[20:]) < 0.1
    assert aircraft.clock.utc_ns() - aircraft.clock.monotonic_ns() == pytest.approx(offsets[-1] * 1e9 + 3600e9, abs=1e9)


def test_scans_do_not_depend_on_luck() -> None:
    first, _, _ = standing(duration_s=2.0, seed=5)
    again, _, _ = standing(duration_s=2.0, seed=5)
    other, _, _ = standing(duration_s=2.0, seed=6)
    assert first == again
    assert [s.values for s in first] != [s.values for s in other]


@pytest.mark.parametrize("stated", [True, False])
def test_chip_turned_on_its_board_is_turned_back_by_the_configured_mounting(stated: bool) -> None:
    """Stated by the scenario as a matrix too, or left out: the simulated chip then sits as the logger has it mounted."""
    from daq.sensors.icm20948 import ImuConfig
    from tests.unit.daq.cdfp_fit import cdfp_sensors

    # body x lies along chip y, body y along chip z, body z along chip x
    matrix = ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
    models = SensorModels().altered(imu={"body_from_chip": matrix}) if stated else SensorModels()
    config = cdfp_sensors().model_copy(update={"imu": ImuConfig(mounting=("+y", "+z", "+x"))})
    truth = truth_at_rest(ax=2.0, ay=-3.0, p=0.5, q=-0.2, r=0.1, magnetic=(20e-6, -10e-6, 40e-6))
    scans, _, _ = standing(models=models, config=config, truth=truth, duration_s=3.0)
    mean = {
        name: np.mean([s.values[name] for s in scans])
        for name in ("accel_x", "accel_y", "accel_z", "gyro_x", "mag_y", "mag_z")
    }
    assert mean["accel_x"] == pytest.approx(2.0 / 9.80665 * 4096, abs=30)
    assert mean["accel_y"] == pytest.approx(-3.0 / 9.80665 * 4096, abs=30)
    assert mean["accel_z"] == pytest.approx(-4096, abs=30)
    assert mean["gyro_x"] == pytest.approx(math.degrees(0.5) * 65.5, abs=15)
    assert mean["mag_y"] == pytest.approx(-10.0 / 0.15, abs=2)
    assert mean["mag_z"] == pytest.approx(40.0 / 0.15, abs=2)


@pytest.mark.parametrize(("rate_hz", "frequency_hz"), [(200.0, 400e3), (1000.0, 1e6)])
def test_fast_scans_on_a_fast_bus(rate_hz: float, frequency_hz: float) -> None:
    models = SensorModels(bus=BusModel(frequency_hz=frequency_hz, overhead_us=20.0))
    scans, _, _ = standing(models=models, rate_hz=rate_hz, duration_s=1.5)
    imu = [s for s in scans if s.groups.get("imu") and s.groups["imu"].state is OK]
    assert len(imu) > 0.9 * len(scans)
    assert np.median(np.diff([s.time_monotonic_ns for s in scans])) == pytest.approx(1e9 / rate_hz, rel=0.01)
