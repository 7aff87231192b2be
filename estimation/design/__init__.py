"""Inputs designed from what is known: shapes, what they would do to the aircraft, what they would tell, and the best of them."""
