"""Output error in the frequency domain: a model linearised about each stretch of flight, compared in its Fourier transforms."""
