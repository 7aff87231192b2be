"""The channel table is whole: everything that must be measured is in it, and all that is derived follows it."""

import pytest

from daq.contract.channels import CHANNELS, COLUMN_BY_NAME, COLUMNS, GROUP_NAMES, channels_of, sources_of
from daq.contract.scan import file_descriptor_set, scan_message_class

MISSION = (
    "accel_x accel_y accel_z gyro_x gyro_y gyro_z mag_x mag_y mag_z quaternion_w quaternion_x quaternion_y quaternion_z "
    "alpha_vane beta_vane pitot_pressure static_pressure static_temperature elevon_left_pot elevon_right_pot rudder_pot "
    "thrust_load latitude_e7 longitude_e7 height_msl_mm velocity_north_mm velocity_east_mm velocity_down_mm "
    "gnss_utc_ns horizontal_accuracy_mm analog_1 analog_2 analog_3 analog_4 analog_5 digital_1 digital_2 digital_3 "
    "digital_4 digital_5 pwm_1 pwm_2 pwm_3 pwm_4 pwm_5 pwm_6 supply"
).split()

FLIGHT_COLUMNS = (
    "ax ay az p q r phi theta psi alpha beta V delta_e delta_a delta_r cmd_e cmd_a cmd_r thrust rho p_static p_dynamic "
    "temperature latitude longitude altitude vn ve vd mx my mz"
).split()


def test_every_mission_channel_is_in_the_table() -> None:
    assert set(MISSION) <= {c.name for c in CHANNELS}


def test_every_flight_column_of_the_interface_has_a_source() -> None:
    for column in FLIGHT_COLUMNS:
        assert column in COLUMN_BY_NAME
        assert sources_of(column), f"no raw channel leads to {column}"


def test_names_are_unique_and_groups_known() -> None:
    names = [c.name for c in CHANNELS] + [g + s for g in GROUP_NAMES for s in ("_state", "_offset_us")]
    assert len(set(names)) == len(names)
    assert {c.group for c in CHANNELS} == set(GROUP_NAMES)
    assert len({c.name for c in COLUMNS}) == len(COLUMNS)


def test_columns_named_by_channels_exist() -> None:
    for channel in CHANNELS:
        for column in channel.columns:
            assert column in COLUMN_BY_NAME, f"{channel.name} names the unknown column {column}"


@pytest.mark.parametrize("group", GROUP_NAMES)
def test_schema_has_each_channel_and_the_state_of_each_group(group: str) -> None:
    fields = {f.name for f in file_descriptor_set().file[0].message_type[0].field}
    assert {f"{group}_state", f"{group}_offset_us"} <= fields
    assert {c.name for c in channels_of(group)} <= fields


def test_field_numbers_are_unique_and_legal() -> None:
    numbers = [f.number for f in scan_message_class().DESCRIPTOR.fields]
    assert len(set(numbers)) == len(numbers)
    assert not any(19000 <= n < 20000 for n in numbers)


def test_six_pwm_five_analog_five_digital() -> None:
    names = [c.name for c in CHANNELS]
    assert sum(n.startswith("pwm_") for n in names) == 6
    assert sum(n.startswith("analog_") for n in names) == 5
    assert sum(n.startswith("digital_") for n in names) == 5
