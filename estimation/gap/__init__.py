"""Find where model and flight disagree, name the effect, add it, and show that the gap shrinks."""
