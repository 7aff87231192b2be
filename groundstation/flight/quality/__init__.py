"""Quality of a flight's columns: repeats, ranges, skew between devices, noise, and the report on all of these."""

from groundstation.flight.quality.report import quality_report

__all__ = ["quality_report"]
