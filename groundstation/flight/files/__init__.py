"""Flights read from files: MCAP, CSV and Parquet, each within bounds."""
