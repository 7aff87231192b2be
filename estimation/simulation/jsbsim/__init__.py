"""Aircraft of JSBSim: asked for their coefficients, written as models in our own text, and back with what was found in them."""
