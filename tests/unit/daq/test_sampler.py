"""Scans of the simulated aircraft: complete, in time, truthful, and true to each fault."""

import math
from dataclasses import replace

import numpy as np
import pytest

from daq.acquisition.sampler import Sampler
from daq.clock import SimulatedClock
from daq.contract.channels import CHANNELS, GROUP_NAMES, channels_of
from daq.contract.scan import SensorState, decode_scan, encode_scan
from daq.sensors.ads1115 import AnalogConfig
from daq.sensors.config import SensorsConfig
from daq.sensors.icm20948 import ImuConfig
from daq.sensors.nau7802 import ThrustConfig
from firmware_sim.hardware.bus import BusModel
from firmware_sim.hardware.sensing.instruments import AT
from firmware_sim.world.scenario import load_scenario
from firmware_sim.world.truth import Truth
from firmware_sim.world.world import World
from tests.unit.daq.cdfp_fit import cdfp_sensors
from tests.unit.daq.fakes import FakeBus, FakeChip
from tests.unit.daq.rig import UTC0, moment, rig, states
from tests.unit.firmware_sim.truth_log import TruthLog

OK = SensorState.OK
ON_BUS = ("imu", "mag", "analog_a", "analog_b", "analog_c", "pitot", "static", "thrust", "capture")


def complete(scan_values: object, group: str) -> bool:
    return all(c.name in scan_values for c in channels_of(group))  # type: ignore[operator]


def test_every_channel_arrives_and_survives_the_recording_format() -> None:
    r = rig()
    scans = r.fly(6.0)
    assert r.sampler.health().ready
    seen = set().union(*(s.values for s in scans[-40:]))
    fitted = cdfp_sensors().fitted
    # the simulated aircraft wires all six PWM inputs
    assert seen == {c.name for c in CHANNELS if c.group in fitted}
    assert set(scans[-1].groups) == set(GROUP_NAMES)
    assert all(scans[-1].groups[g].state is OK for g in fitted)
    for scan in scans:
        for channel in CHANNELS:
            low, high = channel.limits()
            assert low <= scan.values.get(channel.name, low) <= high
        assert decode_scan(encode_scan(scan)) == scan


def test_scan_takes_a_fifth_of_its_interval_and_vanes_are_read_with_the_imu() -> None:
    r = rig()
    scan = r.fly(4.0)[-1]
    assert r.longest_ns < 11_000_000  # 10.3 ms of bus and software time are budgeted at 100 us per transfer
    facts = r.sampler.metadata()
    alpha = scan.groups["analog_a"].offset_us + 1e6 * float(facts["analog_a.alpha_vane_after_s"])
    assert abs(alpha - scan.groups["imu"].offset_us) < 500
    beta = scan.groups["analog_a"].offset_us + 1e6 * float(facts["analog_a.beta_vane_after_s"])
    assert abs(beta - scan.groups["imu"].offset_us) < 2500


def test_counts_mean_what_the_channel_table_says() -> None:
    """The physical world of the simulated chips, recovered through the table's transfer functions."""
    r = rig()
    scans = r.fly(6.0)
    truth, now = moment(), r.clock.monotonic_ns()
    signals = r.aircraft.instruments

    def mean(name: str) -> float:
        channel = next(c for c in CHANNELS if c.name == name)
        values = [s.values[name] * (channel.scale or 1.0) + channel.offset for s in scans[-60:] if name in s.values]
        return sum(values) / len(values)

    shown = signals.at(now)
    for axis in "xyz":
        assert mean(f"accel_{axis}") == pytest.approx(shown[AT[f"accel_{axis}"]], abs=0.03)
        assert mean(f"gyro_{axis}") == pytest.approx(shown[AT[f"gyro_{axis}"]], abs=0.002)
        assert mean(f"mag_{axis}") == pytest.approx(shown[AT[f"mag_{axis}"]], abs=0.3e-6)
    for name in ("alpha_vane", "beta_vane", "elevon_left_pot", "rudder_pot", "supply", "analog_5"):
        assert mean(name) == pytest.approx(shown[AT[name]], abs=3e-3)
    facts = r.sampler.metadata()
    pascal = mean("pitot_pressure") * float(facts["pitot.scale_pa"]) + float(facts["pitot.offset_pa"])
    assert pascal == pytest.approx(shown[AT["pitot_pressure"]], abs=1.5)
    assert mean("pwm_1") == pytest.approx(shown[AT["pwm_1"]], abs=2e-6)
    latitude, height = mean("latitude_e7"), mean("height_msl_mm")
    assert latitude == pytest.approx(float(truth.latitude), abs=1e-4)
    assert height == pytest.approx(float(truth.altitude), abs=5.0)


def test_unmounted_chip_axes_are_turned_back() -> None:
    """The same board read with another mounting gives the turned vector."""
    straight = rig().fly(2.0)[-1].values
    section = ImuConfig(mounting=("-y", "+x", "+z"))
    turned = rig(config=cdfp_sensors().model_copy(update={"imu": section})).fly(2.0)[-1].values
    assert turned["accel_x"] == pytest.approx(-straight["accel_y"], abs=60)
    assert turned["accel_y"] == pytest.approx(straight["accel_x"], abs=60)
    assert turned["mag_x"] == pytest.approx(-straight["mag_y"], abs=8)


def test_attitude_agrees_with_the_aircraft_through_a_flight() -> None:
    """Half a minute of flight with doublets, from the ground on; the attitude is the filter's at the IMU's (delayed) time."""
    truth = TruthLog(World(load_scenario("nominal"), 1))
    r = rig(source=truth)
    times, measured = [], []
    for scan in r.fly(30.0):
        if scan.groups["attitude"].state is OK:
            w, x, y, z = (scan.values[f"quaternion_{c}"] / 32767 for c in "wxyz")
            times.append(scan.time - 5.0 - 0.0137)  # the gyro's filter
            measured.append((math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)), math.asin(2 * (w * y - z * x))))
    true = truth.at(np.array(times))
    bank, pitch = (np.array(measured) - np.stack([true["phi"], true["theta"]], axis=1)).T
    assert len(bank) > 400
    assert np.degrees(np.std((bank, pitch), axis=1)) == pytest.approx((0.0, 0.0), abs=0.8)
    # what stays is the accelerometer's own bias, up to 0.1 m/s2, which no plumb line can tell from a tilt
    assert np.degrees(np.mean((bank, pitch), axis=1)) == pytest.approx((0.0, 0.0), abs=0.8)
    assert math.degrees(float(np.max(np.abs((bank, pitch))))) < 3.0


@pytest.mark.parametrize("device", [*ON_BUS, "gnss"])
def test_unplugged_sensor_is_marked_and_its_return_noticed(device: str) -> None:
    r = rig(({"kind": "absent", "device": device, "start_s": 3.0, "stop_s": 6.0},))
    r.fly(1.0)
    while r.clock.monotonic_ns() < 8_000_000_000:
        r.fly(0.05)
    away = r.fly(2.8)
    patience = 5 if device == "gnss" else 2  # its next fix was due two scans later; two scans after that it is missing
    affected = {device, *(("mag", "attitude") if device == "imu" else ())}
    after = away[patience:]
    assert all(not s.groups[device].state.usable for s in after)
    assert not any(c.name in s.values for s in after for c in channels_of(device))
    for other in set(ON_BUS) - affected:
        assert all(st is OK for st in states(away, other)), other
        assert all(complete(s.values, other) for s in away), other
    assert r.sampler.health().group(device).detail
    r.fly(4.0)
    for group in affected:
        assert states(r.fly(1.0), group)[-1] is OK
    assert r.sampler.health().group(device).setups == 2


def test_return_is_marked_recovering_before_it_counts() -> None:
    r = rig(({"kind": "absent", "device": "pitot", "start_s": 1.0, "stop_s": 2.0},))
    seen = states(r.fly(6.0), "pitot")
    runs = [s for i, s in enumerate(seen) if i == 0 or s is not seen[i - 1]]
    assert runs == [OK, SensorState.ABSENT, SensorState.RECOVERING, OK]
    assert seen.count(SensorState.RECOVERING) == 5


def test_single_nacks_cost_no_sample() -> None:
    """One transfer in fifty refused: the repetition within the scan brings the sample all the same."""
    r = rig(({"kind": "nack", "device": "imu", "probability": 0.02, "start_s": 0.5},))
    scans = r.fly(20.0)
    assert r.sampler.health().group("imu").retries > 5
    assert sum(st is OK for st in states(scans, "imu")) > 0.99 * len(scans)
    assert all(st is OK for st in states(scans, "pitot"))


def test_one_refusal_in_five_costs_no_vane_sample() -> None:
    """A sample of a converter takes twelve transfers: they are repeated one by one, and the repetitions counted."""
    r = rig(({"kind": "nack", "device": "analog_a", "probability": 0.2, "start_s": 1.0},))
    scans = r.fly(10.0)
    assert sum(st is OK for st in states(scans, "analog_a")) > 0.98 * len(scans)
    assert r.sampler.health().group("analog_a").retries > 300
    assert all(st is OK for st in states(scans, "imu"))


def test_nack_storm_never_stops_the_scan() -> None:
    r = rig(tuple({"kind": "nack", "device": d, "probability": 0.5, "start_s": 1.0, "stop_s": 4.0} for d in ON_BUS))
    scans = r.fly(10.0)
    assert r.longest_ns < 50_000_000
    assert len(scans) == 200
    assert all(st.state in (OK, SensorState.OFF) for st in scans[-1].groups.values())


def test_held_bus_is_named_and_costs_bounded_time() -> None:
    r = rig(({"kind": "stuck_bus", "start_s": 2.0, "stop_s": 5.0},))
    r.fly(1.0)
    r.longest_ns = 0
    held = r.fly(3.0)
    assert r.longest_ns < 30_000_000
    assert "held low" in r.sampler.health().bus_fault
    assert not r.sampler.health().ready
    assert all(states(held[-10:], g)[0] is SensorState.ABSENT for g in ON_BUS)
    assert sum("gnss_itow" in s.values for s in held) > 25  # the serial line goes on
    r.fly(2.0)
    assert all(states(r.fly(0.05), g) == [OK] for g in ON_BUS)
    assert r.sampler.health().bus_fault == ""
    assert all(r.sampler.health().group(g).setups == 1 for g in ON_BUS)  # nothing was lost but time
    r.fly(3.0)
    assert r.sampler.health().ready


def test_slow_bus_drops_the_least_important_and_keeps_the_deadline() -> None:
    r = rig(({"kind": "slow_bus", "size": 12.0, "start_s": 1.0, "stop_s": 4.0},))
    r.fly(1.0)
    slow = r.fly(2.5)
    assert all(st is OK for st in states(slow[5:], "imu"))
    assert all(st is OK for st in states(slow[5:], "pitot"))
    for group in ON_BUS:  # the others take turns
        assert sum(st is OK for st in states(slow[5:], group)) >= len(slow) / 10, group
    late = max(s.lateness_us for s in slow)
    assert late < 10_000
    r.fly(2.0)
    assert all(st.state in (OK, SensorState.OFF) for st in r.fly(1.0)[-1].groups.values())


@pytest.mark.parametrize(
    ("device", "group", "limit_s"),
    [("imu", "imu", 1.0), ("beta_vane", "analog_a", 2.0), ("pitot", "pitot", 3.0), ("static", "static", 1.0)],
)
def test_stuck_value_is_seen(device: str, group: str, limit_s: float) -> None:
    r = rig(({"kind": "stuck_value", "device": device, "start_s": 2.0, "stop_s": 7.0},))
    r.fly(1.2)
    before = r.fly(limit_s)
    assert SensorState.STUCK not in states(before, group)[: int(limit_s * 20 * 0.7)]
    stuck = r.fly(2.0)
    assert states(stuck, group)[-1] is SensorState.STUCK
    assert device.split("_", maxsplit=1)[0] in r.sampler.health().group(group).detail or group in ("imu", "static")
    assert complete(stuck[-1].values, group)  # what the chip said is kept
    r.fly(4.0)
    assert states(r.fly(1.0), group)[-1] is OK


def test_spikes_are_marked_and_a_new_level_is_accepted() -> None:
    r = rig(({"kind": "spikes", "device": "beta_vane", "size": 2.0, "probability": 0.05, "start_s": 1.0},))
    scans = r.fly(20.0)
    usual = sorted(s.values["beta_vane"] for s in scans)[len(scans) // 2]
    off = [abs(s.values["beta_vane"] - usual) > 12000 for s in scans]
    for i, scan in enumerate(scans):
        if off[i] and not any(off[max(0, i - 2) : i]):  # two spikes that agree look like a new level
            assert scan.groups["analog_a"].state is SensorState.OUT_OF_RANGE
    marked = [s for s in states(scans, "analog_a") if s is SensorState.OUT_OF_RANGE]
    assert 5 < len(marked) < 45


def test_supply_dip_resets_all_chips_and_all_come_back_with_their_settings() -> None:
    r = rig(({"kind": "power_dip", "start_s": 3.0, "stop_s": 3.02},))
    before = r.fly(2.2)[-1].values
    r.fly(12.0)
    scan = r.fly(1.0)[-1]
    assert all(st.state in (OK, SensorState.OFF) for st in scan.groups.values())
    for name in ("accel_z", "alpha_vane", "mag_z", "pwm_1"):
        assert scan.values[name] == pytest.approx(before[name], rel=0.02, abs=40)
    setups = {g: r.sampler.health().group(g).setups for g in ON_BUS}
    # converters and the pitot sensor keep no state between samples
    assert all(setups[g] == 2 for g in ("imu", "mag", "static", "thrust", "capture")), setups


def test_supply_dip_between_two_scans_is_noticed_within_two() -> None:
    r = rig(({"kind": "power_dip", "start_s": 3.025, "stop_s": 3.03},))
    scans = r.fly(4.0)
    dip = 5.0 + 3.025
    first = next(i for i, s in enumerate(scans) if s.time > dip)
    for group in ("imu", "capture", "static", "thrust", "mag"):
        assert not scans[first + 1].groups[group].state.usable, group


def test_torn_gps_messages_cost_only_themselves() -> None:
    r = rig(({"kind": "torn_gnss", "probability": 0.3, "start_s": 4.0, "stop_s": 14.0},))
    scans = r.fly(13.0)[100:]
    fixes = [s.values["gnss_itow"] for s in scans if "gnss_itow" in s.values]
    assert fixes == sorted(set(fixes))
    assert 0.5 * len(scans) / 2 < len(fixes) < 0.9 * len(scans) / 2


def test_utc_comes_from_gps_and_survives_a_step_of_the_machine_clock() -> None:
    r = rig(({"kind": "clock_step", "size": 7200.0, "start_s": 8.0},))
    for scan in r.fly(14.0)[-120:]:
        true = UTC0 + scan.time_monotonic_ns - 5_000_000_000
        assert scan.utc_accuracy_ns > 0
        assert abs(scan.time_utc_ns - true) < 3 * scan.utc_accuracy_ns + 5_000_000
    offsets = [s.groups["gnss"].offset_us for s in r.fly(2.0) if "gnss_itow" in s.values]
    assert all(-250_000 < o < 0 for o in offsets)  # a fix is older than its message


def test_groups_not_fitted_are_off_and_leave_no_values() -> None:
    config = SensorsConfig(imu=ImuConfig(), analog_b=AnalogConfig(address=0x49))
    r = rig(config=config)
    scan = r.fly(1.0)[-1]
    assert {g for g, st in scan.groups.items() if st.state is SensorState.OFF} == set(GROUP_NAMES) - {"imu", "analog_b"}
    assert set(scan.values) == {c.name for g in ("imu", "analog_b") for c in channels_of(g)}
    assert r.sampler.health().ready


def test_wrong_chip_is_named_in_the_health_table() -> None:
    r = rig(config=SensorsConfig(static=cdfp_sensors().static.model_copy(update={"chip": "bmp388"})))  # type: ignore[union-attr]
    health = r.sampler.health().group("static")
    assert health.state is SensorState.FAULT
    assert "expected a BMP388" in health.words
    assert not r.sampler.health().ready


@pytest.mark.parametrize(
    ("rate_hz", "bus"),
    [
        (90.0, BusModel(frequency_hz=400e3)),
        (100.0, BusModel(frequency_hz=400e3)),
        (200.0, BusModel(frequency_hz=400e3)),
        (1000.0, BusModel(frequency_hz=1e6, overhead_us=5.0)),
    ],
)
def test_higher_rates_read_the_imu_each_time_and_the_rest_in_turn(rate_hz: float, bus: BusModel) -> None:
    config = cdfp_sensors()
    if rate_hz > 500:
        slow = {"every": 50}
        changes = {g: config.section(g).model_copy(update=slow) for g in ON_BUS if g != "imu"}
        changes["imu"] = ImuConfig(gyro_lowpass_hz=361.4, accel_lowpass_hz=473.0)
        config = config.model_copy(update=changes)
    r = rig(rate_hz=rate_hz, config=config, bus=bus)
    r.fly(0.5)
    scans = r.fly(1.0)
    fresh = sum(st is OK for st in states(scans, "imu"))
    assert fresh > 0.97 * len(scans)
    assert max(s.lateness_us for s in scans) < 1e6 / rate_hz
    for group in ON_BUS:
        every = int(r.sampler.metadata()[f"{group}.every"])
        good = sum(st is OK for st in states(scans, group))
        assert good >= 0.8 * len(scans) / every, (group, good)


def test_without_start_the_sensors_come_up_one_step_a_scan() -> None:
    r = rig(start=False)
    scans = r.fly(6.0)
    assert r.longest_ns < 50_000_000
    assert all(st.state in (OK, SensorState.OFF) for st in scans[-1].groups.values())


class Switched:
    """The frozen moment with somebody pressing the event switch for 0.2 s at 2, 4 and 6 s."""

    def advance(self, to_time: float) -> Truth:
        pressed = 1.0 if to_time >= 1.9 and to_time % 2.0 < 0.2 else 0.0
        return replace(moment(), time=to_time, digital=(pressed, 0.0, 0.0, 0.0, 0.0))


def test_event_switch_marks_its_time_once_and_shows_in_the_bits() -> None:
    r = rig(source=Switched())
    scans = r.fly(7.0)
    assert [e.source for e in r.events] == ["switch"] * 3
    pressed = [(e.time_monotonic_ns - 5_000_000_000) * 1e-9 for e in r.events]
    assert pressed == pytest.approx([2.01, 4.01, 6.01], abs=0.012)  # after 10 ms of debouncing
    for event in r.events:
        scan = next(s for s in scans if s.number == event.scan_number)
        assert scan.values["digital_1"] == 1
        assert 0 <= scan.time_monotonic_ns - event.time_monotonic_ns < 60_000_000
    assert sum(s.values["digital_1"] for s in scans) == pytest.approx(15, abs=3)


def test_audit_finds_a_chip_that_lost_its_settings_but_goes_on_talking() -> None:
    """A load-cell converter that still delivers samples after a dip, at the wrong supply and gain."""
    chip = FakeChip({0x1F: 0x0F})

    def after_write(register: int, value: int) -> None:
        if register == 0x00 and value & 0x02:
            chip.registers[0x00] = value | 0x28  # powered up, conversion ready
        elif register == 0x02:
            chip.registers[0x02] = value & ~0x04

    chip.after_write = after_write
    count = iter(range(10**6))
    chip.before_read = lambda register: chip.put(0x12, next(count).to_bytes(3, "big"))
    clock = SimulatedClock()
    sampler = Sampler(SensorsConfig(thrust=ThrustConfig()), FakeBus({0x2A: chip}), None, clock)

    def fly(scans: int) -> list[SensorState]:
        seen = []
        for _ in range(scans):
            clock.advance(50_000_000)
            seen.append(sampler.finish(sampler.take(0, clock.monotonic_ns())).groups["thrust"].state)
        return seen

    sampler.start()
    assert fly(10) == [OK] * 10
    chip.registers[0x00] = 0x20  # only conversion ready is left
    assert SensorState.FAULT in fly(4)
    assert fly(60)[-1] is OK
    assert sampler.health().group("thrust").setups == 2


def test_whoever_asks_is_told_of_every_scan_as_soon_as_it_is_read() -> None:
    plane = rig()
    told: list[tuple[int, int]] = []
    plane.sampler.on_taken = lambda taken: told.append((taken.number, plane.clock.monotonic_ns()))
    before = plane.clock.monotonic_ns()
    taken = plane.sampler.take(7, before)
    assert told == [(7, plane.clock.monotonic_ns())]
    assert before <= taken.time_monotonic_ns <= told[0][1]
    scans = plane.fly(1.0)
    assert [n for n, _ in told[1:]] == [s.number for s in scans]
