"""The judgement of samples over time, the words a person reads, and the configuration's checks."""

import pytest
from pydantic import ValidationError

from daq.acquisition.health import GroupHealth, GroupWatch, HealthSummary
from daq.contract.scan import SensorState
from daq.sensors.ads1115 import AnalogConfig
from daq.sensors.ak09916 import MagConfig
from daq.sensors.config import HealthConfig, SensorsConfig
from daq.sensors.icm20948 import ImuConfig
from daq.sensors.mounting import rotation
from tests.unit.daq.cdfp_fit import cdfp_sensors

PERIOD = 50_000_000


def verdicts(watch: GroupWatch, channel: str, values: list[int]) -> list[SensorState]:
    return [watch.judge({channel: v}, i * PERIOD).state for i, v in enumerate(values)]


def test_stuck_only_after_its_time_and_free_at_the_first_change() -> None:
    watch = GroupWatch(("beta_vane",), HealthConfig(stuck_s={"beta_vane": 0.5}))
    seen = verdicts(watch, "beta_vane", [100] * 15 + [101, 101])
    assert seen == [SensorState.OK] * 11 + [SensorState.STUCK] * 4 + [SensorState.OK] * 2


def test_one_stuck_channel_among_moving_ones_is_named() -> None:
    watch = GroupWatch(("alpha_vane", "beta_vane"), HealthConfig(stuck_s={"alpha_vane": 0.2, "beta_vane": 0.2}))
    verdict = None
    for i in range(10):
        verdict = watch.judge({"alpha_vane": i, "beta_vane": 7}, i * PERIOD)
    assert verdict is not None
    assert verdict.detail.startswith("beta_vane at 7 for")


def test_channel_without_a_limit_may_stand_still() -> None:
    watch = GroupWatch(("pwm_1",), HealthConfig())
    assert set(verdicts(watch, "pwm_1", [15000] * 1000)) == {SensorState.OK}


def test_spike_is_marked_alone() -> None:
    watch = GroupWatch(("alpha_vane",), HealthConfig(max_step={"alpha_vane": 100.0}, stuck_s={}))
    seen = verdicts(watch, "alpha_vane", [0, 10, 5000, 20, 30])
    assert [s is SensorState.OUT_OF_RANGE for s in seen] == [False, False, True, False, False]


def test_new_level_is_accepted_at_its_second_sample() -> None:
    watch = GroupWatch(("alpha_vane",), HealthConfig(max_step={"alpha_vane": 100.0}, stuck_s={}))
    seen = verdicts(watch, "alpha_vane", [0, 5000, 5010, 5020])
    assert [s is SensorState.OUT_OF_RANGE for s in seen] == [False, True, False, False]


def test_configured_limits() -> None:
    watch = GroupWatch(("supply",), HealthConfig(plausible={"supply": (10000, 20000)}))
    assert verdicts(watch, "supply", [9999, 10000, 20000, 20001]) == [
        SensorState.OUT_OF_RANGE,
        SensorState.OK,
        SensorState.OK,
        SensorState.OUT_OF_RANGE,
    ]


def test_summary_in_words() -> None:
    good = GroupHealth("imu", SensorState.OK)
    bad = GroupHealth("pitot", SensorState.ABSENT, "does not answer")
    spare = GroupHealth("thrust", SensorState.STALE, required=False)
    off = GroupHealth("gnss", SensorState.OFF, required=False)
    assert HealthSummary(0, (good, off)).words == "all fitted sensors are well"
    summary = HealthSummary(0, (good, bad, spare, off))
    assert summary.words == "differential pressure: absent (does not answer); thrust load cell: stale"
    assert not summary.ready
    assert HealthSummary(0, (good, spare, off)).ready
    assert not HealthSummary(0, (good,), bus_fault="held").ready
    assert summary.group("pitot") is bad


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ({"imu": {"mounting": ["+x", "+x", "+z"]}}, "each of x, y and z once"),
        ({"imu": {"mounting": ["+x", "+y", "-z"]}}, "mirror image"),
        ({"imu": {"gyro_lowpass_hz": 12.0}}, "must be one of 361.4"),
        ({"imu": {"adress": 0x68}}, "Extra inputs are not permitted"),
        ({"mag": {}}, "mag sits behind the imu"),
        ({"attitude": {}}, "attitude needs the imu"),
        (
            {"analog_a": {"address": 0x48}, "analog_b": {"address": 0x48}},
            "analog_a and analog_b share the I2C address 0x48",
        ),
        ({"analog_a": {"address": 0x48, "inputs": [0, 1, 1, 3]}}, "each of 0, 1, 2 and 3 once"),
        ({"health": {"stuck_s": {"betavane": 1.0}}}, "betavane: no such channel"),
        ({"extra": {"thruster": {"driver": "lab:Cell"}}}, "no such group"),
        ({"pitot": {"range_pa": [100.0, -100.0]}}, "lowest, highest"),
    ],
)
def test_configuration_mistakes_are_refused(section: dict[str, object], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        SensorsConfig.model_validate(section)


def test_full_fit_is_valid_and_complete() -> None:
    config = cdfp_sensors()
    assert len(config.fitted) == 11
    assert SensorsConfig(imu=ImuConfig(), mag=MagConfig()).fitted == ("imu", "mag")
    assert SensorsConfig(analog_b=AnalogConfig(address=0x49)).section("analog_a") is None


def test_rotations_are_proper_and_saturate() -> None:
    assert rotation(("+y", "-x", "+z"))(1, 2, 3) == (2, -1, 3)
    assert rotation(("-x", "-y", "+z"))(-32768, 0, 5) == (32767, 0, 5)
