"""Other programs' data as flights: CSV, Parquet, MATLAB, PX4 ULog, ArduPilot dataflash, MAVLink telemetry logs and bags."""
