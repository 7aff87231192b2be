"""Flights in the formats that other programs read, units and meaning included."""
