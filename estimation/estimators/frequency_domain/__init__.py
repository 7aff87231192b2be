"""Output error in the frequency domain: a model, linearised about each stretch of flight, compared in Fourier transforms."""
