"""JSBSim aircraft: their coefficients at any state, their conversion to model files, and models written back into aircraft."""
