"""What papers of recordings hold most: both ends of the link compress with it, so that they fit two fragments instead of five.

Its bytes never change: a ground station of another version could no longer read the papers.
"""

PAPERS_DICTIONARY = (
    b'"pitot.calibrated_pa": "96600.0", "static.offset_k": "145.14999999999998", "static.scale_k": "1.52587890625e-05",'
    b' "static.scale_pa": "0.015625", "vane_alpha.centre_count": "2048", "vane_alpha.chip": "AS5600", "vane_alpha.every":'
    b' "1", "vane_alpha.filter_delay_s": "0.000143", "vane_beta.centre_count": "2048", "vane_beta.chip": "AS5600",'
    b' "vane_beta.every": "1", "vane_beta.filter_delay_s": "0.000143", "analog_a.alpha_vane_after_s": "-0.002655",'
    b' "analog_a.beta_vane_after_s": "-0.000858", "analog_a.chip": "ADS1115", "analog_a.elevon_left_pot_after_s":'
    b' "0.000885", "analog_a.elevon_right_pot_after_s": "0.002628", "analog_a.every": "1", "analog_a.scale_v": "0.000125",'
    b' "analog_b.analog_1_after_s": "0.002719", "analog_b.chip": "ADS1115", "analog_b.every": "1",'
    b' "analog_b.rudder_pot_after_s": "-0.002929", "analog_b.scale_v": "0.000125", "analog_b.sensor_supply_after_s":'
    b' "0.000976", "analog_b.supply_after_s": "-0.000766", "analog_c.analog_2_after_s": "-0.003203",'
    b' "analog_c.analog_3_after_s": "-0.000675", "analog_c.analog_4_after_s": "0.001068", "analog_c.analog_5_after_s":'
    b' "0.002810", "analog_c.chip": "ADS1115", "analog_c.every": "1", "analog_c.scale_v": "0.000125", "capture.chip":'
    b' "capture co-processor", "capture.every": "1", "capture.firmware": "1.3", "capture.scale_s": "1e-07", "gnss.chip":'
    b' "u-blox", "gnss.every": "1", "gnss.latency_s": "0.05", "gnss.rate_hz": "10.0", "imu.accel_delay_s": "0.01384",'
    b' "imu.accel_lowpass_hz": "11.5", "imu.accel_scale_m_s2": "0.00239420166015625", "imu.chip": "ICM-20948", "imu.every":'
    b' "1", "imu.filter_delay_s": "0.01384", "imu.gyro_delay_s": "0.01372", "imu.gyro_lowpass_hz": "11.6",'
    b' "imu.gyro_scale_rad_s": "0.0002664624812205083", "imu.mounting": "+x +y +z", "mag.chip": "AK09916", "mag.every":'
    b' "1", "mag.filter_delay_s": "0.0072", "mag.scale_t": "1.5e-07", "pitot.chip": "MS4525DO", "pitot.every": "1",'
    b' "pitot.filter_delay_s": "0.0005", "pitot.offset_pa": "-8618.446249999999", "pitot.scale_pa": "1.0521206433498136",'
    b' "sensors.rate_hz": "20.0", "static.chip": "BMP390", "static.every": "1", "static.filter_delay_s": "0.018393",'
    b' "static.nvm": "b66c0f4af66a1c0f170601564b465b03fa6f0f06f5", "thrust.chip": "NAU7802", "thrust.every": "1",'
    b' "thrust.filter_delay_s": "0.025", "thrust.gain": "128"'
    b' {"session": "cdfp_20260601_080000", "source": "hardware", "aircraft": "cdfp", "scan_rate_hz": 20.0, "started_utc_ns": 17'
    b', "software": "0.1.0", "details": {'
)
