"""Frequency responses from flight data, transfer functions fitted to them, and handling qualities."""
