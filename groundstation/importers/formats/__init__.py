"""Readers of other programs' files: tables, MATLAB, dataflash, ULog, telemetry logs, bags."""
