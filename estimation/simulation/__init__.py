"""The user's own simulation as a base model: its coefficients along the flights, and effects found written back into it."""
