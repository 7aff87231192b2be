"""Frequency responses from flight data, transfer functions fitted to them, and what they say of handling qualities."""
