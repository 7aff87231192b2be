"""Rounds of screen, full fits and acceptance, until nothing is significant."""
