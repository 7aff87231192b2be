"""What a model leaves out, tested beside each fit: derivatives, first nonlinear terms, lags, scales, a flight that differs."""
