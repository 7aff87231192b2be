"""The gap monitor of `daq.identification.monitor` over a file: since when the model does not describe the aircraft."""
