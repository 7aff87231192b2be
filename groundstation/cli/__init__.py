"""Verbs of the ground station."""
