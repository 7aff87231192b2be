"""A shape for what no name explains: a missing coefficient as a smooth function of what the data choose."""
