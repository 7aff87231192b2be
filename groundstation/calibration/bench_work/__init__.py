"""From readings on a bench to the coefficients of an instrument."""
