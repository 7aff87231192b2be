"""Aircraft of JSBSim: asked for their coefficients, and written back with what was found in them."""
