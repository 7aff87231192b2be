"""Drivers of the aircraft's sensors: one module per chip, each talking only through `daq.sensors.bus`."""
