"""The physical signals that the chips look at, in one fixed order."""

SIGNALS: tuple[str, ...] = tuple(
    (
        "accel_x accel_y accel_z gyro_x gyro_y gyro_z imu_temperature "  # body axes, m/s2, rad/s, K
        "mag_x mag_y mag_z "  # body axes, T
        "alpha_vane beta_vane elevon_left_pot elevon_right_pot rudder_pot "  # V
        "supply sensor_supply analog_1 analog_2 analog_3 analog_4 analog_5 "  # V at the converter
        "pitot_pressure pitot_temperature static_pressure static_temperature "  # Pa, K
        "thrust_bridge "  # V/V
        "latitude longitude altitude velocity_north velocity_east velocity_down "  # deg, deg, m, m/s
        "pwm_1 pwm_2 pwm_3 pwm_4 pwm_5 pwm_6 "  # s
        "digital_1 digital_2 digital_3 digital_4 digital_5"
    ).split()
)
"""Unit and axes as commented; `pwm_1` and all after it hold between grid points."""

AT = {name: i for i, name in enumerate(SIGNALS)}
