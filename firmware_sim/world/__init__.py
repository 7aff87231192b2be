"""A scenario flown: the aircraft, its pilot and the air together, and the truth it leaves."""
