"""Shapes of effects without a name: smooth functions, lags and swings of a coefficient."""
