"""Signals without a model: noise off measured inputs, change points, goodness of fit."""
