"""Estimators: equation error, output error, filter error, and the results they share."""
