"""The user's own simulation as a base model: its coefficients along the flight, and found effects back into it."""
