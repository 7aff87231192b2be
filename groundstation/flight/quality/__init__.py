"""What a flight's own columns say of themselves: repeats, ranges, skew between devices, noise, and the report of it all."""

from groundstation.flight.quality.report import quality_report

__all__ = ["quality_report"]
