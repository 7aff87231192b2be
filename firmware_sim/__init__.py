"""The simulated aircraft: physics, pilot, hidden effects, and the instruments and chips that look at them."""
