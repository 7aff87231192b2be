"""Stepwise regression and PySINDy's STLSQ on the flights of the gap benchmark; `tests.studies.gap_comparison` runs it."""
