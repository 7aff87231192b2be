"""Readers of other programs' files, one each: tables, MATLAB, dataflash, ULog, telemetry logs."""
