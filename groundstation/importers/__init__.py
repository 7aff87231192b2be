"""Other people's data into the flight format: CSV, Parquet, PX4 ULog, ArduPilot dataflash and MAVLink telemetry logs."""
