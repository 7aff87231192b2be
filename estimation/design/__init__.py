"""Inputs designed from a model: shapes, the motion and the bounds that they would give, and the best of them."""
