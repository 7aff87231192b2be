"""The gap monitor of `daq.identification.monitor` over a file: when the model stopped describing the aircraft."""
