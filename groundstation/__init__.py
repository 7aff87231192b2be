"""The ground station: receive, decode, calibrate, look, hand over. Owns the calibrated `Flight`."""
