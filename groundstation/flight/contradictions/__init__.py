"""Quantities of a flight that say the same twice, and by how much they contradict each other: for import, check, preflight,
recipe and estimate alike."""

from groundstation.flight.contradictions.contradiction import Contradiction
from groundstation.flight.contradictions.table import CONTRADICTIONS, contradictions, contradictions_of

__all__ = ["CONTRADICTIONS", "Contradiction", "contradictions", "contradictions_of"]
